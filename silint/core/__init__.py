"""Kernels: NumPy and Numba only, no I/O, no validation; every function trusts its input.

scene -> topology -> edge_hierarchy, face_hierarchy -> contour -> octahedral -> sweep | cover -> integrands
"""
