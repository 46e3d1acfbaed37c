"""Volume rendering, sampling and losses of rays in torch: the readable reference of the fused kernels.

Shapes: (R, S) bins on R rays, from ``starts`` to ``ends`` (R, S), or between ``edges`` (R, S + 1) where bins touch;
lengths in units of the field, which are metres for trajectories, and densities per unit. CUDA trains with these
functions. On the CPU, :mod:`autonerf_lab.nerf.kernels` computes the same, and tests compare both.
"""

import math

import torch

from autonerf_lab.nerf.kernels import ray_marching, tiling, volume_rendering
from autonerf_lab.nerf.settings import Settings

# The constants of the kernels, as numbers that torch takes.
LOG_SIGMA_START, MAX_LOG_SIGMA = float(volume_rendering.LOG_SIGMA_START), float(volume_rendering.MAX_LOG_SIGMA)
OPAQUE, DARK_DEPTH = float(ray_marching.OPAQUE), float(ray_marching.DARK_DEPTH)
SMALLEST, MAX_ERROR = float(tiling.SMALLEST), float(volume_rendering.MAX_ERROR)


def density_from_raw(raw: torch.Tensor) -> torch.Tensor:
    """Return the density for the first output of a density network."""
    return torch.exp((raw + LOG_SIGMA_START).clamp(max=MAX_LOG_SIGMA))


def weights_from_density(sigma: torch.Tensor, starts: torch.Tensor, ends: torch.Tensor) -> torch.Tensor:
    """Return the volume-rendering weights w_i = T_i (1 - exp(-sigma_i delta_i)) of section 3.2.

    Args:
        sigma: (R, S) densities.
        starts, ends: (R, S).

    Returns:
        (R, S); 1 minus their sum is the transmittance behind the last bin.

    Example:
        >>> weights_from_density(torch.tensor([[0.6931, 50]]), torch.tensor([[0.0, 1.0]]), torch.tensor([[1.0, 2.0]]))
        tensor([[0.5000, 0.5000]])
    """
    optical = sigma * (ends - starts)
    transmittance = torch.exp(-torch.cumsum(torch.nn.functional.pad(optical, (1, 0)), dim=1)[:, :-1])
    return transmittance * (1 - torch.exp(-optical))


