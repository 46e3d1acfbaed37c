"""Spherical harmonics of viewing directions, the encoding *sh* of the paper (section 3.2)."""

from typing import TYPE_CHECKING, TypeVar

import numpy as np

if TYPE_CHECKING:
    import torch

Values = TypeVar("Values", np.ndarray, "torch.Tensor")

# Normalisation of the harmonics of degree 0 to 2 (A) and 3 (B)
A0, A1, A2, A3, A4 = (
    0.28209479177387814,
    0.4886025119029199,
    1.0925484305920792,
    0.31539156525252005,
    0.5462742152960396,
)
B1, B2, B3, B4, B5 = 0.5900435899266435, 2.890611442640554, 0.4570457994644658, 0.3731763325901154, 1.445305721320277


def spherical_harmonics(directions: Values) -> Values:
    """Return the real spherical harmonics up to degree 3, the 16 values of the paper's sh(phi).

    Args:
        directions: (N, 3), unit; an array or a tensor.

    Returns:
        (N, 16), orthonormal on the sphere.

    Example:
        >>> spherical_harmonics(np.array([[0.0, 0.0, 1.0]]))[0, :4].round(4)
        array([0.2821, 0.    , 0.4886, 0.    ])
    """
    x, y, z = directions[:, 0], directions[:, 1], directions[:, 2]
    xx, yy, zz = x * x, y * y, z * z
    values = [
        0 * x + A0,
        A1 * y,
        A1 * z,
        A1 * x,
        A2 * x * y,
        A2 * y * z,
        A3 * (3 * zz - 1),
        A2 * x * z,
        A4 * (xx - yy),
        B1 * y * (3 * xx - yy),
        B2 * x * y * z,
        B3 * y * (5 * zz - 1),
        B4 * z * (5 * zz - 3),
        B3 * x * (5 * zz - 1),
        B5 * z * (xx - yy),
        B1 * x * (xx - 3 * yy),
    ]
    if isinstance(directions, np.ndarray):
        return np.stack(values, axis=-1)
    import torch

    return torch.stack(values, dim=-1)


def spherical_harmonics_gradient(directions: np.ndarray, upstream: np.ndarray) -> np.ndarray:
    """Return the gradient of a scalar with respect to directions, from that with respect to their harmonics.

    Args:
        directions: (N, 3), unit.
        upstream: (N, 16), derivatives of the scalar by :func:`spherical_harmonics`.

    Returns:
        (N, 3); the harmonics count as polynomials of free coordinates, as in automatic differentiation.

    Example:
        >>> spherical_harmonics_gradient(np.array([[0.0, 0.0, 1.0]]), np.eye(16)[2:3]).round(4)
        array([[0.    , 0.    , 0.4886]])
    """
    x, y, z = directions.T
    xx, yy, zz = x * x, y * y, z * z
    g = upstream.T
    d_x = A1 * g[3] + A2 * (y * g[4] + z * g[7]) + 2 * A4 * x * g[8]
    d_x += 6 * B1 * x * y * g[9] + B2 * y * z * g[10] + B3 * (5 * zz - 1) * g[13]
    d_x += 2 * B5 * x * z * g[14] + 3 * B1 * (xx - yy) * g[15]
    d_y = A1 * g[1] + A2 * (x * g[4] + z * g[5]) - 2 * A4 * y * g[8]
    d_y += 3 * B1 * (xx - yy) * g[9] + B2 * x * z * g[10] + B3 * (5 * zz - 1) * g[11]
    d_y += -2 * B5 * y * z * g[14] - 6 * B1 * x * y * g[15]
    d_z = A1 * g[2] + A2 * (y * g[5] + x * g[7]) + 6 * A3 * z * g[6]
    d_z += B2 * x * y * g[10] + 10 * B3 * z * (y * g[11] + x * g[13])
    d_z += B4 * (15 * zz - 3) * g[12] + B5 * (xx - yy) * g[14]
    return np.stack([d_x, d_y, d_z], axis=-1)
