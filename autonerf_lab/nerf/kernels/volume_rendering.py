"""Volume rendering along one ray, forward and backward: the building blocks of the fused kernels.

For bins with densities sigma_i and lengths delta_i (section 3.2 of the paper, after Max 1995)::

    alpha_i = 1 - exp(-sigma_i delta_i)        T_i = prod_{j < i} (1 - alpha_j)        w_i = T_i alpha_i

Torch references with the same names: :mod:`autonerf_lab.nerf.rendering`.
"""

from typing import NamedTuple

import numpy as np
from numba import njit, prange

from autonerf_lab.nerf.kernels.tiling import ONE, SMALLEST, ZERO

# Added to the output of the density network, which starts near 0: the initial density is low enough for rays to reach
# the walls.
LOG_SIGMA_START = np.float32(-2.5)
MAX_LOG_SIGMA = np.float32(9.6)  # upper limit of the log density, so that float32 stays finite
MAX_ERROR = np.float32(1e3)  # metres; larger errors of a signed distance count linearly, as squares exceed float32


class SurfaceProfile(NamedTuple):
    """Log density around a measured surface, float32."""

    log_density: np.float32  # at the surface, of the density per metre
    sharpness: np.float32  # growth per metre
    log_free: np.float32  # in front of the surface
    behind: np.float32  # largest distance behind the surface that is compared, metres


@njit(inline="always")
def density_from_raw(raw):
    """Return the density per metre for the first output of a density network."""
    return np.exp(min(raw + LOG_SIGMA_START, MAX_LOG_SIGMA))


@njit(fastmath=True, cache=True, error_model="numpy", forceinline=True)
def ray_weights(raw, starts, ends, weights):
    """Write the weights of one ray and return the transmittance behind the last bin.

    Args:
        raw: (S,) first outputs of a density network (log density).
        starts, ends: (S,) distances along the ray, metres; space between two bins is empty.
        weights: (S,), written.
    """
    transmittance = ONE
    for i in range(weights.shape[0]):
        through = np.exp(-density_from_raw(raw[i]) * (ends[i] - starts[i]))
        weights[i] = transmittance * (ONE - through)
        transmittance *= through
    return transmittance


@njit(fastmath=True, cache=True, error_model="numpy", forceinline=True)
def ray_weights_backward(raw, starts, ends, weights, left, d_weights, d_left, d_raw):
    """Write the gradient of the raw densities.

    ``left`` is the transmittance that :func:`ray_weights` returned, ``d_left`` its gradient.

    With A_i = T_{i+1} dL/dw_i - sum_{j > i} w_j dL/dw_j - left dL/dleft: dL/dsigma_i = delta_i A_i.
    """
    behind = left * d_left
    transmittance = left
    for i in range(weights.shape[0] - 1, -1, -1):
        d_raw[i] = np.float32(0.0)
        if raw[i] + LOG_SIGMA_START < MAX_LOG_SIGMA:
            optical = density_from_raw(raw[i]) * (ends[i] - starts[i])
            d_raw[i] = optical * (transmittance * d_weights[i] - behind)
        behind += weights[i] * d_weights[i]
        transmittance += weights[i]  # T_i = T_{i+1} + w_i


@njit(fastmath=True, cache=True, error_model="numpy", forceinline=True)
def median_depth(starts, ends, weights):
    """Return the distance at which half of the total weight is reached, linear inside a bin."""
    half = np.float32(0.5) * weights.sum()
    passed = np.float32(0.0)
    for i in range(weights.shape[0]):
        if passed + weights[i] >= half:
            share = (half - passed) / max(weights[i], np.float32(1e-10))
            return starts[i] + share * (ends[i] - starts[i])
        passed += weights[i]
    return ends[-1]


@njit(fastmath=True, cache=True, error_model="numpy", forceinline=True)
def warp(t, turn):
    """Map a distance to s in [0, 1): linear up to ``turn`` metres (s = 0.5), then linear in disparity."""
    return np.float32(0.5) * t / turn if t < turn else ONE - np.float32(0.5) * turn / max(t, turn)


@njit(fastmath=True, cache=True, error_model="numpy", forceinline=True)
def unwarp(s, turn):
    """Invert :func:`warp`."""
    return np.float32(2.0) * s * turn if s < 0.5 else np.float32(0.5) * turn / max(ONE - s, np.float32(1e-7))


