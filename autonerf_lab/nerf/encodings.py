"""Encodings of positions in torch, differentiable: the readable reference.

CUDA trains with these functions. The CPU trains with :mod:`autonerf_lab.nerf.kernels.hash_encoding`, which tests
compare with them.
"""

from collections.abc import Callable

import torch

from autonerf_lab.nerf.hash_grid import HashGrid

PRIMES = (1, 2654435761, 805459861)  # Müller et al. 2022, equation 4


def hash_encode(x: torch.Tensor, table: torch.Tensor, grid: HashGrid) -> torch.Tensor:
    """Encode points by trilinear interpolation in every level of a table.

    Args:
        x: (N, 3) in [0, 1].
        table: (entries, 2).
        grid: layout of the table.

    Returns:
        (N, 2 L), differentiable in ``x`` and ``table``.

    Example:
        >>> grid = HashGrid.build(torch.ones(3).numpy(), 1.0, 1.0, levels=1, log2_entries=4)
        >>> table = torch.arange(8.0)[:, None].expand(8, 2)
        >>> hash_encode(torch.tensor([[0.5, 0.0, 1.0]]), table, grid)
        tensor([[4.5000, 4.5000]])
    """
    cells, offsets, masks = (torch.as_tensor(a, device=x.device) for a in (grid.resolutions, grid.offsets, grid.masks))
    scaled = x[:, None] * cells  # (N, L, 3)
    low = torch.minimum(scaled.detach().long().clamp(min=0), cells - 1)
    inside = scaled - low
    corners = torch.stack([low, low + 1], dim=-1)  # (N, L, 3, 2), of which each axis has two
    primes = torch.tensor(PRIMES, device=x.device)
    hashed = _corner_grid(corners * primes[:, None], torch.bitwise_xor)
    strides = torch.stack([torch.ones_like(cells[:, 0]), cells[:, 0] + 1, (cells[:, 0] + 1) * (cells[:, 1] + 1)], dim=1)
    dense = _corner_grid(corners * strides[..., None], torch.add)
    masks, offsets = masks[:, None], offsets[:, None]
    rows = torch.where(masks > 0, hashed & masks, dense) + offsets
    weights = _corner_grid(torch.stack([1 - inside, inside], dim=-1), torch.mul)
    features = table.index_select(0, rows.flatten()).view(*rows.shape, 2)
    return (weights[..., None] * features).sum(dim=2).flatten(1)


def _corner_grid(values: torch.Tensor, combine: Callable[[torch.Tensor, torch.Tensor], torch.Tensor]) -> torch.Tensor:
    """Return (..., 8) combinations of the two values of each axis, (..., 3, 2), for the corners of a cell."""
    x, y, z = values.unbind(dim=-2)
    plane = combine(x[..., :, None], y[..., None, :])
    return combine(plane[..., None], z[..., None, None, :]).flatten(-3)


def frequencies(x: torch.Tensor, count: int) -> torch.Tensor:
    """Encode values by frequencies (Mildenhall et al. 2020, equation 4).

    The result holds the value itself, then the sines and cosines of its products with pi, 2 pi, 4 pi, and so on.

    Args:
        x: (..., D).
        count: number of octaves.

    Returns:
        (..., D + 2 D count).

    Example:
        >>> frequencies(torch.tensor([[0.5]]), 2)
        tensor([[ 5.0000e-01,  1.0000e+00, -8.7423e-08, -4.3711e-08, -1.0000e+00]])
    """
    scaled = (x[..., None] * (torch.pi * 2.0 ** torch.arange(count, device=x.device, dtype=x.dtype))).flatten(-2)
    return torch.cat([x, torch.sin(scaled), torch.cos(scaled)], dim=-1)
