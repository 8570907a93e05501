"""Clusters of points, halved until each predicts what it holds back."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from silint.core import scattered
from silint.core.jit import KERNEL_LOCK
from silint.core.scattered import ANCHOR, CHECK, UNKNOWN
from silint.validation import InputError

__all__ = ["Progress", "Query", "Refinement"]

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
Query = Callable[[FloatArray, FloatArray], FloatArray]
Progress = Callable[[int, int], None]

# Points of a cluster, at first and at least: smaller ones are computed whole.
_FIRST = 64
_LEAST = 3
# Anchors that a prediction looks at.
_NEAR = 24
# Held-back points have to be this much better than the tolerance: the others are no better than they.
_MARGIN = 0.5
# After which clusters that still fail are computed whole.
_MOST_ROUNDS = 40
# Clipping by less than this is rounding.
_ROUNDING = 1e-12


class _Clusters(NamedTuple):
    """Ranges of the points' order, a row each."""

    begin: IntArray
    end: IntArray
    centre: FloatArray
    """(c, 6) mean position and normal."""
    check: IntArray
    """Row of the held-back point, -1 for none."""
    near: IntArray
    """(c, _NEAR) rows of anchors, -1 for none."""
    error: FloatArray
    """Of the held-back point."""

    def take(self, rows: npt.NDArray[Any]) -> _Clusters:
        """Some of them, by numbers or by a mask."""
        fields: Any = (field[rows] for field in self)
        return _Clusters(*fields)


