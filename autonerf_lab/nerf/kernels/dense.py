"""Dense layers for blocks that stay in the cache: activations are (features, samples), features a multiple of four.

Buffers are allocated once for the largest block; ``n`` says how many of their columns are in use.

A tile of the weights is held in registers while the samples stream past, which is what makes these thin products reach
a large part of the machine's peak: a library call pays more for its set-up than for the work. The tiles are written out
because the compiler does not find them; constants are float32 because one int or double makes it all double.
"""

from numba import njit

from autonerf_lab.nerf.kernels.blocks import ZERO


@njit(fastmath=True, cache=True, error_model="numpy")
def _tile_8(w, x, y, j, k, n):
    """Adds the product of a tile of 4 rows and 8 columns of the weights."""
    w00, w01, w02, w03, w04, w05, w06, w07 = (
        w[j + 0, k + 0],
        w[j + 0, k + 1],
        w[j + 0, k + 2],
        w[j + 0, k + 3],
        w[j + 0, k + 4],
        w[j + 0, k + 5],
        w[j + 0, k + 6],
        w[j + 0, k + 7],
    )
    w10, w11, w12, w13, w14, w15, w16, w17 = (
        w[j + 1, k + 0],
        w[j + 1, k + 1],
        w[j + 1, k + 2],
        w[j + 1, k + 3],
        w[j + 1, k + 4],
        w[j + 1, k + 5],
        w[j + 1, k + 6],
        w[j + 1, k + 7],
    )
    w20, w21, w22, w23, w24, w25, w26, w27 = (
        w[j + 2, k + 0],
        w[j + 2, k + 1],
        w[j + 2, k + 2],
        w[j + 2, k + 3],
        w[j + 2, k + 4],
        w[j + 2, k + 5],
        w[j + 2, k + 6],
        w[j + 2, k + 7],
    )
    w30, w31, w32, w33, w34, w35, w36, w37 = (
        w[j + 3, k + 0],
        w[j + 3, k + 1],
        w[j + 3, k + 2],
        w[j + 3, k + 3],
        w[j + 3, k + 4],
        w[j + 3, k + 5],
        w[j + 3, k + 6],
        w[j + 3, k + 7],
    )
    for s in range(n):
        x0, x1, x2, x3, x4, x5, x6, x7 = (
            x[k + 0, s],
            x[k + 1, s],
            x[k + 2, s],
            x[k + 3, s],
            x[k + 4, s],
            x[k + 5, s],
            x[k + 6, s],
            x[k + 7, s],
        )
        y[j + 0, s] += w00 * x0 + w01 * x1 + w02 * x2 + w03 * x3 + w04 * x4 + w05 * x5 + w06 * x6 + w07 * x7
        y[j + 1, s] += w10 * x0 + w11 * x1 + w12 * x2 + w13 * x3 + w14 * x4 + w15 * x5 + w16 * x6 + w17 * x7
        y[j + 2, s] += w20 * x0 + w21 * x1 + w22 * x2 + w23 * x3 + w24 * x4 + w25 * x5 + w26 * x6 + w27 * x7
        y[j + 3, s] += w30 * x0 + w31 * x1 + w32 * x2 + w33 * x3 + w34 * x4 + w35 * x5 + w36 * x6 + w37 * x7