@njit(fastmath=True, cache=True, error_model="numpy", forceinline=True)
def distortion(starts, ends, weights, turn, scale, d_weights):
    """Return the distortion loss (Barron et al. 2022, equation 15), and add its gradient to ``d_weights``.

    In warped distances: sum_ij w_i w_j |m_i - m_j| + sum_i w_i^2 (s_{i+1} - s_i) / 3 with m the bin midpoints, computed
    in linear time from prefix sums.
    """
    count = weights.shape[0]
    total_w, total_wm = np.float32(0.0), np.float32(0.0)
    for i in range(count):
        middle = np.float32(0.5) * (warp(starts[i], turn) + warp(ends[i], turn))
        total_w += weights[i]
        total_wm += weights[i] * middle
    loss, w_front, wm_front = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    for i in range(count):
        near, far = warp(starts[i], turn), warp(ends[i], turn)
        middle, w = np.float32(0.5) * (near + far), weights[i]
        w_back, wm_back = total_w - w_front - w, total_wm - wm_front - w * middle
        pull = (middle * w_front - wm_front) + (wm_back - middle * w_back)
        width = (far - near) / np.float32(3.0)
        loss += w * pull + w * w * width
        d_weights[i] += scale * np.float32(2.0) * (pull + w * width)
        w_front += w
        wm_front += w * middle
    return loss


@njit(fastmath=True, cache=True, error_model="numpy", forceinline=True)
def surface_error(raw, starts, ends, depth, surface, scale, d_raw):
    """Return the squared error of the signed distances that log densities imply; add its gradient to ``d_raw``.

    At a distance x behind a measured surface the log density should be ``surface.log_density + surface.sharpness x``,
    but at least ``surface.log_free``; lower values in free space are no error. Bins further than ``surface.behind``
    behind the surface are not compared. Errors above ``MAX_ERROR`` count linearly.

    Args:
        raw: (S,) first outputs of a density network (log density).
        starts, ends: (S,) distances along the ray, metres.
        depth: measured distance along the ray, metres.
        surface: a :class:`SurfaceProfile`.
        scale: factor of the gradient.
        d_raw: (S,), added to.
    """
    total = ZERO
    for i in range(raw.shape[0]):
        behind = np.float32(0.5) * (starts[i] + ends[i]) - depth
        if behind > surface.behind:
            break
        wanted = surface.log_density + surface.sharpness * behind
        error = (raw[i] + LOG_SIGMA_START - max(wanted, surface.log_free)) / surface.sharpness
        if wanted > surface.log_free or error > ZERO:
            bounded = min(max(error, -MAX_ERROR), MAX_ERROR)
            total += bounded * (error - np.float32(0.5) * bounded)
            d_raw[i] += scale * bounded / surface.sharpness
    return total


@njit(fastmath=True, cache=True, error_model="numpy", inline="always")
def contracted(position, center, half, shell):
    """Return a coordinate contracted into the unit cube; see :class:`~autonerf_lab.nerf.scene_box.SceneBox`."""
    u = (position - center) / half
    beyond = abs(u) - ONE
    if beyond > 0:
        u = np.sign(u) * (ONE + shell - shell * shell / (beyond + shell))
    return np.float32(0.5) + np.float32(0.5) * u / (ONE + shell)


@njit(parallel=True, fastmath=True, cache=True, error_model="numpy")
def contracted_points(points, center, half, shell, x):
    """Write points, contracted into the unit cube.

    Args:
        points: (N, 3) float32, metres.
        center, half, shell: as in :func:`ray_points`.
        x: (3, M) with M >= N, written; columns beyond N repeat the last point.
    """
    last = points.shape[0] - 1
    for n in prange(x.shape[1]):
        row = min(np.int64(n), last)
        for axis in range(3):
            x[axis, n] = contracted(points[row, axis], center[axis], half[axis], shell)


@njit(parallel=True, fastmath=True, cache=True, error_model="numpy")
def ray_points(rays_o, rays_d, midpoints, center, half, shell, x):
    """Write the bin midpoints of all rays, contracted into the unit cube.

    Args:
        rays_o, rays_d: (R, 3) float32, unit directions.
        midpoints: (R, S) distances, metres.
        center, half: (3,) centre and half size of the uncontracted box, metres.
        shell: thickness of the shell that holds the rest of the world, in half sizes of the box.
        x: (3, R * S), written.
    """
    count = midpoints.shape[1]
    for r in prange(midpoints.shape[0]):
        for i in range(count):
            t = midpoints[r, i]
            for axis in range(3):
                position = rays_o[r, axis] + t * rays_d[r, axis]
                x[axis, r * count + i] = contracted(position, center[axis], half[axis], shell)


