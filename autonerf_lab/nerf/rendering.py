"""Volume rendering, sampling and the losses of a ray bundle in torch: the readable reference of the fused kernels.

Everything is written for (R, S) bins of R rays, from ``starts`` to ``ends`` (R, S), or between ``edges`` (R, S + 1)
where they touch; distances in metres. CUDA trains with these
functions; on the CPU :mod:`autonerf_lab.nerf.kernels` computes the same, and tests hold one against the other.
"""

import torch

LOG_SIGMA_START = -2.5  # a fresh network answers 0: the scene starts as thin fog, so that every ray reaches its wall
OPAQUE = 1e-2  # share of the light below which nothing behind matters
MAX_LOG_SIGMA = 9.6  # where the exponential of the log density is cut


def density_from_raw(raw: torch.Tensor) -> torch.Tensor:
    """Density per metre from a network's first output."""
    return torch.exp((raw + LOG_SIGMA_START).clamp(max=MAX_LOG_SIGMA))


def weights_from_density(sigma: torch.Tensor, starts: torch.Tensor, ends: torch.Tensor) -> torch.Tensor:
    """w_i = T_i (1 - exp(-sigma_i delta_i)), section 3.2.

    Args:
        sigma: (R, S) per metre.
        starts, ends: (R, S).

    Returns:
        (R, S); what they lack to 1 is the light that passes all bins.

    Example:
        >>> weights_from_density(torch.tensor([[0.6931, 50]]), torch.tensor([[0.0, 1.0]]), torch.tensor([[1.0, 2.0]]))
        tensor([[0.5000, 0.5000]])
    """
    optical = sigma * (ends - starts)
    transmittance = torch.exp(-torch.cumsum(torch.nn.functional.pad(optical, (1, 0)), dim=1)[:, :-1])
    return transmittance * (1 - torch.exp(-optical))


def composite(weights: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
    """(R, S) weights and (R, S, C) values -> (R, C) rendered values."""
    return (weights[..., None] * values).sum(dim=1)


def median_depth(weights: torch.Tensor, starts: torch.Tensor, ends: torch.Tensor) -> torch.Tensor:
    """(R,) distance at which half of the collected weight lies in front, linear inside its bin."""
    total = weights.cumsum(dim=1)
    half = total[:, -1:] / 2
    bin_ = torch.searchsorted(total, half).clamp(max=weights.shape[1] - 1)
    inside = (half - (total - weights).gather(1, bin_)) / weights.gather(1, bin_).clamp(min=1e-10)
    near, far = starts.gather(1, bin_), ends.gather(1, bin_)
    return (near + inside * (far - near))[:, 0]


def warp(t: torch.Tensor, turn: float) -> torch.Tensor:
    """Distance -> s in [0, 1): linear up to ``turn`` metres, then linear in disparity (piecewise sampling).

    Example:
        >>> warp(torch.tensor([2.0, 4.0, 8.0]), turn=4.0)
        tensor([0.2500, 0.5000, 0.7500])
    """
    return torch.where(t < turn, 0.5 * t / turn, 1 - 0.5 * turn / t.clamp(min=1e-9))


def unwarp(s: torch.Tensor, turn: float) -> torch.Tensor:
    """The inverse of :func:`warp`."""
    return torch.where(s < 0.5, 2 * s * turn, 0.5 * turn / (1 - s))


def first_edges(near: float, far: float, turn: float, jitter: torch.Tensor, bins: int) -> torch.Tensor:
    """Piecewise sampling: equal steps of s, inner edges shifted by each ray's jitter in [0, 1).

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
    """Proposal sampling: new bins by inverse transform of the histogram, both ends of the ray kept.

    Args:
        edges: (R, P + 1).
        weights: (R, P), not differentiated.
        jitter: (R,) in [0, 1).
        padding: added to every weight.
        bins: how many new ones.

    Returns:
        (R, bins + 1) increasing distances.
    """
    share = weights.detach() + padding
    share = share / share.sum(dim=1, keepdim=True)
    passed = torch.nn.functional.pad(share.cumsum(dim=1), (1, 0))
    u = (torch.arange(1, bins, device=edges.device) - 0.5 + jitter[:, None]) / bins
    bin_ = (torch.searchsorted(passed.contiguous(), u.contiguous()) - 1).clamp(0, weights.shape[1] - 1)
    inside = ((u - passed.gather(1, bin_)) / share.gather(1, bin_)).clamp(0, 1)
    inner = edges.gather(1, bin_) + inside * (edges.gather(1, bin_ + 1) - edges.gather(1, bin_))
    return torch.cat([edges[:, :1], inner, edges[:, -1:]], dim=1)


def occupied_bins(
    edges: torch.Tensor, density: torch.Tensor, threshold: float, reach: float, jitter: torch.Tensor, bins: int
) -> tuple[torch.Tensor, torch.Tensor]:
    """Bins of equal length in the occupied steps of each ray, until no light is left and ``reach`` has been covered.

    Args:
        edges: (R, P + 1) distances of steps, metres.
        density: (R, P) of the grid at their middles, per metre.
        threshold: density from which a step is occupied; a ray without such a step is divided as a whole.
        reach: metres of occupied space that a ray goes through at least.
        jitter: (R,) in [0, 1).
        bins: how many.

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


def distortion_loss(weights: torch.Tensor, starts: torch.Tensor, ends: torch.Tensor, turn: float) -> torch.Tensor:
    """(R,) distortion of Barron et al. 2022, equation 15, in warped distances."""
    near, far = warp(starts, turn), warp(ends, turn)
    middle = (near + far) / 2
    pairs = weights[:, :, None] * weights[:, None, :] * (middle[:, :, None] - middle[:, None, :]).abs()
    return pairs.sum(dim=(1, 2)) + (weights**2 * (far - near)).sum(dim=1) / 3


def interlevel_loss(
    edges: torch.Tensor, weights: torch.Tensor, fine_edges: torch.Tensor, fine_weights: torch.Tensor
) -> torch.Tensor:
    """(R,) loss of Barron et al. 2022, equation 13: a proposal must hold the fine weight that lies over its bins."""
    overlaps = (edges[:, None, :-1] < fine_edges[:, 1:, None]) & (edges[:, None, 1:] > fine_edges[:, :-1, None])
    bound = (overlaps * weights[:, None, :]).sum(dim=2)
    excess = (fine_weights.detach() - bound).clamp(min=0)
    return (excess**2 / (fine_weights.detach() + 1e-7)).sum(dim=1)
