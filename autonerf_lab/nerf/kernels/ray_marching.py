"""Ray marching through an occupancy grid (Müller et al. 2022, appendix E)."""

import numpy as np
from numba import njit, prange

from autonerf_lab.nerf.kernels.tiling import ONE, ZERO
from autonerf_lab.nerf.kernels.volume_rendering import contracted

OPAQUE = np.float32(1e-2)  # transmittance by the densities of the grid, below which a ray may stop
DARK_DEPTH = np.float32(9.2)  # optical depth in the field behind which a ray is dark: a transmittance of 1e-4


@njit(parallel=True, fastmath=True, cache=True, error_model="numpy")
def occupied_bins(
    rays_o, rays_d, edges, center, half, shell, density, threshold, reach, jitter, starts, ends
):  # fmt: skip
    """Place S bins of equal length in the occupied segments of each ray.

    A ray ends where its transmittance, by the densities of the grid, falls below :data:`OPAQUE`, but not before it has
    crossed ``reach`` metres of occupied space: a dense cell need not be dense everywhere, and a ray that grazes an edge
    must continue. A ray that crosses no occupied cell is divided over its whole length.

    Args:
        rays_o, rays_d: (R, 3) float32, unit directions.
        edges: (R, P + 1) distances between which the grid is queried, metres.
        center, half, shell: scene box, as in :func:`~autonerf_lab.nerf.kernels.volume_rendering.ray_points`.
        density: (X, Y, Z) float32 grid over the contracted cube, per metre.
        threshold: smallest density of an occupied cell, per metre.
        reach: smallest length of occupied space that a ray crosses, metres.
        jitter: (R,) in [0, 1), shift of the bin midpoints; 0.5 for evaluation.
        starts, ends: (R, S), written, metres.
    """
    steps, count = edges.shape[1] - 1, starts.shape[1]
    for r in prange(rays_o.shape[0]):
        occupied = np.zeros(steps, np.bool_)
        total, light = ZERO, ONE
        for i in range(steps):
            t, length = np.float32(0.5) * (edges[r, i] + edges[r, i + 1]), edges[r, i + 1] - edges[r, i]
            found = density[_cell(rays_o, rays_d, r, t, center, half, shell, density.shape)]
            if found >= threshold:
                occupied[i] = True
                total += length
                light *= np.exp(-found * length)
                if light < OPAQUE and total > reach:
                    break
        if total == ZERO:
            occupied[:] = True
            total = edges[r, steps] - edges[r, 0]
        width = total / np.float32(count)
        passed, k = ZERO, 0
        for i in range(steps):
            if not occupied[i]:
                continue
            length = edges[r, i + 1] - edges[r, i]
            while k < count:
                # midpoint of bin k, in metres of occupied space
                wanted = (np.float32(k) + np.float32(0.25) + np.float32(0.5) * jitter[r]) * width
                if wanted > passed + length:
                    break
                middle = edges[r, i] + (wanted - passed)
                starts[r, k], ends[r, k] = middle - np.float32(0.5) * width, middle + np.float32(0.5) * width
                k += 1
            passed += length
        while k < count:  # by rounding, bins may be left at the end of the ray
            starts[r, k], ends[r, k] = edges[r, steps], edges[r, steps]
            k += 1


@njit(parallel=True, fastmath=True, cache=True, error_model="numpy")
def visible_bins(marched_starts, marched_ends, density, jitter, starts, ends):
    """Divide the marched bins of each ray, up to the one behind which it is dark, into S bins.

    Args:
        marched_starts, marched_ends: (R, M), metres.
        density: (R, M) float32 of the field in the marched bins, per metre.
        jitter: (R,) in [0, 1), shift of the bin midpoints; 0.5 for evaluation.
        starts, ends: (R, S), written, metres.
    """
    marched, count = density.shape[1], starts.shape[1]
    for r in prange(density.shape[0]):
        depth, kept = ZERO, 0
        while kept < marched and depth <= DARK_DEPTH:
            depth += density[r, kept] * (marched_ends[r, kept] - marched_starts[r, kept])
            kept += 1
        scale = np.float32(kept) / np.float32(count)
        for k in range(count):
            # midpoint of bin k, counted in marched bins
            wanted = (np.float32(k) + np.float32(0.25) + np.float32(0.5) * jitter[r]) * scale
            i = min(int(wanted), kept - 1)
            length = marched_ends[r, i] - marched_starts[r, i]
            middle = marched_starts[r, i] + (wanted - np.float32(i)) * length
            half = np.float32(0.5) * scale * length
            starts[r, k], ends[r, k] = middle - half, middle + half


@njit(inline="always")
def _cell(rays_o, rays_d, r, t, center, half, shell, shape):
    i = _index(rays_o[r, 0] + t * rays_d[r, 0], center[0], half[0], shell, shape[0])
    j = _index(rays_o[r, 1] + t * rays_d[r, 1], center[1], half[1], shell, shape[1])
    k = _index(rays_o[r, 2] + t * rays_d[r, 2], center[2], half[2], shell, shape[2])
    return i, j, k


@njit(inline="always")
def _index(position, center, half, shell, size):
    return min(max(int(contracted(position, center, half, shell) * np.float32(size)), 0), size - 1)
