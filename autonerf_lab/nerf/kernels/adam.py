"""Inner loop of the Adam optimiser (Kingma and Ba 2015)."""

import numpy as np
from numba import njit, prange

from autonerf_lab.nerf.kernels.tiling import ONE, ZERO

BETA_1, BETA_2, EPSILON = 0.9, 0.99, 1e-15  # of Instant-NGP; those of Nerfacto, but for its BETA_2 of 0.999
MAX_GRADIENT = np.float32(1e15)  # its square is far from the end of float32
BLOCK = 1 << 13  # values per unit of parallel work
SERIAL_SIZE = 1 << 16  # values; up to this size one thread is faster than waking the others


@njit(inline="always")
def _update(i, p, g, m, v, rate, correct1, correct2):
    # A factor instead of a branch, so that the compiler can vectorise the loop.
    touched = ONE if g[i] != ZERO else ZERO
    gradient = min(max(g[i], -MAX_GRADIENT), MAX_GRADIENT)
    m[i] += touched * (ONE - np.float32(BETA_1)) * (gradient - m[i])
    v[i] += touched * (ONE - np.float32(BETA_2)) * (gradient * gradient - v[i])
    p[i] -= touched * rate * (m[i] * correct1) / (np.sqrt(v[i] * correct2) + np.float32(EPSILON))
    g[i] = ZERO


@njit(parallel=True, fastmath=True, cache=True, error_model="numpy")
def _adam_large(p, g, m, v, rate, correct1, correct2):
    # Blocks of one size: with a range per thread, the values at its end, which do not fill a vector, are rounded in
    # another way, and the parameters depend on the number of threads.
    for block in prange((p.shape[0] + BLOCK - 1) // BLOCK):
        part = slice(block * BLOCK, (block + 1) * BLOCK)
        p_part, g_part, m_part, v_part = p[part], g[part], m[part], v[part]  # indices from 0 vectorise
        for i in range(p_part.shape[0]):
            _update(i, p_part, g_part, m_part, v_part, rate, correct1, correct2)


@njit(fastmath=True, cache=True, error_model="numpy")
def _adam_small(p, g, m, v, rate, correct1, correct2):
    for i in range(p.shape[0]):
        _update(i, p, g, m, v, rate, correct1, correct2)


def adam(p, g, m, v, rate, step):
    """Update flat float32 arrays in place by one Adam step, and clear ``g``.

    Entries with zero gradient keep their value and moments, because a batch touches few entries of a hash table.

    Args:
        p, g, m, v: (N,) parameters, gradients, first and second moments.
        rate: float32 learning rate.
        step: number of this update, from 1; for the bias correction.
    """
    correct1, correct2 = (np.float32(1 / (1 - np.float32(beta) ** step)) for beta in (BETA_1, BETA_2))
    run = _adam_large if len(p) > SERIAL_SIZE else _adam_small
    run(p, g, m, v, rate, correct1, correct2)
