"""Multi-resolution hash encoding on the CPU (Müller et al. 2022, section 3), forward and backward.

Same values as :mod:`autonerf_lab.nerf.encodings`, many times faster. Features come in tiles, (B, E, W): tile b holds
the points [b W, (b + 1) W) feature-major, the layout of the fused kernels. Of the E features, two for each level are
written; the rest fills up to a multiple of 4. The table rows of a tile's corners are found
first, in 32-bit integers, which the compiler vectorises; a separate loop then reads the table. The forward pass is
parallel over points. The backward scatter is parallel over levels, each owned by one thread: no two threads add to one
address, and the sum has the same bits on any number of threads.
"""

import numpy as np
from numba import njit, prange

from autonerf_lab.nerf.kernels.tiling import ONE, ZERO

# The primes of the paper's equation 4; the first is 1, so that neighbours along x share a cache line.
PRIME_Y, PRIME_Z = np.uint32(2654435761), np.uint32(805459861)
ORIGIN, NEXT = np.int32(0), np.uint32(1)


@njit(inline="always")
def _locate(x, resolution):
    """Return the cell and the position inside it along one axis; x = 1 belongs to the last cell."""
    scaled = x * np.float32(resolution)
    cell = min(max(np.int32(scaled), ORIGIN), np.int32(resolution - 1))
    return np.uint32(cell), scaled - np.float32(cell)


@njit(inline="always")
def _corners(x, first, resolution, mask, rows, inside):
    """Write the table rows of the cell corners of a tile of points, for one level.

    A level that fits its table (mask 0) is indexed as a plain 3-D grid, any other by the spatial hash. The two cases
    are separate loops: with a branch inside, the compiler would not vectorise them.

    Args:
        x: (3, N) float32 in [0, 1].
        first: index of the tile's first point.
        resolution, mask: of the level, see :func:`hash_encode`.
        rows: (8, W) uint32, written: corners with x fastest and z slowest.
        inside: (3, W) float32, written: position in the cell.
    """
    rx, ry, rz = resolution
    step_y, step_z = np.uint32(rx + 1), np.uint32((rx + 1) * (ry + 1))
    last = np.uint32(mask)
    if mask == 0:
        for n in range(rows.shape[1]):
            ix, inside[0, n] = _locate(x[0, first + n], rx)
            iy, inside[1, n] = _locate(x[1, first + n], ry)
            iz, inside[2, n] = _locate(x[2, first + n], rz)
            a = ix + iy * step_y + iz * step_z
            b, c, d = a + step_y, a + step_z, a + step_y + step_z
            rows[0, n], rows[2, n], rows[4, n], rows[6, n] = a, b, c, d
            rows[1, n], rows[3, n], rows[5, n], rows[7, n] = a + NEXT, b + NEXT, c + NEXT, d + NEXT
    else:
        for n in range(rows.shape[1]):
            x0, inside[0, n] = _locate(x[0, first + n], rx)
            iy, inside[1, n] = _locate(x[1, first + n], ry)
            iz, inside[2, n] = _locate(x[2, first + n], rz)
            y0, z0 = iy * PRIME_Y, iz * PRIME_Z
            x1, y1, z1 = x0 + NEXT, y0 + PRIME_Y, z0 + PRIME_Z
            a, b, c, d = y0 ^ z0, y1 ^ z0, y0 ^ z1, y1 ^ z1
            rows[0, n], rows[2, n], rows[4, n], rows[6, n] = (
                (x0 ^ a) & last,
                (x0 ^ b) & last,
                (x0 ^ c) & last,
                (x0 ^ d) & last,
            )
            rows[1, n], rows[3, n], rows[5, n], rows[7, n] = (
                (x1 ^ a) & last,
                (x1 ^ b) & last,
                (x1 ^ c) & last,
                (x1 ^ d) & last,
            )


@njit(inline="always")
def _interpolate(entries, k, rows, inside, n):
    """Return feature k of point n by trilinear interpolation."""
    fx, fy, fz = inside[0, n], inside[1, n], inside[2, n]
    gx, gy, gz = ONE - fx, ONE - fy, ONE - fz
    return (
        gy * gz * (gx * entries[rows[0, n], k] + fx * entries[rows[1, n], k])
        + fy * gz * (gx * entries[rows[2, n], k] + fx * entries[rows[3, n], k])
        + gy * fz * (gx * entries[rows[4, n], k] + fx * entries[rows[5, n], k])
        + fy * fz * (gx * entries[rows[6, n], k] + fx * entries[rows[7, n], k])
    )


