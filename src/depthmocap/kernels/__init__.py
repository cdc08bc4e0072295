"""Compiled inner loops (Numba): plain contiguous arrays in, plain arrays out, no validation."""
