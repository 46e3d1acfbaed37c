"""Multi-resolution hash encoding on the CPU (Müller et al. 2022, section 3), forward and backward.

Same numbers as :mod:`autonerf_lab.nerf.encodings`, thirty times faster. Features come in blocks, (B, 2 L, W): block b
holds the points [b W, (b + 1) W) feature-major, which is what the fused kernels read. Forward runs in parallel over
points; the backward scatter runs in parallel over levels, each owned by one thread: no two threads add to one address,
and the sum is the same bits on any number of threads.
"""

import numpy as np
from numba import njit, prange

# The primes of the paper's equation 4; the first is 1, so that neighbours along x share a cache line.
PRIME_Y = 2654435761
PRIME_Z = 805459861
ZERO, ONE = np.float32(0.0), np.float32(1.0)  # an integer would make the arithmetic double


@njit(inline="always")
def _locate(x, resolution):
    """Cell and position inside it along one axis; x = 1 belongs to the last cell."""
    scaled = x * np.float32(resolution)
    cell = min(max(int(scaled), 0), resolution - 1)
    return cell, scaled - np.float32(cell)


@njit(inline="always")
def _corners(x, y, z, resolution, mask, offset):
    """Rows of the eight corners of a point's cell (x fastest), and its position in the cell.

    A level that fits its table (mask 0) is indexed as a plain 3-D grid, another one by the spatial hash.
    """
    ix, fx = _locate(x, resolution[0])
    iy, fy = _locate(y, resolution[1])
    iz, fz = _locate(z, resolution[2])
    if mask == 0:
        step_y = resolution[0] + 1
        step_z = step_y * (resolution[1] + 1)
        a = offset + ix + iy * step_y + iz * step_z
        b, c, d = a + step_y, a + step_z, a + step_y + step_z
        return a, a + 1, b, b + 1, c, c + 1, d, d + 1, fx, fy, fz
    y0, z0 = iy * PRIME_Y, iz * PRIME_Z
    y1, z1 = y0 + PRIME_Y, z0 + PRIME_Z
    jx, a, b, c, d = ix + 1, y0 ^ z0, y1 ^ z0, y0 ^ z1, y1 ^ z1
    return (
        offset + ((ix ^ a) & mask),
        offset + ((jx ^ a) & mask),
        offset + ((ix ^ b) & mask),
        offset + ((jx ^ b) & mask),
        offset + ((ix ^ c) & mask),
        offset + ((jx ^ c) & mask),
        offset + ((ix ^ d) & mask),
        offset + ((jx ^ d) & mask),
        fx,
        fy,
        fz,
    )


