"""What is integrated over visible intervals. Nothing here knows of meshes.

A new integrand goes here: in closed form along radial isolines (`radial`, `radial_sh`), or by a prefix table
along octahedral ones (`moments` and `octahedral_sh` tabulate functions, `light` maps; `fractions` combines
integrals over what is visible and over the open hemisphere), or as a sum over the boundary arcs of the
visible region (`arcs`, `arcs_sh`). CONTRIBUTING.md tells the steps.
"""
