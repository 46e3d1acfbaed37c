"""Signed distances fused from measured depth, and bins placed near the surfaces that they show.

A distance grid holds int16 millimetres: near a measured surface its truncated signed distance, positive in front
(Curless and Levoy 1996); in free space a lower bound of the distance to the next voxel that is not free; and
:data:`UNKNOWN` where no ray has passed.
"""

import numpy as np
from numba import njit, prange

from autonerf_lab.nerf.kernels.tiling import ONE, SMALLEST, TWO, ZERO

UNKNOWN = np.int16(32767)
MILLIMETRE = np.float32(0.001)
CERTAIN = np.float32(30.0)  # metres; larger values are unknown
SLABS = 8  # of the grid, for the threads that fuse depth
MAX_STEPS = 512  # of a ray
SECANT_STEPS = 4  # of the search for the fused surface near a measured depth
MET = np.float32(0.004)  # metres; a smaller distance is on the surface
# Bins per metre of a ray, relative to those around its surface.
NEAR_SHARE = np.float32(0.3)  # near surfaces that a training ray passes, where the field must learn to be empty
UNKNOWN_SHARE = np.float32(0.05)
FREE_SHARE = np.float32(0.01)
MAX_BLIND = np.float32(0.1)  # metres of unknown space behind a surface, after which a ray ends


@njit(parallel=True, cache=True, error_model="numpy")
def fuse(rays_o, rays_d, depth, origin, voxel, truncation, carve_every, total, count):
    """Add the truncated signed distances of measured rays to the voxels that they cross.

    Threads take slabs of the grid. So every voxel adds its rays in their order, whatever the number of threads.

    Args:
        rays_o, rays_d: (N, 3) float32, unit directions.
        depth: (N,) float32 distance along the ray, metres.
        origin: (3,) float32 outer corner of voxel [0, 0, 0], metres.
        voxel, truncation: metres.
        carve_every: one in so many rays also marks the free space in front of its surface.
        total: (X, Y, Z) float32 sum of distances, metres, added to.
        count: (X, Y, Z) float32 number of rays, added to.
    """
    step, half = np.float32(0.75) * voxel, np.float32(0.5)
    nx, ny, nz = total.shape
    for slab in prange(SLABS):
        first, end = slab * nx // SLABS, (slab + 1) * nx // SLABS
        low, high = origin[0] + np.float32(first - 1) * voxel, origin[0] + np.float32(end + 1) * voxel
        for n in range(rays_o.shape[0]):
            t = ZERO if n % carve_every == 0 else max(depth[n] - truncation, ZERO)
            last_t = depth[n] + truncation
            first_x, last_x = rays_o[n, 0] + t * rays_d[n, 0], rays_o[n, 0] + last_t * rays_d[n, 0]
            if max(first_x, last_x) < low or min(first_x, last_x) > high:
                continue
            last_i, last_j, last_k = -1, -1, -1
            while t <= last_t:
                i = int((rays_o[n, 0] + t * rays_d[n, 0] - origin[0]) / voxel)
                j = int((rays_o[n, 1] + t * rays_d[n, 1] - origin[1]) / voxel)
                k = int((rays_o[n, 2] + t * rays_d[n, 2] - origin[2]) / voxel)
                t += step
                if i < first or i >= end or (i == last_i and j == last_j and k == last_k):
                    continue
                last_i, last_j, last_k = i, j, k
                if j < 0 or k < 0 or j >= ny or k >= nz:
                    continue
                along = (origin[0] + (np.float32(i) + half) * voxel - rays_o[n, 0]) * rays_d[n, 0]
                along += (origin[1] + (np.float32(j) + half) * voxel - rays_o[n, 1]) * rays_d[n, 1]
                along += (origin[2] + (np.float32(k) + half) * voxel - rays_o[n, 2]) * rays_d[n, 2]
                distance = depth[n] - along
                if distance >= -truncation:
                    total[i, j, k] += min(distance, truncation)
                    count[i, j, k] += ONE


@njit(parallel=True, cache=True, error_model="numpy")
def finish(total, count, voxel, truncation, grid):
    """Write the (X, Y, Z) int16 distance grid of fused distances.

    The distances in free space are exact in the chessboard metric, a lower bound of the Euclidean one: two sweeps, each
    from the 13 neighbours that come before a voxel.
    """
    nx, ny, nz = grid.shape
    limit, side = int(np.rint(truncation / MILLIMETRE)), int(np.rint(voxel / MILLIMETRE))
    for i in prange(nx):
        for j in range(ny):
            for k in range(nz):
                value = int(UNKNOWN)
                if count[i, j, k] > ZERO:
                    value = int(np.rint(total[i, j, k] / count[i, j, k] / MILLIMETRE))
                    if value >= limit - 1:
                        value = int(UNKNOWN) - 1  # free, distance not known yet
                grid[i, j, k] = value
    _sweep(grid, limit, side, 1)
    _sweep(grid, limit, side, -1)