@njit(parallel=True, fastmath=True, cache=True, error_model="numpy")
def hash_encode(x, table, offsets, resolutions, masks, out):
    """Features of points.

    Args:
        x: (3, N) float32 in [0, 1].
        table: (entries, 2) float32, all levels one after the other.
        offsets: (L,) int64, first entry of each level.
        resolutions: (L, 3) int64, cells along each axis.
        masks: (L,) int64, table size - 1 where the level is hashed, 0 where it is dense.
        out: (B, 2 L, W) float32 with B W = N, written.
    """
    levels, blocks, width = resolutions.shape[0], out.shape[0], out.shape[2]
    # a chunk stays on one level for a while, so that the level's table stays in the cache
    per_chunk = max(1, 16384 // width)
    chunks = (blocks + per_chunk - 1) // per_chunk
    for job in prange(chunks * levels):
        level, first = job % levels, (job // levels) * per_chunk
        resolution, mask, offset = resolutions[level], masks[level], offsets[level]
        for block in range(first, min(first + per_chunk, blocks)):
            for column in range(width):
                n = block * width + column
                i0, i1, i2, i3, i4, i5, i6, i7, fx, fy, fz = _corners(
                    x[0, n], x[1, n], x[2, n], resolution, mask, offset
                )
                gx, gy, gz = ONE - fx, ONE - fy, ONE - fz
                w0, w1, w2, w3 = gy * gz, fy * gz, gy * fz, fy * fz
                for k in range(2):
                    out[block, 2 * level + k, column] = (
                        w0 * (gx * table[i0, k] + fx * table[i1, k])
                        + w1 * (gx * table[i2, k] + fx * table[i3, k])
                        + w2 * (gx * table[i4, k] + fx * table[i5, k])
                        + w3 * (gx * table[i6, k] + fx * table[i7, k])
                    )


@njit(parallel=True, fastmath=True, cache=True, error_model="numpy")
def hash_encode_backward(x, d_out, offsets, resolutions, masks, d_table):
    """Adds the gradient of the table.

    Args:
        x, offsets, resolutions, masks: as in :func:`hash_encode`.
        d_out: (B, 2 L, W) float32, gradient of its output.
        d_table: (entries, 2) float32, added to.
    """
    levels, blocks, width = resolutions.shape[0], d_out.shape[0], d_out.shape[2]
    for level in prange(levels):
        resolution, mask, offset = resolutions[level], masks[level], offsets[level]
        for block in range(blocks):
            for column in range(width):
                ga, gb = d_out[block, 2 * level, column], d_out[block, 2 * level + 1, column]
                if ga == ZERO and gb == ZERO:  # a sample that was not active
                    continue
                n = block * width + column
                i0, i1, i2, i3, i4, i5, i6, i7, fx, fy, fz = _corners(
                    x[0, n], x[1, n], x[2, n], resolution, mask, offset
                )
                gx, gy, gz = ONE - fx, ONE - fy, ONE - fz
                w0, w1, w2, w3 = gy * gz, fy * gz, gy * fz, fy * fz
                for i, w in ((i0, w0 * gx), (i1, w0 * fx), (i2, w1 * gx), (i3, w1 * fx)):
                    d_table[i, 0] += w * ga
                    d_table[i, 1] += w * gb
                for i, w in ((i4, w2 * gx), (i5, w2 * fx), (i6, w3 * gx), (i7, w3 * fx)):
                    d_table[i, 0] += w * ga
                    d_table[i, 1] += w * gb


@njit(parallel=True, fastmath=True, cache=True, error_model="numpy")
def hash_encode_points_backward(x, table, d_out, offsets, resolutions, masks, d_x):
    """Gradient of the points, which pose refinement needs.

    Args:
        x, table, offsets, resolutions, masks: as in :func:`hash_encode`.
        d_out: (B, 2 L, W) float32, gradient of its output.
        d_x: (3, N) float32, written.
    """
    levels, width = resolutions.shape[0], d_out.shape[2]
    for block in prange(d_out.shape[0]):
        for n in range(block * width, (block + 1) * width):
            d_x[0, n], d_x[1, n], d_x[2, n] = ZERO, ZERO, ZERO
        for level in range(levels):
            resolution, mask, offset = resolutions[level], masks[level], offsets[level]
            for column in range(width):
                ga, gb = d_out[block, 2 * level, column], d_out[block, 2 * level + 1, column]
                if ga == ZERO and gb == ZERO:
                    continue
                n = block * width + column
                i0, i1, i2, i3, i4, i5, i6, i7, fx, fy, fz = _corners(
                    x[0, n], x[1, n], x[2, n], resolution, mask, offset
                )
                gx, gy, gz = ONE - fx, ONE - fy, ONE - fz
                v0, v1 = ga * table[i0, 0] + gb * table[i0, 1], ga * table[i1, 0] + gb * table[i1, 1]
                v2, v3 = ga * table[i2, 0] + gb * table[i2, 1], ga * table[i3, 0] + gb * table[i3, 1]
                v4, v5 = ga * table[i4, 0] + gb * table[i4, 1], ga * table[i5, 0] + gb * table[i5, 1]
                v6, v7 = ga * table[i6, 0] + gb * table[i6, 1], ga * table[i7, 0] + gb * table[i7, 1]
                d_x[0, n] += np.float32(resolution[0]) * (
                    gy * gz * (v1 - v0) + fy * gz * (v3 - v2) + gy * fz * (v5 - v4) + fy * fz * (v7 - v6)
                )
                d_x[1, n] += np.float32(resolution[1]) * (
                    gx * gz * (v2 - v0) + fx * gz * (v3 - v1) + gx * fz * (v6 - v4) + fx * fz * (v7 - v5)
                )
                d_x[2, n] += np.float32(resolution[2]) * (
                    gx * gy * (v4 - v0) + fx * gy * (v5 - v1) + gx * fy * (v6 - v2) + fx * fy * (v7 - v3)
                )
