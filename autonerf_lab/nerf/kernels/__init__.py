"""Compiled numba kernels for training and rendering on the CPU.

A function that a kernel calls is always inlined (``inline="always"`` or ``forceinline=True``). Otherwise the machine
code of every kernel would contain its own copy, optimised differently under ``fastmath``, and all kernels would call
the copy that was loaded first: results would depend on what the process has computed before.
"""
