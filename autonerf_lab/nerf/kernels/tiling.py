"""How the work on rays is cut up, for all kernels.

Rays come in whole blocks (their number is a multiple of BLOCK_RAYS; callers pad): a block's activations fit the cache.
Blocks are dealt to a fixed number of chunks, each with its own gradient buffer, so that sums have the same order, and
the same bits, on any number of threads.
"""

import numpy as np
from numba import njit

CHUNKS = 16
LANES = 16  # samples of a vector: columns come in multiples of it, since the kernels have no remainder loops
BLOCK_RAYS = 16  # a multiple of LANES, so that a block's columns are one too
GEOMETRY = 16  # outputs of the density network; the first is the log density, all of them feed the heads
# constants of the kernels: an integer or a double in a float32 expression would make it all double
ZERO, ONE, TWO = np.float32(0.0), np.float32(1.0), np.float32(2.0)


@njit(inline="always")
def buffer(rows, columns):
    """(rows, columns) float32 of zeros."""
    return np.zeros((rows, columns), np.float32)