def composite(weights: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
    """Return (R, C) rendered values for (R, S) weights and (R, S, C) values."""
    return (weights[..., None] * values).sum(dim=1)


def median_depth(weights: torch.Tensor, starts: torch.Tensor, ends: torch.Tensor) -> torch.Tensor:
    """Return the (R,) distances at which half of the total weight is reached, linear inside a bin."""
    total = weights.cumsum(dim=1)
    half = total[:, -1:] / 2
    bin_ = torch.searchsorted(total, half).clamp(max=weights.shape[1] - 1)
    inside = (half - (total - weights).gather(1, bin_)) / weights.gather(1, bin_).clamp(min=1e-10)
    near, far = starts.gather(1, bin_), ends.gather(1, bin_)
    return (near + inside * (far - near))[:, 0]


def warp(t: torch.Tensor, turn: float) -> torch.Tensor:
    """Map a distance to s in [0, 1): linear up to ``turn``, then linear in disparity (piecewise sampling).

    Example:
        >>> warp(torch.tensor([2.0, 4.0, 8.0]), turn=4.0)
        tensor([0.2500, 0.5000, 0.7500])
    """
    return torch.where(t < turn, 0.5 * t / turn, 1 - 0.5 * turn / t.clamp(min=1e-9))


def unwarp(s: torch.Tensor, turn: float) -> torch.Tensor:
    """Invert :func:`warp`."""
    return torch.where(s < 0.5, 2 * s * turn, 0.5 * turn / (1 - s).clamp(min=1e-7))


def first_edges(near: float, far: float, turn: float, jitter: torch.Tensor, bins: int) -> torch.Tensor:
    """Return the bin edges of piecewise sampling: equal steps of s, inner edges shifted by the jitter of each ray.

    Args:
        near, far: ends of the rays.
        turn: distance where the warp changes from linear to disparity.
        jitter: (R,) in [0, 1); 0.5 for evaluation.
        bins: number of bins.

    Returns:
        (R, bins + 1) distances.
    """
    low, high = warp(torch.tensor([near, far], device=jitter.device), turn)
    steps = torch.arange(bins + 1, device=jitter.device).expand(len(jitter), -1)
    inner = (steps > 0) & (steps < bins)
    return unwarp(low + (high - low) * (steps + inner * (jitter[:, None] - 0.5)) / bins, turn)


def resample(
    edges: torch.Tensor, weights: torch.Tensor, jitter: torch.Tensor, padding: float, bins: int
) -> torch.Tensor:
    """Resample bins by inverse transform sampling of a histogram (proposal sampling); both ends of the ray stay.

    Args:
        edges: (R, P + 1) of the histogram.
        weights: (R, P) of the histogram, not differentiated.
        jitter: (R,) in [0, 1).
        padding: added to every weight.
        bins: number of new bins.

    Returns:
        (R, bins + 1) increasing distances.
    """
    share = weights.detach() + padding
    share = share / share.sum(dim=1, keepdim=True).clamp(min=SMALLEST)
    passed = torch.nn.functional.pad(share.cumsum(dim=1), (1, 0))
    u = (torch.arange(1, bins, device=edges.device) - 0.5 + jitter[:, None]) / bins
    bin_ = (torch.searchsorted(passed.contiguous(), u.contiguous()) - 1).clamp(0, weights.shape[1] - 1)
    inside = ((u - passed.gather(1, bin_)) / share.gather(1, bin_).clamp(min=SMALLEST)).clamp(0, 1)
    inner = edges.gather(1, bin_) + inside * (edges.gather(1, bin_ + 1) - edges.gather(1, bin_))
    return torch.cat([edges[:, :1], inner, edges[:, -1:]], dim=1)


def occupied_bins(
    edges: torch.Tensor, density: torch.Tensor, threshold: float, reach: float, jitter: torch.Tensor, bins: int
) -> tuple[torch.Tensor, torch.Tensor]:
    """Place bins of equal length in the occupied steps of each ray, until it is opaque and has covered ``reach``.

    Args:
        edges: (R, P + 1) distances between which the grid is queried.
        density: (R, P) of the grid at the midpoints of the steps.
        threshold: smallest density of an occupied step; a ray without such a step is divided over its whole length.
        reach: smallest length of occupied space that a ray crosses.
        jitter: (R,) in [0, 1).
        bins: number of bins.

    Returns:
        starts, ends (R, bins).

    Example:
        >>> steps = torch.arange(5.0)[None]
        >>> occupied_bins(steps, torch.tensor([[0.0, 9.0, 0.0, 9.0]]), 1.0, 5.0, torch.tensor([0.5]), 2)
        (tensor([[1., 3.]]), tensor([[2., 4.]]))
    """
    length = edges.diff(dim=1)
    occupied = torch.where(density >= threshold, length, 0.0)
    passed = occupied.cumsum(dim=1)
    light = torch.exp(-(occupied * density).cumsum(dim=1))
    stopped = ((light < OPAQUE) & (passed > reach)).long().cumsum(dim=1)
    occupied = torch.where((stopped == 0) | ((stopped == 1) & (occupied > 0)), occupied, 0.0)
    occupied = torch.where(occupied.sum(dim=1, keepdim=True) > 0, occupied, length)
    passed = torch.nn.functional.pad(occupied.cumsum(dim=1), (1, 0))
    width = passed[:, -1:] / bins
    wanted = (torch.arange(bins, device=edges.device) + 0.25 + 0.5 * jitter[:, None]) * width
    step = (torch.searchsorted(passed.contiguous(), wanted.contiguous()) - 1).clamp(0, occupied.shape[1] - 1)
    middle = edges.gather(1, step) + wanted - passed.gather(1, step)
    return middle - width / 2, middle + width / 2


def visible_bins(
    starts: torch.Tensor, ends: torch.Tensor, density: torch.Tensor, jitter: torch.Tensor, bins: int
) -> tuple[torch.Tensor, torch.Tensor]:
    """Divide the marched bins of each ray, up to the one behind which it is dark, into bins of equal length.

    Args:
        starts, ends: (R, M) of the marched bins.
        density: (R, M) of the field in them.
        jitter: (R,) in [0, 1).
        bins: number of bins.

    Returns:
        starts, ends (R, bins).

    Example:
        >>> edges = torch.arange(5.0)[None]
        >>> visible_bins(edges[:, :-1], edges[:, 1:], torch.tensor([[0.0, 99.0, 0.0, 0.0]]), torch.tensor([0.5]), 2)
        (tensor([[0., 1.]]), tensor([[1., 2.]]))
    """
    length = ends - starts
    depth = (density * length).cumsum(dim=1)
    kept = ((depth <= DARK_DEPTH).sum(dim=1, keepdim=True) + 1).clamp(max=starts.shape[1])
    scale = kept / bins
    wanted = (torch.arange(bins, device=starts.device) + 0.25 + 0.5 * jitter[:, None]) * scale
    index = torch.minimum(wanted.long(), kept - 1)
    length = length.gather(1, index)
    middle = starts.gather(1, index) + (wanted - index) * length
    return middle - scale / 2 * length, middle + scale / 2 * length


def surface_loss(
    raw: torch.Tensor, starts: torch.Tensor, ends: torch.Tensor, depth: torch.Tensor, settings: Settings
) -> torch.Tensor:
    """Return the (R,) squared errors of the signed distances that log densities imply around measured surfaces.

    At a distance x behind the surface the density should be ``surface_density * exp(sharpness * x)``, but at least
    ``free_density``; lower densities in free space are no error. Bins further behind than ``behind`` are not compared.
    Errors above :data:`MAX_ERROR` count linearly.

    Args:
        raw: (R, S) outputs that :func:`density_from_raw` converts.
        starts, ends: (R, S).
        depth: (R,) measured distances; 0 for none.
        settings: the profile of the density.
    """
    behind = (starts + ends) / 2 - depth[:, None]
    wanted = math.log(settings.surface_density) + settings.sharpness * behind
    free = math.log(settings.free_density)
    error = (raw + LOG_SIGMA_START - wanted.clamp(min=free)) / settings.sharpness
    compared = (depth[:, None] > 0) & (behind <= settings.behind) & ((wanted > free) | (error > 0))
    error = torch.where(compared, error, 0)
    return torch.nn.functional.huber_loss(error, torch.zeros_like(error), "none", delta=MAX_ERROR).sum(dim=1)


def distortion_loss(weights: torch.Tensor, starts: torch.Tensor, ends: torch.Tensor, turn: float) -> torch.Tensor:
    """Return the (R,) distortion losses in warped distances (Barron et al. 2022, equation 15)."""
    near, far = warp(starts, turn), warp(ends, turn)
    middle = (near + far) / 2
    pairs = weights[:, :, None] * weights[:, None, :] * (middle[:, :, None] - middle[:, None, :]).abs()
    return pairs.sum(dim=(1, 2)) + (weights**2 * (far - near)).sum(dim=1) / 3


def interlevel_loss(
    edges: torch.Tensor, weights: torch.Tensor, fine_edges: torch.Tensor, fine_weights: torch.Tensor
) -> torch.Tensor:
    """Return the (R,) interlevel losses (Barron et al. 2022, equation 13).

    The proposal bins that overlap a fine bin must have at least its weight.

    Args:
        edges, weights: (R, P + 1), (R, P) proposal histogram.
        fine_edges, fine_weights: (R, S + 1), (R, S) fine histogram, not differentiated.
    """
    overlaps = (edges[:, None, :-1] < fine_edges[:, 1:, None]) & (edges[:, None, 1:] > fine_edges[:, :-1, None])
    bound = (overlaps * weights[:, None, :]).sum(dim=2)
    excess = (fine_weights.detach() - bound).clamp(min=0)
    return (excess**2 / (fine_weights.detach() + 1e-7)).sum(dim=1)
