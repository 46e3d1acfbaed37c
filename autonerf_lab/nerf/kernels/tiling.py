"""Division of the work on rays into tiles and chunks, shared by all kernels.

Rays come in whole tiles: their number is a multiple of :data:`TILE_RAYS`, and the fields and samplers that call the
kernels pad. The activations of a tile fit the cache. Tiles are dealt to a fixed number of chunks, each with its own
gradient buffer, so that no sum depends on the number of threads or on which one is faster: results have the same bits.
"""

import numpy as np
from numba import njit

CHUNKS = 16  # units of parallel work
SIMD_WIDTH = 16  # float32 values per vector; columns come in multiples of it, since kernels have no remainder loops
TILE_RAYS = 16  # rays per tile; a multiple of SIMD_WIDTH, so that the number of a tile's columns is one too
GEOMETRY = 16  # outputs of the density network: the first is the log density, all of them are inputs of the heads
# fastmath assumes that no value is infinite or NaN: these bounds keep exponentials and quotients finite.
MAX_EXPONENT = np.float32(80.0)  # exp(80) = 5.5e34, float32 ends at 3.4e38
SMALLEST = np.float32(1e-12)  # smallest divisor
# Constants of the kernels: an integer or a double in a float32 expression would make the expression double.
ZERO, ONE, TWO = np.float32(0.0), np.float32(1.0), np.float32(2.0)


@njit(inline="always")
def buffer(rows, columns):
    """Return (rows, columns) float32 zeros."""
    return np.zeros((rows, columns), np.float32)


def pad_rows(array: np.ndarray) -> np.ndarray:
    """Repeat the last row until the number of rows is a multiple of :data:`TILE_RAYS`; no copy if it already is.

    Example:
        >>> pad_rows(np.arange(3)).tolist() == [0, 1] + 14 * [2]
        True
    """
    missing = -len(array) % TILE_RAYS
    return np.concatenate([array, np.repeat(array[-1:], missing, axis=0)]) if missing else array
