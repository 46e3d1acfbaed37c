"""The optimiser's inner loop."""

import numpy as np
from numba import njit, prange

from autonerf_lab.nerf.kernels.blocks import ONE


@njit(parallel=True, fastmath=True, cache=True, error_model="numpy")
def adam(p, g, m, v, rate, beta1, beta2, eps, step):
    """One Adam update of flat arrays, in place; ``g`` is cleared.

    An entry without gradient is left alone, moments included: most of a hash table is not touched by a batch.
    """
    correct1, correct2 = ONE / (ONE - beta1**step), ONE / (ONE - beta2**step)
    for i in prange(p.shape[0]):
        if g[i] != 0:
            m[i] = beta1 * m[i] + (ONE - beta1) * g[i]
            v[i] = beta2 * v[i] + (ONE - beta2) * g[i] * g[i]
            p[i] -= rate * (m[i] * correct1) / (np.sqrt(v[i] * correct2) + eps)
            g[i] = 0
