"""Volume rendering along one ray, forward and backward: the loops that the fused kernels are made of.

For bins with densities sigma_i and lengths delta_i (section 3.2 of the paper, after Max 1995)::

    alpha_i = 1 - exp(-sigma_i delta_i)        T_i = prod_{j < i} (1 - alpha_j)        w_i = T_i alpha_i

References with the same names in torch: :mod:`autonerf_lab.nerf.rendering`.
"""

import numpy as np
from numba import njit, prange

from autonerf_lab.nerf.kernels.tiling import ONE

# A fresh network answers 0: the scene starts as thin fog, so that every ray reaches its wall.
LOG_SIGMA_START = np.float32(-2.5)
MAX_LOG_SIGMA = np.float32(9.6)  # nothing needs to be more opaque, and float32 stays finite


@njit(inline="always")
def density_from_raw(raw):
    """Density per metre from a network's first output."""
    return np.exp(min(raw + LOG_SIGMA_START, MAX_LOG_SIGMA))


@njit(fastmath=True, cache=True, error_model="numpy")
def ray_weights(raw, starts, ends, weights):
    """Weights of one ray from the network's outputs; returns the light that passes all bins.

    Args:
        raw: (S,) first outputs of a density network.
        starts, ends: (S,) distances along the ray, metres; between two bins there is nothing.
        weights: (S,), written.
    """
    transmittance = ONE
    for i in range(weights.shape[0]):
        through = np.exp(-density_from_raw(raw[i]) * (ends[i] - starts[i]))
        weights[i] = transmittance * (ONE - through)
        transmittance *= through
    return transmittance


@njit(fastmath=True, cache=True, error_model="numpy")
def ray_weights_backward(raw, starts, ends, weights, left, d_weights, d_left, d_raw):
    """Gradient of the raw densities; ``left`` is what :func:`ray_weights` returned, ``d_left`` its gradient.

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


@njit(fastmath=True, cache=True, error_model="numpy")
def median_depth(starts, ends, weights):
    """Distance at which half of the collected weight lies in front."""
    half = np.float32(0.5) * weights.sum()
    passed = np.float32(0.0)
    for i in range(weights.shape[0]):
        if passed + weights[i] >= half:
            share = (half - passed) / max(weights[i], np.float32(1e-10))
            return starts[i] + share * (ends[i] - starts[i])
        passed += weights[i]
    return ends[-1]


@njit(fastmath=True, cache=True, error_model="numpy")
def warp(t, turn):
    """Distance -> s in [0, 1): linear up to ``turn`` metres (half of the range), then linear in disparity."""
    return np.float32(0.5) * t / turn if t < turn else ONE - np.float32(0.5) * turn / t


@njit(fastmath=True, cache=True, error_model="numpy")
def unwarp(s, turn):
    """The inverse of :func:`warp`."""
    return np.float32(2.0) * s * turn if s < 0.5 else np.float32(0.5) * turn / (ONE - s)


@njit(fastmath=True, cache=True, error_model="numpy")
def distortion(starts, ends, weights, turn, scale, d_weights):
    """Distortion loss of Barron et al. 2022 (equation 15) in warped distances; its gradient is added to ``d_weights``.

    sum_ij w_i w_j |m_i - m_j| + sum_i w_i^2 (s_{i+1} - s_i) / 3 with m the bin middles, in one pass each way.
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


@njit(fastmath=True, cache=True, error_model="numpy")
def expected_depth_error(starts, ends, weights, left, depth, scale, d_weights):
    """Absolute error of the expected depth, whose gradient is added to ``d_weights``; returns it and that of ``left``.

    Light that passes all bins ends where the last bin does.
    """
    last = ends[weights.shape[0] - 1]
    expected = left * last
    for i in range(weights.shape[0]):
        expected += weights[i] * np.float32(0.5) * (starts[i] + ends[i])
    slope = scale if expected > depth else -scale
    for i in range(weights.shape[0]):
        d_weights[i] += slope * np.float32(0.5) * (starts[i] + ends[i])
    return abs(expected - depth), slope * last


