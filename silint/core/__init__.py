"""Kernels: NumPy and Numba only, no I/O, no validation; every function trusts its input.

scene       topology
hierarchy   partition -> bundles (edges), face_bundles
contours    lift -> search (tiles; filters in float32) -> contour, crossings | octahedral | arc_edges
starts      along -> zenith | octahedral | arcs
visible     lines: radial_sweep | sweep; radial_cover (face_view, cuts) | cover; visible chooses
            arcs: arcs (tiles) -> arrangement (a point; arc_crossings, arc_list, boundary) -> arcs_types
limits      caps (what of a line is near, in a cone, over the ground); of the sweep within a distance,
            sphere_search -> sphere_cuts; of arcs, sphere_search -> ball (ball_hits of edges) -> ball_arcs,
            whose small_circle pieces the sweep takes as edges
integrands  integrands/: radial, radial_sh in closed form along lines; arcs, arcs_cone, arcs_ball,
            arcs_sh along arcs, and their derivatives arcs_gradient, arcs_sh_gradient; fractions,
            octahedral_sh, light, masked_light, basis by tables (prefix_table of functions, texel_table of
            maps with texel_scatter; sh, sh_rotation, equirect, texel_clip, cie_sky); radial_light by cells
            of a map (sky_map)
bakes       uv_cover (texels to triangles), scattered (interpolation between points)
"""
