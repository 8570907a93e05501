"""Run as a script: unwrap the mesh of one .npz into another with xatlas, which may end its process.

With ``uvs`` and ``charts`` in place of ``positions``, pack these charts anew.
"""

from __future__ import annotations

import sys

import numpy as np

if __name__ == "__main__":
    import xatlas

    source, target = sys.argv[1:]
    with np.load(source) as data:
        atlas = xatlas.Atlas()
        if "uvs" in data:
            atlas.add_uv_mesh(data["uvs"], data["faces"], data["charts"][:, None])
        else:
            atlas.add_mesh(data["positions"], data["faces"])
        options = xatlas.PackOptions()
        options.resolution = int(data["resolution"])
        options.padding = int(data["padding"])
        options.bilinear = True
        options.rotate_charts = False  # its quarter turns are reflections, which tangent space would show
        atlas.generate(pack_options=options)
    _, faces, uvs = atlas[0]
    np.savez(
        target, faces=faces, uvs=uvs, extent=np.array([atlas.width, atlas.height]), pages=atlas.atlas_count
    )
