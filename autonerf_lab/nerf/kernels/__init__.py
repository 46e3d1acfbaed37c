"""Compiled numba kernels for training and rendering on the CPU."""
