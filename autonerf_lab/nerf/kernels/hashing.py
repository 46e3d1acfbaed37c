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


@njit(inline="always")
def corner_index(ix, iy, iz, stride_y, stride_z, mask):
    """Row of a grid corner: a plain 3-D index where the level fits its table (mask 0), else the spatial hash."""
    if mask == 0:
        return ix + iy * stride_y + iz * stride_z
    return (ix ^ (iy * PRIME_Y) ^ (iz * PRIME_Z)) & mask


@njit(inline="always")
def _locate(x, resolution):
    """Cell and position inside it along one axis; x = 1 belongs to the last cell."""
    scaled = x * np.float32(resolution)
    cell = min(max(int(scaled), 0), resolution - 1)
    return cell, scaled - np.float32(cell)


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
    per_chunk = max(1, 4096 // width)
    chunks = (blocks + per_chunk - 1) // per_chunk
    for job in prange(chunks * levels):
        level, first = job % levels, (job // levels) * per_chunk
        rx, ry, rz = resolutions[level]
        stride_y, stride_z = rx + 1, (rx + 1) * (ry + 1)
        mask, offset = masks[level], offsets[level]
        for n in range(first * width, min(first + per_chunk, blocks) * width):
            ix, fx = _locate(x[0, n], rx)
            iy, fy = _locate(x[1, n], ry)
            iz, fz = _locate(x[2, n], rz)
            a, b = np.float32(0.0), np.float32(0.0)
            for corner in range(8):
                dx, dy, dz = corner & 1, (corner >> 1) & 1, corner >> 2
                w = (fx if dx else 1 - fx) * (fy if dy else 1 - fy) * (fz if dz else 1 - fz)
                row = offset + corner_index(ix + dx, iy + dy, iz + dz, stride_y, stride_z, mask)
                a += w * table[row, 0]
                b += w * table[row, 1]
            block, column = n // width, n % width
            out[block, 2 * level, column] = a
            out[block, 2 * level + 1, column] = b


@njit(parallel=True, fastmath=True, cache=True, error_model="numpy")
def hash_encode_backward(x, d_out, offsets, resolutions, masks, d_table):
    """Adds the gradient of the table.

    Args:
        x, offsets, resolutions, masks: as in :func:`hash_encode`.
        d_out: (B, 2 L, W) float32, gradient of its output.
        d_table: (entries, 2) float32, added to.
    """
    levels, count, width = resolutions.shape[0], x.shape[1], d_out.shape[2]
    for level in prange(levels):
        rx, ry, rz = resolutions[level]
        stride_y, stride_z = rx + 1, (rx + 1) * (ry + 1)
        mask, offset = masks[level], offsets[level]
        for n in range(count):
            block, column = n // width, n % width
            ga, gb = d_out[block, 2 * level, column], d_out[block, 2 * level + 1, column]
            if ga == 0.0 and gb == 0.0:
                continue
            ix, fx = _locate(x[0, n], rx)
            iy, fy = _locate(x[1, n], ry)
            iz, fz = _locate(x[2, n], rz)
            for corner in range(8):
                dx, dy, dz = corner & 1, (corner >> 1) & 1, corner >> 2
                w = (fx if dx else 1 - fx) * (fy if dy else 1 - fy) * (fz if dz else 1 - fz)
                row = offset + corner_index(ix + dx, iy + dy, iz + dz, stride_y, stride_z, mask)
                d_table[row, 0] += w * ga
                d_table[row, 1] += w * gb


@njit(parallel=True, fastmath=True, cache=True, error_model="numpy")
def hash_encode_points_backward(x, table, d_out, offsets, resolutions, masks, d_x):
    """Gradient of the points, which pose refinement needs.

    Args:
        x, table, offsets, resolutions, masks: as in :func:`hash_encode`.
        d_out: (B, 2 L, W) float32, gradient of its output.
        d_x: (3, N) float32, written.
    """
    levels, count, width = resolutions.shape[0], x.shape[1], d_out.shape[2]
    for n in prange(count):
        block, column = n // width, n % width
        gx, gy, gz = np.float32(0.0), np.float32(0.0), np.float32(0.0)
        for level in range(levels):
            rx, ry, rz = resolutions[level]
            stride_y, stride_z = rx + 1, (rx + 1) * (ry + 1)
            mask, offset = masks[level], offsets[level]
            ga, gb = d_out[block, 2 * level, column], d_out[block, 2 * level + 1, column]
            ix, fx = _locate(x[0, n], rx)
            iy, fy = _locate(x[1, n], ry)
            iz, fz = _locate(x[2, n], rz)
            for corner in range(8):
                dx, dy, dz = corner & 1, (corner >> 1) & 1, corner >> 2
                wx, wy, wz = fx if dx else 1 - fx, fy if dy else 1 - fy, fz if dz else 1 - fz
                row = offset + corner_index(ix + dx, iy + dy, iz + dz, stride_y, stride_z, mask)
                value = ga * table[row, 0] + gb * table[row, 1]
                gx += (rx if dx else -rx) * wy * wz * value
                gy += (ry if dy else -ry) * wx * wz * value
                gz += (rz if dz else -rz) * wx * wy * value
        d_x[0, n] = gx
        d_x[1, n] = gy
        d_x[2, n] = gz
