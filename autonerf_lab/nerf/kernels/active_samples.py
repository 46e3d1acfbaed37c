"""Active samples of a tile: those with weight or near a measured surface, packed side by side.

Sums over a ray and copies to its samples become products with two thin matrices, which the dense kernels compute fast.
"""

import numpy as np
from numba import njit

from autonerf_lab.nerf.kernels.dense import weight_gradient
from autonerf_lab.nerf.kernels.tiling import ONE, SIMD_WIDTH, ZERO


@njit(fastmath=True, cache=True, error_model="numpy", forceinline=True)
def force(starts, ends, depth, front, behind, forced):
    """Mark the samples of one ray that are compared with a measured surface; they need a gradient without weight."""
    for i in range(forced.shape[0]):
        distance = np.float32(0.5) * (starts[i] + ends[i]) - depth
        forced[i] = depth > ZERO and -front < distance < behind


@njit(fastmath=True, cache=True, error_model="numpy", forceinline=True)
def pack(weights, forced, min_weight, columns, owners, owned, packed):
    """Find the active samples of a tile; return their number, and that number rounded up to whole vectors.

    Samples are active if they have weight or ``forced`` (TILE_RAYS, S) is set.

    ``owned[r, k]`` is written as 1 where sample k lies on ray r, ``packed[r, k]`` as its weight. Filler columns belong
    to no ray.
    """
    count, samples = 0, weights.shape[1]
    for r in range(weights.shape[0]):
        for i in range(samples):
            if weights[r, i] > min_weight or forced[r, i]:
                columns[count], owners[count] = r * samples + i, r
                count += 1
    full = (count + SIMD_WIDTH - 1) // SIMD_WIDTH * SIMD_WIDTH
    columns[count:full] = 0
    owners[count:full] = 0
    for r in range(weights.shape[0]):
        for k in range(full):
            owned[r, k] = ZERO
            packed[r, k] = ZERO
    for k in range(count):
        r = owners[k]
        owned[r, k] = ONE
        packed[r, k] = weights[r, columns[k] - r * samples]
    return count, full


@njit(fastmath=True, cache=True, error_model="numpy", forceinline=True)
def gather(source, columns, n, target):
    """Write ``target[:, k] = source[:, columns[k]]`` for n columns."""
    for j in range(source.shape[0]):
        for k in range(n):
            target[j, k] = source[j, columns[k]]


@njit(fastmath=True, cache=True, error_model="numpy", forceinline=True)
def composite(values, packed, n, out):
    """Write ``out[j, r]``: the sum over the samples k of ray r of ``packed[r, k] * values[j, k]``."""
    for j in range(out.shape[0]):
        for r in range(out.shape[1]):
            out[j, r] = ZERO
    weight_gradient(values, packed, out, n)
