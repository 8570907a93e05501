"""Charts cut where they come too close to themselves.

A chart may bend round until parts of it that are far apart on the mesh are less than two texels apart in the
texture, with a slit between them: the texels in the slit then belong to one side, and lookups on the other
read them too. No value satisfies both. Cut in two somewhere along the way from one side to the other, the
chart becomes two that a packer keeps apart.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from silint.texture.charts import Charts

__all__ = ["cut_at_slits"]

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


def cut_at_slits(
    charts: Charts, rivals: npt.NDArray[np.integer[Any]], uvs: FloatArray
) -> npt.NDArray[np.int32]:
    """New charts, no two rivals in one, by cutting halfway between them.

    A chart with rivals falls into the faces that are nearer to the one and those that are nearer to the
    other, on a path over faces; and so on, as long as a piece has rivals. Pieces are connected.

    Parameters
    ----------
    charts : Charts
    rivals : (r, 2) int
        Faces that are to be in different charts. Pairs of different charts are, and are left out.
    uvs : (F, 3, 2) float64
        A step from face to face is as long as the way between their middles.

    Returns
    -------
    (F,) int32
        Chart of each face, -1 for those without. Those of charts that were not cut keep their number.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import dijkstra

    piece = charts.of_face.copy()
    n_pieces = charts.n_charts
    middles = uvs.mean(axis=1)
    a, b = charts.joined.T
    # A path of no length would be none at all.
    steps = np.maximum(np.linalg.norm(middles[a] - middles[b], axis=1), np.finfo(float).tiny)
    todo = rivals[(rivals[:, 0] != rivals[:, 1]) & (piece[rivals[:, 0]] == piece[rivals[:, 1]])]
    while len(todo):
        first, second = todo[0]
        faces = np.flatnonzero(piece == piece[first])
        row = np.full(len(piece), -1)
        row[faces] = np.arange(len(faces))
        inner = (row[a] >= 0) & (row[b] >= 0)
        shape = (len(faces), len(faces))
        graph = coo_matrix((steps[inner], (row[a[inner]], row[b[inner]])), shape).tocsr()
        near = dijkstra(graph, directed=False, indices=[row[first], row[second]])
        beyond = near[1] < near[0]
        piece[faces[beyond]] = n_pieces
        n_pieces += 1
        todo = todo[piece[todo[:, 0]] == piece[todo[:, 1]]]
    return piece
