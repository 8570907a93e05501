"""Kernels: NumPy and Numba only, no I/O, no validation; every function trusts its input.

scene -> topology -> bundles, face_bundles -> search -> crossings | octahedral -> radial_sweep | sweep | cover
-> integrands
"""
