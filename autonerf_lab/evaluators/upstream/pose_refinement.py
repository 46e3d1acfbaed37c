"""Pose refinement of the released code, following iNeRF.

Start poses are rotated by 5 degrees about every axis of the world through its origin and translated by 3 cm along every
axis: a camera far from the origin moves by decimetres. The optimised variable is a screw motion about the origin. The
rotation error is the sum of the errors of three Euler angles.
"""

from collections.abc import Callable

import numpy as np
import torch

from autonerf_lab.evaluators.radiance_field import RadianceField
from autonerf_lab.geometry import Intrinsics

START_DEG, START_M = 5.0, 0.03


def perturb(c2w: np.ndarray) -> np.ndarray:
    """Rotate (..., 4, 4) poses by 5 degrees about every axis of the world and translate them by 3 cm along every axis.

    Example:
        >>> far = np.eye(4); far[0, 3] = 10.0
        >>> np.linalg.norm(perturb(far)[:3, 3] - far[:3, 3]).round(2)
        np.float64(1.23)
    """
    c, s = np.cos(np.radians(START_DEG)), np.sin(np.radians(START_DEG))
    motion = np.eye(4)
    about_z, about_y = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    motion[:3, :3] = about_z @ about_y @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    motion[:3, 3] = START_M
    return motion @ c2w


def euler_deg(c2w: np.ndarray) -> np.ndarray:
    """Return the (..., 3) Euler angles about x, y and z of (..., 4, 4) poses, degrees."""
    r = c2w[..., :3, :3]
    about_y = np.arctan2(-r[..., 2, 0], np.hypot(r[..., 2, 1], r[..., 2, 2]))
    return np.degrees(
        np.stack([np.arctan2(r[..., 2, 1], r[..., 2, 2]), about_y, np.arctan2(r[..., 1, 0], r[..., 0, 0])], axis=-1)
    )


def pose_errors(poses: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (K,) sums of the errors of three Euler angles in degrees, and (K,) position errors in metres."""
    rotation = np.abs((euler_deg(poses) - euler_deg(truth) + 180) % 360 - 180).sum(axis=-1)
    return rotation, np.linalg.norm(poses[:, :3, 3] - truth[:, :3, 3], axis=1)


def _screw(w: torch.Tensor, v: torch.Tensor, theta: torch.Tensor) -> torch.Tensor:
    """Return (K, 4, 4) screw motions with axes (K, 3), velocities (K, 3) and angles (K,)."""
    zero = torch.zeros_like(theta)
    x, y, z = w.T
    skew = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=1).reshape(-1, 3, 3)
    squared, one = skew @ skew, torch.eye(3, dtype=w.dtype).expand(len(w), 3, 3)
    sine, cosine, angle = (value[:, None, None] for value in (torch.sin(theta), torch.cos(theta), theta))
    rotation = one + sine * skew + (1 - cosine) * squared
    shift = (angle * one + (1 - cosine) * skew + (angle - sine) * squared) @ v[:, :, None]
    bottom = torch.tensor([0.0, 0.0, 0.0, 1.0], dtype=w.dtype).expand(len(w), 1, 4)
    return torch.cat([torch.cat([rotation, shift], dim=2), bottom], dim=1)


def refine(
    field: RadianceField,
    starts: np.ndarray,
    targets: np.ndarray,
    intrinsics: Intrinsics,
    iterations: int,
    rays: int,
    seed: int = 0,
    tick: Callable[[], None] = lambda: None,
) -> np.ndarray:
    """Refine K poses together by Adam with ``lr = 0.01 * 0.8 ** (i / 100)``.

    Args:
        field: only ``ray_gradients`` is used.
        starts: (K, 4, 4) camera-to-world start poses.
        targets: (K, H, W, 3) uint8 target images.
        intrinsics: of the targets.
        iterations: number of iterations.
        rays: random pixels per pose and iteration.
        seed: random seed of the pixels.
        tick: called after each iteration.

    Returns:
        (K, 4, 4) poses.
    """
    rng = np.random.default_rng([seed, 43])
    count, pixels = len(starts), intrinsics.width * intrinsics.height
    directions, colors = intrinsics.directions().reshape(-1, 3), targets.reshape(count, pixels, 3)
    w, v, theta = (torch.tensor(rng.normal(0, 1e-6, size)) for size in ((count, 3), (count, 3), (count,)))
    optimizer = torch.optim.Adam([parameter.requires_grad_() for parameter in (w, v, theta)], lr=0.01)
    schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, lambda i: 0.8 ** (i / 100))
    begin = torch.from_numpy(starts.astype(np.float64))
    for _ in range(iterations):
        pick = rng.integers(pixels, size=(count, rays))
        poses = _screw(w, v, theta) @ begin
        rays_d = torch.from_numpy(directions[pick].astype(np.float64)) @ poses[:, :3, :3].transpose(1, 2)
        rays_o = poses[:, None, :3, 3].expand_as(rays_d)
        wanted = np.take_along_axis(colors, pick[..., None], axis=1) / np.float32(255)
        flat = (a.reshape(-1, 3) for a in (rays_o.detach().numpy(), rays_d.detach().numpy(), wanted))
        _, *slopes = field.ray_gradients(*(np.ascontiguousarray(a, np.float32) for a in flat))
        grad_o, grad_d = (
            torch.from_numpy(np.nan_to_num(g.astype(np.float64)) / rays).reshape(count, rays, 3) for g in slopes
        )
        optimizer.zero_grad()
        torch.autograd.backward([rays_o, rays_d], [grad_o, grad_d])
        optimizer.step()
        schedule.step()
        tick()
    return (_screw(w, v, theta) @ begin).detach().numpy()