@njit(parallel=True, fastmath=True, cache=True, error_model="numpy")
def ray_points(rays_o, rays_d, middles, center, half, shell, x):
    """Bin middles of all rays, contracted into the unit cube.

    Args:
        rays_o, rays_d: (R, 3) float32, unit directions.
        middles: (R, S) distances, metres.
        center, half: (3,) the box that is kept as it is, metres.
        shell: thickness of the shell that holds all the rest, in half sizes of the box.
        x: (3, R * S), written.
    """
    count = middles.shape[1]
    for r in prange(middles.shape[0]):
        for i in range(count):
            t = middles[r, i]
            for axis in range(3):
                u = (rays_o[r, axis] + t * rays_d[r, axis] - center[axis]) / half[axis]
                beyond = abs(u) - ONE
                if beyond > 0:
                    u = np.sign(u) * (ONE + shell - shell * shell / (beyond + shell))
                x[axis, r * count + i] = np.float32(0.5) + np.float32(0.5) * u / (ONE + shell)


@njit(parallel=True, fastmath=True, cache=True, error_model="numpy")
def ray_points_backward(rays_o, rays_d, middles, center, half, shell, d_x, d_o, d_d):
    """Gradients of origins and directions (R, 3), written; the distances are held fixed."""
    count = middles.shape[1]
    for r in prange(middles.shape[0]):
        for axis in range(3):
            sum_o, sum_d = np.float32(0.0), np.float32(0.0)
            for i in range(count):
                t = middles[r, i]
                beyond = abs((rays_o[r, axis] + t * rays_d[r, axis] - center[axis]) / half[axis]) - ONE
                slope = ONE if beyond <= 0 else shell * shell / ((beyond + shell) * (beyond + shell))
                g = d_x[axis, r * count + i] * slope * np.float32(0.5) / ((ONE + shell) * half[axis])
                sum_o += g
                sum_d += g * t
            d_o[r, axis] = sum_o
            d_d[r, axis] = sum_d


@njit(parallel=True, fastmath=True, cache=True, error_model="numpy")
def resample(edges, weights, jitter, padding, out):
    """New bins where the weights are: inverse transform sampling of the histogram, stratified.

    Args:
        edges: (R, P + 1) distances.
        weights: (R, P) of the bins between them.
        jitter: (R,) in [0, 1), where in its stratum each new edge falls; 0.5 for evaluation.
        padding: added to every weight, so that no bin is impossible.
        out: (R, S + 1), written, increasing; first and last are the ends of the ray.
    """
    bins, count = weights.shape[1], out.shape[1] - 1
    for r in prange(edges.shape[0]):
        total = weights[r].sum() + padding * bins
        j, passed = 0, np.float32(0.0)
        share = (weights[r, 0] + padding) / total
        out[r, 0], out[r, count] = edges[r, 0], edges[r, bins]
        for i in range(1, count):
            u = (i - np.float32(0.5) + jitter[r]) / count
            while passed + share < u and j < bins - 1:
                passed += share
                j += 1
                share = (weights[r, j] + padding) / total
            inside = min(max((u - passed) / share, np.float32(0.0)), ONE)
            out[r, i] = edges[r, j] + inside * (edges[r, j + 1] - edges[r, j])


@njit(fastmath=True, cache=True, error_model="numpy")
def interlevel(edges, weights, fine_edges, fine_weights, scale, d_weights):
    """Loss of Barron et al. 2022 (equation 13): proposal bins must hold the weight of the fine bins over them.

    Args:
        edges, weights: (P + 1,), (P,) of the proposal.
        fine_edges, fine_weights: (S + 1,), (S,), not differentiated.
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
    """Piecewise sampling (section 3.2): equal steps in warped distance, shifted by each ray's jitter.

    Args:
        near, far, turn: metres.
        jitter: (R,) in [0, 1); 0.5 for evaluation.
        out: (R, P + 1), written.
    """
    count = out.shape[1] - 1
    low, high = warp(near, turn), warp(far, turn)
    for r in prange(out.shape[0]):
        for i in range(count + 1):
            shift = jitter[r] - np.float32(0.5) if 0 < i < count else np.float32(0.0)
            out[r, i] = unwarp(low + (high - low) * (i + shift) / count, turn)
