"""Refinement of poses by colour alone: a field is trained while its poses are refined."""

from dataclasses import replace

import numpy as np
from PIL import Image

from autonerf_lab import presets
from autonerf_lab.bundle_adjustment.adjustment import BRIGHTNESS_NOISE, PLANAR, SHARED_NOISE, SPATIAL, Adjusted
from autonerf_lab.bundle_adjustment.motion_prior import (
    chain_covariances,
    estimate_sigmas,
    motion_equations,
    motion_errors,
)
from autonerf_lab.bundle_adjustment.range_images import LUMA, SIDE
from autonerf_lab.data.dataset import Dataset
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.nerf.fit import fit
from autonerf_lab.nerf.models import model_spec

MODEL = "semantic-nerfacto"


def adjust_by_color(
    data: Dataset, planar: bool, preset: str | presets.Preset | None, steps: int | None, seed: int, progress: bool
) -> Adjusted:
    """Train a field with ``refine_cameras``, and return its poses with their covariances.

    The information of an image about its own pose is that of its brightness gradients at the depth that the field
    renders; a black image has none.

    Args:
        data: rough poses and images.
        planar: move cameras along x and y and turn them about z only.
        preset: of the field.
        steps: number of training steps instead of the preset's.
        seed: random seed.
        progress: show a progress bar.
    """
    name = presets.preset(preset).name
    settings = replace(model_spec(MODEL).settings_for(name), refine_cameras=True, refine_planar=planar)
    nerf = fit(data, MODEL, name, settings=settings, steps=steps, seed=seed, progress=progress)
    axes = PLANAR if planar else SPATIAL
    own = np.empty((len(data), len(axes), len(axes)))
    for t, (pose, image) in enumerate(zip(nerf.poses, data.images, strict=True)):
        step = max(1, max(image.shape) // SIDE)
        small = np.asarray(Image.fromarray(image).reduce(step), dtype=np.float32) @ (LUMA / np.float32(255))
        camera = data.intrinsics[t].resized(small.shape[1], small.shape[0])
        found = brightness_information(small, nerf.render(pose, camera).depth, camera, pose)
        own[t] = SHARED_NOISE * found[np.ix_(axes, axes)]
    sigmas = estimate_sigmas(motion_errors(nerf.poses, data.poses), planar)
    both = np.concatenate([axes, 6 + axes])
    chain = motion_equations(nerf.poses, data.poses, sigmas)[0][:, both[:, None], both]
    return Adjusted(nerf.poses, chain_covariances(own, chain))


def brightness_information(
    brightness: np.ndarray, depth: np.ndarray, camera: Intrinsics, pose: np.ndarray
) -> np.ndarray:
    """Return the (6, 6) information of an image about a small motion of its camera before a fixed scene.

    Args:
        brightness: (H, W) in [0, 1].
        depth: (H, W) along the optical axis; 0 = none.
        camera: of the image.
        pose: (4, 4) camera-to-world.

    Example:
        A camera at 2 m from a wall, with stripes along its height: it sees its motion sideways, not along the stripes.

        >>> camera = Intrinsics.from_fov(32, 32)
        >>> stripes = np.tile(0.5 + 0.5 * np.sin(np.arange(32)), (32, 1))
        >>> information = brightness_information(stripes, np.full((32, 32), 2.0), camera, np.eye(4))
        >>> bool(information[0, 0] > 1e4), float(information[1, 1]), bool(information[2, 2] > 1e3)
        (True, 0.0, True)
    """
    down, right = (np.asarray(part) for part in np.gradient(brightness.astype(np.float64)))
    known = (depth > 0) & np.isfinite(depth)
    distance = depth[known].astype(np.float64)
    directions = camera.directions()[known]
    gradient = np.stack([right[known] * camera.fl_x, -down[known] * camera.fl_y, np.zeros_like(distance)], axis=1)
    gradient[:, 2] = (gradient * directions).sum(axis=1)  # z is minus depth
    gradient = gradient / distance[:, None] @ pose[:3, :3].T
    offsets = distance[:, None] * directions @ pose[:3, :3].T
    jacobian = np.concatenate([gradient, np.cross(offsets, gradient)], axis=1)
    return jacobian.T @ jacobian / BRIGHTNESS_NOISE**2
