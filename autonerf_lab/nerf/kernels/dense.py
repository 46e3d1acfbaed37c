"""Dense layers for tiles that stay in the cache.

Activations are (features, samples) with a multiple of four features. Buffers are allocated once for the largest tile;
``n`` is the number of columns in use.

The sums of four features of SIMD_WIDTH samples stay in registers while the inputs stream past. This makes such thin
products reach most of the machine's peak; a library call spends more time on its set-up than on the product.
Constants are float32, because one int or double would make the whole expression double.
"""

from numba import njit

from autonerf_lab.nerf.kernels.simd import load, multiply_add, positive, store, zeros
from autonerf_lab.nerf.kernels.tiling import SIMD_WIDTH, ZERO


@njit(fastmath=True, cache=True, error_model="numpy", forceinline=True)
def _product(weights, x, j, s, sums):
    """Add ``weights[j : j + 4] @ x[:, s : s + SIMD_WIDTH]`` to four vectors of sums and return them."""
    a0, a1, a2, a3 = sums
    for k in range(weights.shape[1]):
        values = load(x, k, s)
        a0 = multiply_add(weights[j, k], values, a0)
        a1 = multiply_add(weights[j + 1, k], values, a1)
        a2 = multiply_add(weights[j + 2, k], values, a2)
        a3 = multiply_add(weights[j + 3, k], values, a3)
    return a0, a1, a2, a3


@njit(fastmath=True, cache=True, error_model="numpy", forceinline=True)
def _store(y, j, s, sums):
    a0, a1, a2, a3 = sums
    store(y, j, s, a0)
    store(y, j + 1, s, a1)
    store(y, j + 2, s, a2)
    store(y, j + 3, s, a3)


@njit(fastmath=True, cache=True, error_model="numpy", forceinline=True)
def dense(weights, x, y, n):
    """Write ``y = weights @ x``: weights (J, K), x (K, n), y (J, n), J a multiple of 4, n of SIMD_WIDTH."""
    for s in range(0, n, SIMD_WIDTH):
        for j in range(0, weights.shape[0], 4):
            _store(y, j, s, _product(weights, x, j, s, (zeros(), zeros(), zeros(), zeros())))


@njit(fastmath=True, cache=True, error_model="numpy", forceinline=True)
def dense_add(weights, x, y, n):
    """Add ``weights @ x`` to y; shapes as in :func:`dense`."""
    for s in range(0, n, SIMD_WIDTH):
        for j in range(0, weights.shape[0], 4):
            before = load(y, j, s), load(y, j + 1, s), load(y, j + 2, s), load(y, j + 3, s)
            _store(y, j, s, _product(weights, x, j, s, before))


@njit(fastmath=True, cache=True, error_model="numpy", forceinline=True)
def weight_gradient(dy, x, dw, n):
    """Add ``dy @ x.T`` to dw: dy (J, n), x (K, n), dw (J, K), J a multiple of 4, K of 2."""
    rows, cols = dw.shape
    for j in range(0, rows, 4):
        for k in range(0, cols, 2):
            # Eight sums and six factors fit the 16 registers of AVX2; with more sums the compiler spills them.
            a00 = a01 = a10 = a11 = a20 = a21 = a30 = a31 = ZERO
            for s in range(n):
                d0, d1, d2, d3 = dy[j, s], dy[j + 1, s], dy[j + 2, s], dy[j + 3, s]
                x0, x1 = x[k, s], x[k + 1, s]
                a00 += d0 * x0
                a01 += d0 * x1
                a10 += d1 * x0
                a11 += d1 * x1
                a20 += d2 * x0
                a21 += d2 * x1
                a30 += d3 * x0
                a31 += d3 * x1
            dw[j, k] += a00
            dw[j, k + 1] += a01
            dw[j + 1, k] += a10
            dw[j + 1, k + 1] += a11
            dw[j + 2, k] += a20
            dw[j + 2, k + 1] += a21
            dw[j + 3, k] += a30
            dw[j + 3, k + 1] += a31


@njit(fastmath=True, cache=True, error_model="numpy", forceinline=True)
def relu(x, n):
    """Apply a ReLU to the first n columns of x in place."""
    for j in range(x.shape[0]):
        for s in range(0, n, SIMD_WIDTH):
            store(x, j, s, positive(load(x, j, s)))


@njit(fastmath=True, cache=True, error_model="numpy", forceinline=True)
def relu_backward(y, dy, n):
    """Clear dy where the output y of the ReLU is not positive."""
    for j in range(y.shape[0]):
        for s in range(n):
            dy[j, s] = dy[j, s] if y[j, s] > ZERO else ZERO
