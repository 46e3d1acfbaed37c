"""Encodings of positions and directions in torch, differentiable: the readable reference.

CUDA trains with these functions. The CPU trains with :mod:`autonerf_lab.nerf.kernels.hash_encoding`, which tests
compare with them.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import torch

Values = TypeVar("Values", np.ndarray, torch.Tensor)

PRIMES = (1, 2654435761, 805459861)  # Müller et al. 2022, equation 4


@dataclass(frozen=True)
class HashGrid:
    """Layout of a multi-resolution table: L levels with 2 features per entry, concatenated in one array."""

    resolutions: np.ndarray  # (L, 3) int64, cells along each axis
    offsets: np.ndarray  # (L,) int64, first entry of each level
    masks: np.ndarray  # (L,) int64, table size - 1 where the level is hashed, 0 where it is dense
    entries: int  # of all levels

    @classmethod
    def build(cls, size: np.ndarray, coarse: float, fine: float, levels: int, log2_entries: int) -> "HashGrid":
        """Return a grid of cubic cells, whose side goes from ``coarse`` to ``fine`` metres in equal ratios.

        Args:
            size: (3,) size of the unit cube, metres.
            coarse: side of the largest cells, metres.
            fine: side of the smallest cells, metres.
            levels: number of levels.
            log2_entries: a level has at most 2 ** log2_entries entries; a larger one is hashed.

        Example:
            >>> grid = HashGrid.build(np.array([4.0, 4.0, 2.0]), 1.0, 0.25, levels=3, log2_entries=9)
            >>> grid.resolutions.tolist(), grid.masks.tolist()
            ([[4, 4, 2], [8, 8, 4], [16, 16, 8]], [0, 0, 511])
        """
        cells = np.geomspace(coarse, fine, levels)
        resolutions = np.maximum(np.ceil(size / cells[:, None] - 1e-9), 1).astype(np.int64)
        corners = np.prod(resolutions + 1, axis=1)
        hashed = corners > 2**log2_entries
        sizes = np.where(hashed, 2**log2_entries, corners)
        offsets = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64)
        return cls(resolutions, offsets, np.where(hashed, sizes - 1, 0).astype(np.int64), int(sizes.sum()))


def hash_encode(x: torch.Tensor, table: torch.Tensor, grid: HashGrid) -> torch.Tensor:
    """Encode points by trilinear interpolation in every level of a table.

    Args:
        x: (N, 3) in [0, 1].
        table: (entries, 2).
        grid: layout of the table.

    Returns:
        (N, 2 L), differentiable in ``x`` and ``table``.

    Example:
        >>> grid = HashGrid.build(np.ones(3), 1.0, 1.0, levels=1, log2_entries=4)
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


def spherical_harmonics(directions: Values) -> Values:
    """Return the real spherical harmonics up to degree 3, the 16 values of the paper's sh(phi).

    Args:
        directions: (N, 3), unit; an array or a tensor.

    Returns:
        (N, 16), orthonormal on the sphere.

    Example:
        >>> spherical_harmonics(torch.tensor([[0.0, 0.0, 1.0]]))[0, :4]
        tensor([0.2821, 0.0000, 0.4886, 0.0000])
    """
    x, y, z = directions[:, 0], directions[:, 1], directions[:, 2]
    xx, yy, zz = x * x, y * y, z * z
    values = [
        0 * x + 0.28209479177387814,
        0.4886025119029199 * y,
        0.4886025119029199 * z,
        0.4886025119029199 * x,
        1.0925484305920792 * x * y,
        1.0925484305920792 * y * z,
        0.31539156525252005 * (3 * zz - 1),
        1.0925484305920792 * x * z,
        0.5462742152960396 * (xx - yy),
        0.5900435899266435 * y * (3 * xx - yy),
        2.890611442640554 * x * y * z,
        0.4570457994644658 * y * (5 * zz - 1),
        0.3731763325901154 * z * (5 * zz - 3),
        0.4570457994644658 * x * (5 * zz - 1),
        1.445305721320277 * z * (xx - yy),
        0.5900435899266435 * x * (xx - 3 * yy),
    ]
    return np.stack(values, axis=-1) if isinstance(directions, np.ndarray) else torch.stack(values, dim=-1)


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
