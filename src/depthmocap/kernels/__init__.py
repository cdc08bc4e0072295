"""Compiled inner loops (Numba): plain contiguous arrays in, plain arrays out, no validation.

No file uses kernels of another: Numba's cache knows of changes in a kernel's own file alone.
"""