@njit(cache=True, error_model="numpy")
def _sweep(grid, limit, side, sign):
    """Bound the distances of free voxels by those of the 13 neighbours that come before them in one direction."""
    nx, ny, nz = grid.shape
    for ii in range(nx):
        i = ii if sign > 0 else nx - 1 - ii
        for jj in range(ny):
            j = jj if sign > 0 else ny - 1 - jj
            for kk in range(nz):
                k = kk if sign > 0 else nz - 1 - kk
                nearest = int(grid[i, j, k])
                if nearest < limit or nearest == UNKNOWN:
                    continue
                if 0 < i < nx - 1 and 0 < j < ny - 1 and 0 < k < nz - 1:
                    for b in range(-1, 2):
                        for c in range(-1, 2):
                            nearest = min(nearest, _one_farther(grid[i - sign, j + b, k + c], limit, side))
                    for c in range(-1, 2):
                        nearest = min(nearest, _one_farther(grid[i, j - sign, k + c], limit, side))
                    nearest = min(nearest, _one_farther(grid[i, j, k - sign], limit, side))
                else:
                    nearest = limit
                grid[i, j, k] = max(nearest, limit)


@njit(inline="always")
def _one_farther(distance, limit, side):
    """Return the distance of a voxel beside a free one; the limit beside one that is not free."""
    return int(distance) + side if limit <= distance < UNKNOWN else limit


@njit(inline="always")
def _nearest(grid, x, y, z):
    """Return the distance of the voxel that holds a point, metres; CERTAIN or more if unknown."""
    inside = ZERO <= x < grid.shape[0] and ZERO <= y < grid.shape[1] and ZERO <= z < grid.shape[2]
    return MILLIMETRE * np.float32(grid[int(x), int(y), int(z)] if inside else UNKNOWN)


@njit(inline="always")
def _interpolated(grid, x, y, z):
    """Return the distance interpolated between the known voxels around a point, metres."""
    i, j, k = int(np.floor(x - np.float32(0.5))), int(np.floor(y - np.float32(0.5))), int(np.floor(z - np.float32(0.5)))
    total, known = ZERO, ZERO
    for corner in range(8):
        a, b, c = i + (corner >> 2), j + (corner >> 1 & 1), k + (corner & 1)
        if 0 <= a < grid.shape[0] and 0 <= b < grid.shape[1] and 0 <= c < grid.shape[2] and grid[a, b, c] != UNKNOWN:
            weight = ONE - abs(x - np.float32(0.5) - np.float32(a))
            weight *= ONE - abs(y - np.float32(0.5) - np.float32(b))
            weight *= ONE - abs(z - np.float32(0.5) - np.float32(c))
            known += weight
            total += weight * np.float32(grid[a, b, c])
    return MILLIMETRE * (total / known) if known > np.float32(0.4) else MILLIMETRE * np.float32(UNKNOWN)


@njit(inline="always")
def _place(o, d, t, origin, voxel):
    """Return where a point of a ray is in the grid, voxels."""
    return (
        (o[0] + t * d[0] - origin[0]) / voxel,
        (o[1] + t * d[1] - origin[1]) / voxel,
        (o[2] + t * d[2] - origin[2]) / voxel,
    )


@njit(inline="always")
def _distance_at(o, d, t, origin, voxel, grid):
    """Return the interpolated distance at a point of a ray, metres."""
    x, y, z = _place(o, d, t, origin, voxel)
    return _interpolated(grid, x, y, z)


@njit(parallel=True, cache=True, error_model="numpy")
def surface_depth(rays_o, rays_d, depth, origin, voxel, grid, reach, found):
    """Write where rays meet the fused surface near their measured depth: the root of the distance, by secant steps.

    Args:
        rays_o, rays_d: (R, 3) float32, unit directions.
        depth: (R,) float32 measured distance along the ray, metres, or 0.
        origin: (3,) float32 outer corner of voxel [0, 0, 0], metres.
        voxel: metres.
        grid: (X, Y, Z) int16 distance grid.
        reach: largest distance of the surface from the measured depth, metres.
        found: (R,), written, metres: the measured depth where no distance is known, and 0 without a surface in reach.
    """
    for r in prange(rays_o.shape[0]):
        o, d, last_t = rays_o[r], rays_d[r], depth[r]
        last = _distance_at(o, d, last_t, origin, voxel, grid) if last_t > ZERO else CERTAIN
        found[r] = last_t
        if last >= CERTAIN:
            continue
        nearest, met, t = abs(last), last_t, last_t + last
        for _ in range(SECANT_STEPS):
            distance = _distance_at(o, d, t, origin, voxel, grid)
            if distance >= CERTAIN:
                break
            if abs(distance) < nearest:
                nearest, met = abs(distance), t
            change = last - distance
            if nearest < MILLIMETRE or abs(change) < SMALLEST:
                break
            step = min(max(distance * (t - last_t) / change, -reach), reach)
            last_t, last = t, distance
            t += step
        found[r] = met if nearest < MET and abs(met - depth[r]) < reach else ZERO


