"""The optimiser's inner loop."""

import numpy as np
from numba import njit, prange

from autonerf_lab.nerf.kernels.tiling import ONE, ZERO

SMALL = 1 << 16  # values that one thread updates before another has woken up


@njit(inline="always")
def _update(i, p, g, m, v, rate, beta1, beta2, eps, correct1, correct2):
    # a factor, not a branch: the compiler makes vectors of it
    touched = ONE if g[i] != ZERO else ZERO
    m[i] += touched * (ONE - beta1) * (g[i] - m[i])
    v[i] += touched * (ONE - beta2) * (g[i] * g[i] - v[i])
    p[i] -= touched * rate * (m[i] * correct1) / (np.sqrt(v[i] * correct2) + eps)
    g[i] = ZERO


@njit(parallel=True, fastmath=True, cache=True, error_model="numpy")
def _adam_large(p, g, m, v, rate, beta1, beta2, eps, correct1, correct2):
    for i in prange(p.shape[0]):
        _update(i, p, g, m, v, rate, beta1, beta2, eps, correct1, correct2)


@njit(fastmath=True, cache=True, error_model="numpy")
def _adam_small(p, g, m, v, rate, beta1, beta2, eps, correct1, correct2):
    for i in range(p.shape[0]):
        _update(i, p, g, m, v, rate, beta1, beta2, eps, correct1, correct2)


def adam(p, g, m, v, rate, beta1, beta2, eps, step):
    """One Adam update of flat float32 arrays, in place; ``g`` is cleared.

    An entry without gradient is left alone, moments included: most of a hash table is not touched by a batch.
    """
    correct1, correct2 = np.float32(1 / (1 - beta1**step)), np.float32(1 / (1 - beta2**step))
    run = _adam_large if len(p) > SMALL else _adam_small
    run(p, g, m, v, rate, beta1, beta2, eps, correct1, correct2)
