"""Dense layers for tiles that stay in the cache.

Activations are (features, samples) with a multiple of four features. Buffers are allocated once for the largest tile;
``n`` is the number of columns in use, a multiple of SIMD_WIDTH.

The sums of a block stay in registers while the inputs stream past: four features of two vectors of samples in a layer,
four by two features in the gradient of its weights. Eight sums are independent, so that no sum waits for the one before
it, and with their factors they fit the 16 registers of AVX2. This makes such thin products reach most of the machine's
peak; a library call spends more time on its set-up than on the product.
"""

from numba import njit

from autonerf_lab.nerf.kernels.simd import (
    WIDTH,
    load,
    multiply_add,
    multiply_add_vectors,
    positive,
    store,
    total,
    zeros,
)
from autonerf_lab.nerf.kernels.tiling import ZERO


@njit(fastmath=True, cache=True, error_model="numpy", forceinline=True)
def _add_features(weights, j, k, values, sums):
    """Add ``weights[j : j + 4, k]`` times a vector of values to four vectors of sums and return them."""
    a0, a1, a2, a3 = sums
    return (
        multiply_add(weights[j, k], values, a0),
        multiply_add(weights[j + 1, k], values, a1),
        multiply_add(weights[j + 2, k], values, a2),
        multiply_add(weights[j + 3, k], values, a3),
    )


@njit(fastmath=True, cache=True, error_model="numpy", forceinline=True)
def _load(y, j, s):
    return load(y, j, s), load(y, j + 1, s), load(y, j + 2, s), load(y, j + 3, s)


@njit(fastmath=True, cache=True, error_model="numpy", forceinline=True)
def _store(y, j, s, sums):
    a0, a1, a2, a3 = sums
    store(y, j, s, a0)
    store(y, j + 1, s, a1)
    store(y, j + 2, s, a2)
    store(y, j + 3, s, a3)


@njit(fastmath=True, cache=True, error_model="numpy", forceinline=True)
def _layer(weights, x, y, n, add):
    """Write or add ``weights @ x``."""
    nothing = zeros(), zeros(), zeros(), zeros()
    pairs = n // (2 * WIDTH) * 2 * WIDTH
    for s in range(0, pairs, 2 * WIDTH):
        for j in range(0, weights.shape[0], 4):
            first, second = (_load(y, j, s), _load(y, j, s + WIDTH)) if add else (nothing, nothing)
            for k in range(weights.shape[1]):
                first = _add_features(weights, j, k, load(x, k, s), first)
                second = _add_features(weights, j, k, load(x, k, s + WIDTH), second)
            _store(y, j, s, first)
            _store(y, j, s + WIDTH, second)
    for s in range(pairs, n, WIDTH):
        for j in range(0, weights.shape[0], 4):
            sums = _load(y, j, s) if add else nothing
            for k in range(weights.shape[1]):
                sums = _add_features(weights, j, k, load(x, k, s), sums)
            _store(y, j, s, sums)


@njit(fastmath=True, cache=True, error_model="numpy")
def dense(weights, x, y, n):
    """Write ``y = weights @ x``: weights (J, K), x (K, n), y (J, n), J a multiple of 4."""
    _layer(weights, x, y, n, False)


@njit(fastmath=True, cache=True, error_model="numpy")
def dense_add(weights, x, y, n):
    """Add ``weights @ x`` to y; shapes as in :func:`dense`."""
    _layer(weights, x, y, n, True)


@njit(fastmath=True, cache=True, error_model="numpy", forceinline=True)
def _add_products(rows, values, sums):
    """Add the products of four vectors with a vector of values to four vectors of sums and return them."""
    a0, a1, a2, a3 = sums
    return (
        multiply_add_vectors(rows[0], values, a0),
        multiply_add_vectors(rows[1], values, a1),
        multiply_add_vectors(rows[2], values, a2),
        multiply_add_vectors(rows[3], values, a3),
    )


@njit(fastmath=True, cache=True, error_model="numpy", forceinline=True)
def _add_totals(dw, j, k, sums):
    for i in range(4):
        dw[j + i, k] += total(sums[i])


@njit(fastmath=True, cache=True, error_model="numpy")
def weight_gradient(dy, x, dw, n):
    """Add ``dy @ x.T`` to dw: dy (J, n), x (K, n), dw (J, K), J a multiple of 4, K of 2."""
    nothing = zeros(), zeros(), zeros(), zeros()
    for j in range(0, dw.shape[0], 4):
        for k in range(0, dw.shape[1], 2):
            first = second = nothing
            for s in range(0, n, WIDTH):
                rows = _load(dy, j, s)
                first = _add_products(rows, load(x, k, s), first)
                second = _add_products(rows, load(x, k + 1, s), second)
            _add_totals(dw, j, k, first)
            _add_totals(dw, j, k + 1, second)


@njit(fastmath=True, cache=True, error_model="numpy", forceinline=True)
def relu(x, n):
    """Apply a ReLU to the first n columns of x in place."""
    for j in range(x.shape[0]):
        for s in range(0, n, WIDTH):
            store(x, j, s, positive(load(x, j, s)))


@njit(fastmath=True, cache=True, error_model="numpy", forceinline=True)
def relu_backward(y, dy, n):
    """Clear dy where the output y of the ReLU is not positive."""
    for j in range(y.shape[0]):
        for s in range(n):
            dy[j, s] = dy[j, s] if y[j, s] > ZERO else ZERO
