"""Kernels: NumPy and Numba only, no I/O, no validation; every function trusts its input.

scene       topology
hierarchy   partition -> bundles (edges), face_bundles
contours    lift -> search (tiles; filters in float32) -> contour, crossings | octahedral
starts      along -> zenith | octahedral
visible     radial_sweep | sweep; radial_cover (cuts) | cover; visible chooses
integrands  integrands/: radial, radial_sh in closed form; fractions, octahedral_sh, light by tables
            (prefix_table of functions, texel_table of maps; sh, sh_rotation, equirect, cie_sky)
"""