@njit(parallel=True, fastmath=True, cache=True, error_model="numpy")
def hash_encode(x, table, offsets, resolutions, masks, out):
    """Write the features of points.

    Args:
        x: (3, N) float32 in [0, 1].
        table: (entries, 2) float32, the levels in sequence.
        offsets: (L,) int64, first entry of each level.
        resolutions: (L, 3) int64, cells along each axis.
        masks: (L,) int64, table size - 1 where the level is hashed, 0 where it is dense.
        out: (B, E, W) float32 with B W = N, written.
    """
    levels, tiles, width = resolutions.shape[0], out.shape[0], out.shape[2]
    # A chunk stays on one level, so that the level's table stays in the cache. An even number suits two threads.
    chunks = 2 * max(1, tiles * width // 32768)
    per_chunk = (tiles + chunks - 1) // chunks
    for job in prange(chunks * levels):
        level, first = job % levels, (job // levels) * per_chunk
        rows, inside = np.empty((8, width), np.uint32), np.empty((3, width), np.float32)
        entries = table[offsets[level] :]
        for tile in range(first, min(first + per_chunk, tiles)):
            _corners(x, tile * width, resolutions[level], masks[level], rows, inside)
            out_0, out_1 = out[tile, 2 * level], out[tile, 2 * level + 1]
            for n in range(width):
                # Compute both values before writing one: the compiler must assume that a write changes the table.
                value_0, value_1 = _interpolate(entries, 0, rows, inside, n), _interpolate(entries, 1, rows, inside, n)
                out_0[n], out_1[n] = value_0, value_1


@njit(parallel=True, fastmath=True, cache=True, error_model="numpy")
def hash_encode_backward(x, d_out, offsets, resolutions, masks, d_table):
    """Add the gradient of the table.

    Args:
        x, offsets, resolutions, masks: as in :func:`hash_encode`.
        d_out: (B, E, W) float32, gradient of the features.
        d_table: (entries, 2) float32, added to.
    """
    levels, tiles, width = resolutions.shape[0], d_out.shape[0], d_out.shape[2]
    half = (levels + 1) // 2
    for job in prange(levels):
        # Every second level first: threads get runs of jobs, and coarse levels, which fit the cache, are faster.
        level = 2 * job if job < half else 2 * (job - half) + 1
        rows, inside = np.empty((8, width), np.uint32), np.empty((3, width), np.float32)
        entries = d_table[offsets[level] :]
        for tile in range(tiles):
            _corners(x, tile * width, resolutions[level], masks[level], rows, inside)
            for n in range(width):
                ga, gb = d_out[tile, 2 * level, n], d_out[tile, 2 * level + 1, n]
                if ga == ZERO and gb == ZERO:  # an inactive sample
                    continue
                fx, fy, fz = inside[0, n], inside[1, n], inside[2, n]
                gx, gy, gz = ONE - fx, ONE - fy, ONE - fz
                w0, w1, w2, w3 = gy * gz, fy * gz, gy * fz, fy * fz
                for k, w in ((0, w0 * gx), (1, w0 * fx), (2, w1 * gx), (3, w1 * fx)):
                    entries[rows[k, n], 0] += w * ga
                    entries[rows[k, n], 1] += w * gb
                for k, w in ((4, w2 * gx), (5, w2 * fx), (6, w3 * gx), (7, w3 * fx)):
                    entries[rows[k, n], 0] += w * ga
                    entries[rows[k, n], 1] += w * gb


@njit(parallel=True, fastmath=True, cache=True, error_model="numpy")
def hash_encode_points_backward(x, table, d_out, offsets, resolutions, masks, d_x):
    """Write the gradient of the points, for pose refinement.

    Args:
        x, table, offsets, resolutions, masks: as in :func:`hash_encode`.
        d_out: (B, E, W) float32, gradient of the features.
        d_x: (3, N) float32, written.
    """
    levels, width = resolutions.shape[0], d_out.shape[2]
    for tile in prange(d_out.shape[0]):
        rows, inside = np.empty((8, width), np.uint32), np.empty((3, width), np.float32)
        v = np.empty(8, np.float32)
        d_x[:, tile * width : (tile + 1) * width] = ZERO
        for level in range(levels):
            _corners(x, tile * width, resolutions[level], masks[level], rows, inside)
            entries = table[offsets[level] :]
            rx, ry, rz = (
                np.float32(resolutions[level, 0]),
                np.float32(resolutions[level, 1]),
                np.float32(resolutions[level, 2]),
            )
            for n in range(width):
                ga, gb = d_out[tile, 2 * level, n], d_out[tile, 2 * level + 1, n]
                if ga == ZERO and gb == ZERO:
                    continue
                fx, fy, fz = inside[0, n], inside[1, n], inside[2, n]
                gx, gy, gz = ONE - fx, ONE - fy, ONE - fz
                for k in range(8):
                    v[k] = ga * entries[rows[k, n], 0] + gb * entries[rows[k, n], 1]
                at = tile * width + n
                d_x[0, at] += rx * (
                    gy * gz * (v[1] - v[0])
                    + fy * gz * (v[3] - v[2])
                    + gy * fz * (v[5] - v[4])
                    + fy * fz * (v[7] - v[6])
                )
                d_x[1, at] += ry * (
                    gx * gz * (v[2] - v[0])
                    + fx * gz * (v[3] - v[1])
                    + gx * fz * (v[6] - v[4])
                    + fx * fz * (v[7] - v[5])
                )
                d_x[2, at] += rz * (
                    gx * gy * (v[4] - v[0])
                    + fx * gy * (v[5] - v[1])
                    + gx * fy * (v[6] - v[2])
                    + fx * fy * (v[7] - v[3])
                )
