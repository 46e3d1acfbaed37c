"""Camera refinement: poses that are learned together with the field (an option, off in the tables)."""

from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from autonerf_lab.nerf.ray_batch import Learned, Rays


class Cameras:
    """A small motion for each training camera: a rotation vector and a shift, both in the world frame.

    Pose k becomes (exp([omega_k]x) R_k, t_k + v_k). Poses that are right should stay: the penalties on the squared
    lengths are those of nerfstudio's camera optimiser.
    """

    RATES: ClassVar = {"camera_rotation": 0.1, "camera_shift": 0.1}  # of the field's learning rate
    PENALTY: ClassVar = {"camera_rotation": 1e-3, "camera_shift": 1e-2}

    def __init__(self, count: int) -> None:
        self.parameters = {name: np.zeros((count, 3), np.float32) for name in self.RATES}

    def rotations(self) -> np.ndarray:
        """(T, 3, 3) float32."""
        return Rotation.from_rotvec(self.parameters["camera_rotation"]).as_matrix().astype(np.float32)

    def poses(self, poses: np.ndarray, unit: float) -> np.ndarray:
        """(T, 4, 4) poses after the motions, in units of which the field's is ``unit``."""
        moved = poses.copy()
        moved[:, :3, :3] = self.rotations() @ poses[:, :3, :3]
        moved[:, :3, 3] += unit * self.parameters["camera_shift"]
        return moved

    def move(self, rays: Rays) -> Rays:
        """The rays of training images, after the motions."""
        turned = np.einsum("rij,rj->ri", self.rotations()[rays.frames], rays.directions)
        origins = rays.origins + self.parameters["camera_shift"][rays.frames]
        return Rays(origins, np.ascontiguousarray(turned, np.float32), rays.frames)

    def gradients(self, rays: Rays, learned: Learned) -> dict[str, np.ndarray]:
        """From the gradients of moved rays to those of the motions, penalties included.

        exp(omega + delta) is exp(J delta) exp(omega) to first order, J the left Jacobian of the rotation group; and a
        small turn delta changes a direction d by delta x d, so that its gradient is d x (gradient of d).
        """
        assert rays.frames is not None and learned.d_origins is not None and learned.d_directions is not None
        found = {name: np.zeros_like(value) for name, value in self.parameters.items()}
        np.add.at(found["camera_shift"], rays.frames, learned.d_origins)
        np.add.at(found["camera_rotation"], rays.frames, np.cross(rays.directions, learned.d_directions))
        jacobians = _left_jacobian(self.parameters["camera_rotation"].astype(np.float64))
        found["camera_rotation"] = np.einsum("tji,tj->ti", jacobians, found["camera_rotation"]).astype(np.float32)
        for name, value in self.parameters.items():
            found[name] += (2 * self.PENALTY[name] / len(value)) * value
        return found


def _left_jacobian(omega: np.ndarray) -> np.ndarray:
    """(T, 3) -> (T, 3, 3)."""
    x, y, z = omega.T
    zero = np.zeros_like(x)
    k = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    angle = np.maximum(np.linalg.norm(omega, axis=1), 1e-4)[:, None, None]  # both factors are flat near zero
    return np.eye(3) + (1 - np.cos(angle)) / angle**2 * k + (angle - np.sin(angle)) / angle**3 * (k @ k)
