"""Compiled numba kernels for training and rendering on the CPU.

A function that a kernel calls is inlined (``inline="always"`` or ``forceinline=True``). Otherwise the machine code of
every kernel would contain its own copy, optimised differently under ``fastmath``, and all kernels would call the copy
that was loaded first: results would depend on what the process has computed before. The products of
:mod:`~autonerf_lab.nerf.kernels.dense` are calls, because their many copies would take most of the time of compilation.
They state their vectors and the order of their sums, so that all copies compute the same bits.
"""