@njit(parallel=True, fastmath=True, cache=True, error_model="numpy")
def ray_points_backward(rays_o, rays_d, midpoints, center, half, shell, d_x, d_o, d_d):
    """Write the gradients (R, 3) of origins and directions, with the distances held fixed."""
    count = midpoints.shape[1]
    for r in prange(midpoints.shape[0]):
        for axis in range(3):
            sum_o, sum_d = np.float32(0.0), np.float32(0.0)
            for i in range(count):
                t = midpoints[r, i]
                beyond = abs((rays_o[r, axis] + t * rays_d[r, axis] - center[axis]) / half[axis]) - ONE
                slope = ONE if beyond <= 0 else shell * shell / ((beyond + shell) * (beyond + shell))
                g = d_x[axis, r * count + i] * slope * np.float32(0.5) / ((ONE + shell) * half[axis])
                sum_o += g
                sum_d += g * t
            d_o[r, axis] = sum_o
            d_d[r, axis] = sum_d


@njit(parallel=True, fastmath=True, cache=True, error_model="numpy")
def resample(edges, weights, jitter, padding, out):
    """Resample bins by stratified inverse transform sampling of a histogram.

    Args:
        edges: (R, P + 1) distances.
        weights: (R, P) of the bins between the edges.
        jitter: (R,) in [0, 1), position of each new edge in its stratum; 0.5 for evaluation.
        padding: added to every weight, so that every bin can be sampled.
        out: (R, S + 1), written, increasing; the first and last edge stay.
    """
    bins, count = weights.shape[1], out.shape[1] - 1
    for r in prange(edges.shape[0]):
        total = max(weights[r].sum() + padding * bins, SMALLEST)
        j, passed = 0, np.float32(0.0)
        share = (weights[r, 0] + padding) / total
        out[r, 0], out[r, count] = edges[r, 0], edges[r, bins]
        for i in range(1, count):
            u = (i - np.float32(0.5) + jitter[r]) / count
            while passed + share < u and j < bins - 1:
                passed += share
                j += 1
                share = (weights[r, j] + padding) / total
            inside = min(max((u - passed) / max(share, SMALLEST), np.float32(0.0)), ONE)
            out[r, i] = edges[r, j] + inside * (edges[r, j + 1] - edges[r, j])


@njit(fastmath=True, cache=True, error_model="numpy", forceinline=True)
def interlevel(edges, weights, fine_edges, fine_weights, scale, d_weights):
    """Return the interlevel loss of one ray (Barron et al. 2022, equation 13).

    The proposal bins that overlap a fine bin must have at least its weight.

    Args:
        edges, weights: (P + 1,), (P,) proposal histogram.
        fine_edges, fine_weights: (S + 1,), (S,) fine histogram, not differentiated.
        scale: factor of the gradient.
        d_weights: (P,), written.
    """
    bins, count = weights.shape[0], fine_weights.shape[0]
    d_weights[:] = 0
    loss = np.float32(0.0)
    low = 0
    for i in range(count):
        while low < bins - 1 and edges[low + 1] <= fine_edges[i]:
            low += 1
        high, bound = low, np.float32(0.0)
        while True:
            bound += weights[high]
            high += 1
            if high >= bins or edges[high] >= fine_edges[i + 1]:
                break
        excess = fine_weights[i] - bound
        if excess > 0:
            share = excess / (fine_weights[i] + np.float32(1e-7))
            loss += share * excess
            for j in range(low, high):
                d_weights[j] -= scale * np.float32(2.0) * share
    return loss


@njit(parallel=True, fastmath=True, cache=True, error_model="numpy")
def first_edges(near, far, turn, jitter, out):
    """Write the edges of piecewise sampling (section 3.2): equal steps in warped distance, shifted by the jitter.

    Args:
        near, far: ends of the rays, metres.
        turn: distance where the warp changes from linear to disparity, metres.
        jitter: (R,) in [0, 1); 0.5 for evaluation.
        out: (R, P + 1), written, metres.
    """
    count = out.shape[1] - 1
    low, high = warp(near, turn), warp(far, turn)
    for r in prange(out.shape[0]):
        for i in range(count + 1):
            shift = jitter[r] - np.float32(0.5) if 0 < i < count else np.float32(0.0)
            out[r, i] = unwarp(low + (high - low) * (i + shift) / count, turn)