@njit(fastmath=True, cache=True, error_model="numpy", forceinline=True)
def _measured_steps(o, d, surface, origin, voxel, grid, near, band, before, behind, ends, share):
    """Divide a ray up to its measured surface into steps, and return their number; see :func:`surface_bins`."""
    t, total, count, start = near, ZERO, 0, surface - before
    while t < start and count < MAX_STEPS - 1:
        x, y, z = _place(o, d, t, origin, voxel)
        distance = _nearest(grid, x, y, z)
        step, weight = voxel, NEAR_SHARE
        if distance > CERTAIN:
            weight = UNKNOWN_SHARE
        elif distance > band:
            step, weight = max(distance - band, voxel), FREE_SHARE
        step = min(step, start - t)
        t += step
        total += weight * step
        ends[count], share[count] = t, total
        count += 1
        if start - t < MILLIMETRE:
            break
    ends[count], share[count] = max(surface + behind, near + MILLIMETRE), total + max(surface + behind - t, MILLIMETRE)
    return count + 1


@njit(fastmath=True, cache=True, error_model="numpy", forceinline=True)
def _searched_steps(o, d, origin, voxel, grid, near, far, band, behind, ends, share):
    """Divide a ray into steps until it is behind a surface, and return their number; see :func:`surface_bins`.

    Voxels overestimate the distance to surfaces that rays graze, and thin objects make voxels beside them negative. So
    a ray searches its surface for some centimetres inside, and continues if it comes out again.
    """
    t, total, count, last, blind, inside = near, ZERO, 0, CERTAIN, ZERO, ZERO
    fine = np.float32(0.5) * voxel
    while t < far and count < MAX_STEPS:
        x, y, z = _place(o, d, t, origin, voxel)
        distance = _nearest(grid, x, y, z)
        if distance < band + voxel or distance > CERTAIN:
            distance = _interpolated(grid, x, y, z)
        step, weight = fine, ONE
        if distance > CERTAIN:
            # Beside a surface, unknown space may be its inside.
            weight = ONE if last < band and blind < behind else UNKNOWN_SHARE
            blind += step
            if blind > MAX_BLIND and last < ZERO:
                break
        else:
            last, blind = distance, ZERO
            inside = inside + step if distance < ZERO else ZERO
            if inside > TWO * behind:
                weight = FREE_SHARE
            elif distance > band:
                step, weight = max(distance - band, fine), FREE_SHARE
        t += step
        total += weight * step
        ends[count], share[count] = t, total
        count += 1
    if count == MAX_STEPS and t < far:  # the last step covers the rest, with few bins: most such rays missed a surface
        ends[count - 1], share[count - 1] = far, total + FREE_SHARE * (far - t)
    return count


@njit(parallel=True, fastmath=True, cache=True, error_model="numpy")
def surface_bins(rays_o, rays_d, depth, origin, voxel, grid, near, far, band, before, behind, jitter, edges):
    """Place the edges of S bins on each ray, most of them around its surface.

    A ray is divided into steps; the bins are equal shares of the lengths of the steps, weighted by what they cross.
    Rays without a measurement search the first surface of the grid.

    Args:
        rays_o, rays_d: (R, 3) float32, unit directions.
        depth: (R,) float32 measured distance along the ray, metres, or 0.
        origin: (3,) float32 outer corner of voxel [0, 0, 0], metres.
        voxel: metres.
        grid: (X, Y, Z) int16 distance grid.
        near, far: ends of a ray, metres.
        band: largest distance of a voxel that counts as near a surface, metres.
        before, behind: metres around a surface that the bins cover.
        jitter: (R,) in [0, 1), position of each inner edge in its share; 0.5 for evaluation.
        edges: (R, S + 1), written, increasing, metres.
    """
    count = edges.shape[1] - 1
    for r in prange(rays_o.shape[0]):
        ends, share = np.empty(MAX_STEPS, np.float32), np.empty(MAX_STEPS, np.float32)
        if depth[r] > ZERO:
            steps = _measured_steps(
                rays_o[r], rays_d[r], depth[r], origin, voxel, grid, near, band, before, behind, ends, share
            )
        else:
            steps = _searched_steps(rays_o[r], rays_d[r], origin, voxel, grid, near, far, band, behind, ends, share)
        edges[r, 0], edges[r, count] = near, ends[steps - 1]
        k, first, passed = 0, near, ZERO
        for i in range(1, count):
            wanted = share[steps - 1] * (np.float32(i) + jitter[r] - np.float32(0.5)) / np.float32(count)
            while k < steps - 1 and share[k] < wanted:
                first, passed = ends[k], share[k]
                k += 1
            inside = (wanted - passed) / max(share[k] - passed, SMALLEST)
            edges[r, i] = first + min(max(inside, ZERO), ONE) * (ends[k] - first)
