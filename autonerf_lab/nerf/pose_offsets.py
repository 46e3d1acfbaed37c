"""Learned corrections of the training poses (``refine_cameras``; off by default), coarse to fine.

A fine hash level has a different random value in every cell, and its gradient points to the right pose only within a
cell. So the levels are faded in one after the other while the poses settle (BAA-NGP, Liu et al. 2023; BARF, Lin et al.
2021), and the learning rate of the poses falls.
"""

from dataclasses import replace
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from autonerf_lab.nerf.ray_batch import Rays, TrainOutput

FIRST_RATE, FINAL_RATE = 3e-3, 3e-5  # learning rates, field units and radians; higher than published for fewer steps
FADE_FROM, FADE_UNTIL = 0.1, 0.5  # shares of the training between which the levels are faded in


def pose_rate(share: float) -> float:
    """Return the learning rate of the poses at a share of the training: exponential decay.

    Example:
        >>> [round(pose_rate(share), 6) for share in (0, 0.5, 1)]
        [0.003, 0.0003, 3e-05]
    """
    return FIRST_RATE * (FINAL_RATE / FIRST_RATE) ** share


def level_weights(levels: int, share: float) -> np.ndarray:
    """Return the (levels,) float32 weights of the hash levels at a share of the training; the first is always 1.

    Example:
        >>> level_weights(4, 0.25).round(2)
        array([1. , 0.5, 0. , 0. ], dtype=float32)
        >>> level_weights(4, 0.5)
        array([1., 1., 1., 1.], dtype=float32)
    """
    opened = (share - FADE_FROM) / (FADE_UNTIL - FADE_FROM) * levels
    weights = (1 - np.cos(np.pi * np.clip(opened - np.arange(levels), 0, 1))) / 2
    weights[0] = 1
    return weights.astype(np.float32)


class PoseOffsets:
    """A small rigid motion for each training pose: a rotation vector and a translation, both in the world frame.

    Pose k becomes (exp([omega_k]x) R_k, t_k + v_k). Penalties on the mean squared lengths keep correct poses where they
    are. Their weights are those of nerfstudio's camera optimiser, which penalises mean lengths.

    Args:
        count: number of training poses.

    Attributes:
        planar: the poses differ in x, y and heading only, and so do their corrections.
    """

    PENALTY: ClassVar = {"camera_rotation": 1e-3, "camera_shift": 1e-2}

    def __init__(self, count: int) -> None:
        self.planar = False
        self.parameters = {name: np.zeros((count, 3), np.float32) for name in self.PENALTY}

    def rotations(self) -> np.ndarray:
        """Return the (T, 3, 3) float32 rotation matrices."""
        return Rotation.from_rotvec(self.parameters["camera_rotation"]).as_matrix().astype(np.float32)

    def corrected(self, poses: np.ndarray, unit: float) -> np.ndarray:
        """Return (T, 4, 4) corrected poses; ``unit`` is the field's unit in units of the poses."""
        corrected = poses.copy()
        corrected[:, :3, :3] = self.rotations() @ poses[:, :3, :3]
        corrected[:, :3, 3] += unit * self.parameters["camera_shift"]
        return corrected

    def apply(self, rays: Rays) -> Rays:
        """Return the rays of training images after the corrections."""
        rotated = np.einsum("rij,rj->ri", self.rotations()[rays.frames], rays.directions)
        origins = rays.origins + self.parameters["camera_shift"][rays.frames]
        return replace(rays, origins=origins, directions=np.ascontiguousarray(rotated, np.float32))

    def gradients(self, rays: Rays, output: TrainOutput) -> dict[str, np.ndarray]:
        """Convert the gradients of corrected rays to those of the offsets, penalties included.

        exp(omega + delta) is exp(J delta) exp(omega) to first order, J the left Jacobian of the rotation group. A small
        rotation delta changes a direction d by delta x d, so that its gradient is d x (gradient of d).
        """
        assert rays.frames is not None and output.d_origins is not None and output.d_directions is not None
        found = {name: np.zeros_like(value) for name, value in self.parameters.items()}
        np.add.at(found["camera_shift"], rays.frames, output.d_origins)
        np.add.at(found["camera_rotation"], rays.frames, np.cross(rays.directions, output.d_directions))
        jacobians = _left_jacobian(self.parameters["camera_rotation"].astype(np.float64))
        found["camera_rotation"] = np.einsum("tji,tj->ti", jacobians, found["camera_rotation"]).astype(np.float32)
        for name, value in self.parameters.items():
            found[name] += (2 * self.PENALTY[name] / len(value)) * value
        if self.planar:
            found["camera_shift"][:, 2], found["camera_rotation"][:, :2] = 0, 0
        return found


def _left_jacobian(omega: np.ndarray) -> np.ndarray:
    """Return the (T, 3, 3) left Jacobians of SO(3) at (T, 3) rotation vectors."""
    x, y, z = omega.T
    zero = np.zeros_like(x)
    k = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    angle = np.maximum(np.linalg.norm(omega, axis=1), 1e-4)[:, None, None]  # both factors are flat near zero
    return np.eye(3) + (1 - np.cos(angle)) / angle**2 * k + (angle - np.sin(angle)) / angle**3 * (k @ k)