class Refinement:
    """The state of an interpolation; `run` brings it to its end.

    Parameters
    ----------
    query : callable
    x, n : (N, 3) float64
        Distinct points in an order that does not depend on the caller's, and unit normals.
    label : (N,) int64
        Surfaces.
    tolerance : float
    progress : callable, optional
    """

    def __init__(
        self,
        query: Query,
        x: FloatArray,
        n: FloatArray,
        label: IntArray,
        tolerance: float,
        progress: Progress | None,
    ) -> None:
        self.query, self.tolerance, self.progress = query, tolerance, progress
        self.x, self.n, self.label = x, n, label
        self.order = np.argsort(label, kind="stable")
        self.state = np.zeros(len(x), np.uint8)
        self.value: FloatArray = np.zeros((len(x), 1))
        self.shape: tuple[int, ...] = ()
        self.rounds = self.clipped = 0
        self.held_back_error = 0.0
        size = float(np.ptp(x, axis=0).max()) if len(x) else 0.0
        # Surfaces are apart in the tree of anchors, and so are the two sides of a thin wall.
        self._apart = 4.0 * size
        self._normal_scale = 0.0

    def run(self) -> None:
        """Compute what has to be computed, and predict the rest."""
        new = self._first_clusters()
        radius = np.linalg.norm(self.x[self.order[new.begin]] - new.centre[:, :3], axis=1)
        self._normal_scale = float(np.median(radius)) if len(radius) else 0.0
        settled: list[_Clusters] = []
        while len(new.begin):
            self.rounds += 1
            new, failed = self._judged(self._computed(new))
            if not failed.any():
                # All of them again, from all anchors that there are by now.
                new, settled = _joined([*settled, new]), []
                new, failed = self._judged_again(new)
            settled.append(new.take(~failed))
            new = new.take(failed)
            self.state[new.check] = ANCHOR
            if self.rounds < _MOST_ROUNDS:
                new = self._clusters(*self._halves(new.begin, new.end))
            else:
                self._compute(self._unknown(new)[0])
                new = new.take(np.zeros(0, np.int64))
            self._report(new)
        if settled:
            self._predict_rest(_joined(settled))

    def _first_clusters(self) -> _Clusters:
        """Surfaces, halved until they are small."""
        _, counts = np.unique(self.label, return_counts=True)
        end = np.cumsum(counts)
        small = []
        begin, end = end - counts, end
        while len(begin):
            large = end - begin > _FIRST
            small.append((begin[~large], end[~large]))
            begin, end = self._halves(begin[large], end[large])
        begins, ends = zip(*small, strict=True) if small else ([end], [end])
        return self._clusters(np.concatenate(begins), np.concatenate(ends))

    def _clusters(self, begin: IntArray, end: IntArray) -> _Clusters:
        centre = np.empty((len(begin), 6))
        scattered.centres(self.x, self.n, self.order, begin, end, centre)
        near = np.full((len(begin), _NEAR), -1)
        return _Clusters(begin, end, centre, np.full(len(begin), -1), near, np.zeros(len(begin)))

    def _halves(self, begin: IntArray, end: IntArray) -> tuple[IntArray, IntArray]:
        middle = np.empty_like(begin)
        scattered.halve(self.x, self.n, self.order, begin, end, middle)
        return np.stack([begin, middle], axis=1).ravel(), np.stack([middle, end], axis=1).ravel()

    def _computed(self, new: _Clusters) -> _Clusters:
        """The same with anchors, the anchors near them and a point held back, all of them computed."""
        rows, of_row = self._members(new)
        size = new.end - new.begin
        whole = rows[(size[of_row] <= _LEAST) & (self.state[rows] == UNKNOWN)]
        anchors = np.bincount(of_row[self.state[rows] == ANCHOR], minlength=len(size))
        bare = (anchors == 0) & (size > _LEAST)
        central = np.empty(np.count_nonzero(bare), np.int64)
        scattered.central_rows(self.x, self.order, new.begin[bare], new.end[bare], new.centre[bare], central)
        fresh = np.concatenate([whole, central])
        self.state[fresh] = ANCHOR
        near, check = self._nearest(new.begin, new.centre), np.empty(len(size), np.int64)
        scattered.remotest_rows(self.x, self.order, new.begin, new.end, self.state, near, check)
        held_back = check[check >= 0]
        self.state[held_back] = CHECK
        self._compute(np.concatenate([fresh, held_back]), mark=None)
        return new._replace(near=near, check=check)

    def _judged(self, clusters: _Clusters) -> tuple[_Clusters, npt.NDArray[np.bool_]]:
        """The same with errors of held-back points, and which clusters predict too badly."""
        error = np.zeros(len(clusters.begin))
        tested = np.flatnonzero(clusters.check >= 0)
        error[tested] = self._errors(clusters.check[tested], tested, clusters.near)
        failed = error > _MARGIN * self.tolerance
        # Anchors are predicted from the others, too.
        rows, of_row = self._members(clusters)
        again = (self.state[rows] == ANCHOR) & (clusters.check[of_row] >= 0) & ~failed[of_row]
        rows, of_row = rows[again], of_row[again]
        failed[of_row[self._errors(rows, of_row, clusters.near) > self.tolerance]] = True
        return clusters._replace(error=error), failed

    def _judged_again(self, clusters: _Clusters) -> tuple[_Clusters, npt.NDArray[np.bool_]]:
        """The same with the anchors that are nearest now, and which of those that get new ones fail."""
        near = self._nearest(clusters.begin, clusters.centre)
        changed = (near != clusters.near).any(axis=1)
        judged, fails = self._judged(clusters._replace(near=near).take(changed))
        error, failed = clusters.error.copy(), np.zeros(len(near), bool)
        error[changed], failed[changed] = judged.error, fails
        return clusters._replace(near=near, error=error), failed

    def _errors(self, rows: IntArray, of_row: IntArray, near: IntArray) -> FloatArray:
        """Of predictions of computed rows, in their worst component; infinite where there is none."""
        off = np.abs(self._predicted(rows, of_row, near) - self.value[rows]).max(axis=1, initial=0.0)
        return np.where(np.isnan(off), np.inf, off)

    def _predicted(self, rows: IntArray, of_row: IntArray, near: IntArray) -> FloatArray:
        out = np.empty((len(rows), self.value.shape[1]))
        with KERNEL_LOCK:
            scattered.predict(self.x, self.n, self.label, rows, of_row, near, self.value, out)
        return out

    def _nearest(self, begin: IntArray, centre: FloatArray) -> IntArray:
        """The anchors (c, _NEAR) that are nearest to centres of clusters, on their surface and side of it."""
        from numba import get_num_threads
        from scipy.spatial import cKDTree

        anchors = np.flatnonzero(self.state == ANCHOR)
        tree = cKDTree(self._in_tree(self.x[anchors], self.n[anchors], self.label[anchors]))
        k = min(_NEAR, len(anchors))
        at = self._in_tree(centre[:, :3], centre[:, 3:], self.label[self.order[begin]])
        _, found = tree.query(at, k, workers=get_num_threads())
        near = np.full((len(begin), _NEAR), -1)
        near[:, :k] = anchors[found.reshape(len(begin), k)]
        return near

    def _in_tree(self, x: FloatArray, n: FloatArray, label: IntArray) -> FloatArray:
        shifted = x.copy()
        shifted[:, 0] += self._apart * label
        return np.concatenate([shifted, self._normal_scale * n], axis=1)

    def _compute(self, rows: IntArray, mark: int | None = ANCHOR) -> None:
        """Ask the query for these rows."""
        if not len(rows):
            return
        found = np.asarray(self.query(self.x[rows], self.n[rows]), np.float64)
        if found.ndim not in (1, 2) or len(found) != len(rows):
            raise InputError(
                f"query returned shape {found.shape} for {len(rows)} points; expected (m,) or (m, C)"
            )
        if self.rounds <= 1 and not self.shape and found.ndim == 2:
            self.shape = found.shape[1:]
            self.value = np.zeros((len(self.x), *self.shape))
        self.value[rows] = found.reshape(len(rows), -1)
        if mark is not None:
            self.state[rows] = mark

    def _members(self, clusters: _Clusters) -> tuple[IntArray, IntArray]:
        """All rows of clusters, and which cluster each is of."""
        size = clusters.end - clusters.begin
        of_row = np.repeat(np.arange(len(size)), size)
        start = np.cumsum(size) - size
        return self.order[np.arange(len(of_row)) + (clusters.begin - start)[of_row]], of_row

    def _unknown(self, clusters: _Clusters) -> tuple[IntArray, IntArray]:
        rows, of_row = self._members(clusters)
        unknown = self.state[rows] == UNKNOWN
        return rows[unknown], of_row[unknown]

    def _predict_rest(self, clusters: _Clusters) -> None:
        rows, of_row = self._unknown(clusters)
        known = self.value[self.state != UNKNOWN]
        predicted = self._predicted(rows, of_row, clusters.near)
        alone = np.isnan(predicted).any(axis=1)
        kept = np.clip(predicted[~alone], known.min(axis=0), known.max(axis=0))
        self.clipped = int((np.abs(kept - predicted[~alone]) > _ROUNDING).any(axis=1).sum())
        self.value[rows[~alone]] = kept
        self._compute(rows[alone])
        if (self.state == UNKNOWN).any():
            self.held_back_error = float(clusters.error.max())

    def _report(self, open_clusters: _Clusters) -> None:
        if self.progress is not None:
            n = len(self.x)
            self.progress(n - len(self._unknown(open_clusters)[0]), n)


def _joined(parts: list[_Clusters]) -> _Clusters:
    return _Clusters(*(np.concatenate(fields) for fields in zip(*parts, strict=True)))