@njit(fastmath=True, cache=True, error_model="numpy")
def _tile_4(w, x, y, j, k, n):
    """Adds the product of a tile of 4 rows and 4 columns of the weights."""
    w00, w01, w02, w03 = w[j + 0, k + 0], w[j + 0, k + 1], w[j + 0, k + 2], w[j + 0, k + 3]
    w10, w11, w12, w13 = w[j + 1, k + 0], w[j + 1, k + 1], w[j + 1, k + 2], w[j + 1, k + 3]
    w20, w21, w22, w23 = w[j + 2, k + 0], w[j + 2, k + 1], w[j + 2, k + 2], w[j + 2, k + 3]
    w30, w31, w32, w33 = w[j + 3, k + 0], w[j + 3, k + 1], w[j + 3, k + 2], w[j + 3, k + 3]
    for s in range(n):
        x0, x1, x2, x3 = x[k + 0, s], x[k + 1, s], x[k + 2, s], x[k + 3, s]
        y[j + 0, s] += w00 * x0 + w01 * x1 + w02 * x2 + w03 * x3
        y[j + 1, s] += w10 * x0 + w11 * x1 + w12 * x2 + w13 * x3
        y[j + 2, s] += w20 * x0 + w21 * x1 + w22 * x2 + w23 * x3
        y[j + 3, s] += w30 * x0 + w31 * x1 + w32 * x2 + w33 * x3


@njit(fastmath=True, cache=True, error_model="numpy")
def dense(weights, x, y, n):
    """Y = weights @ x, for weights (J, K), x (K, n), y (J, n); J and K multiples of 4."""
    for j in range(weights.shape[0]):
        for s in range(n):
            y[j, s] = ZERO
    dense_add(weights, x, y, n)


@njit(fastmath=True, cache=True, error_model="numpy")
def dense_add(weights, x, y, n):
    """Y += weights @ x."""
    rows, cols = weights.shape
    for j in range(0, rows, 4):
        for k in range(0, cols - 7, 8):
            _tile_8(weights, x, y, j, k, n)
        if cols % 8:
            _tile_4(weights, x, y, j, cols - 4, n)


@njit(fastmath=True, cache=True, error_model="numpy")
def weight_gradient(dy, x, dw, n):
    """Dw += dy @ x.T, for dy (J, n), x (K, n), dw (J, K); J and K multiples of 4."""
    rows, cols = dw.shape
    for j in range(0, rows, 4):
        for k in range(0, cols, 4):
            a00 = a01 = a02 = a03 = a10 = a11 = a12 = a13 = ZERO
            a20 = a21 = a22 = a23 = a30 = a31 = a32 = a33 = ZERO
            for s in range(n):
                d0, d1, d2, d3 = dy[j, s], dy[j + 1, s], dy[j + 2, s], dy[j + 3, s]
                x0, x1, x2, x3 = x[k, s], x[k + 1, s], x[k + 2, s], x[k + 3, s]
                a00 += d0 * x0
                a01 += d0 * x1
                a02 += d0 * x2
                a03 += d0 * x3
                a10 += d1 * x0
                a11 += d1 * x1
                a12 += d1 * x2
                a13 += d1 * x3
                a20 += d2 * x0
                a21 += d2 * x1
                a22 += d2 * x2
                a23 += d2 * x3
                a30 += d3 * x0
                a31 += d3 * x1
                a32 += d3 * x2
                a33 += d3 * x3
            dw[j, k] += a00
            dw[j, k + 1] += a01
            dw[j, k + 2] += a02
            dw[j, k + 3] += a03
            dw[j + 1, k] += a10
            dw[j + 1, k + 1] += a11
            dw[j + 1, k + 2] += a12
            dw[j + 1, k + 3] += a13
            dw[j + 2, k] += a20
            dw[j + 2, k + 1] += a21
            dw[j + 2, k + 2] += a22
            dw[j + 2, k + 3] += a23
            dw[j + 3, k] += a30
            dw[j + 3, k + 1] += a31
            dw[j + 3, k + 2] += a32
            dw[j + 3, k + 3] += a33


@njit(fastmath=True, cache=True, error_model="numpy")
def relu(x, n):
    """In place."""
    for j in range(x.shape[0]):
        for s in range(n):
            x[j, s] = max(x[j, s], ZERO)


@njit(fastmath=True, cache=True, error_model="numpy")
def relu_backward(y, dy, n):
    """Dy is cleared where the output y of the relu was not positive."""
    for j in range(y.shape[0]):
        for s in range(n):
            dy[j, s] = dy[j, s] if y[j, s] > ZERO else ZERO
