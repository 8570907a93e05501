"""What is integrated over visible intervals. Nothing here knows of meshes.

An integrand is a prefix table (`moments` holds those of the smooth ones) and a line of NumPy that combines
its integrals over what is visible and over the open hemisphere.
"""
