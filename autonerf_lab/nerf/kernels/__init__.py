"""The CPU's inner loops, compiled by numba."""
