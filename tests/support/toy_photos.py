"""Photographs of an analytic scene: balls with a pattern, and a sky so distant that it has no parallax.

Independent of the package, so that tests can compare its distortion, rays and poses with these.
"""

from dataclasses import replace

import numpy as np
from PIL import Image

from autonerf_lab.data.dataset import Dataset
from autonerf_lab.geometry import Intrinsics

CAMERA = Intrinsics.from_fov(40, 30, hfov_deg=70)
BALLS = ((0.0, 0.0, 0.0, 1.0), (1.3, 0.6, -0.4, 0.5), (-0.9, 1.1, 0.5, 0.4))  # x, y, z, radius
SKY = 400.0  # radius


def looking(eye, target, up=(0.0, 0.0, 1.0)):
    """Return the (4, 4) camera-to-world pose of a camera at ``eye`` that looks at ``target``, OpenGL."""
    back = np.subtract(eye, target) / np.linalg.norm(np.subtract(eye, target))
    right = np.cross(up, back) / np.linalg.norm(np.cross(up, back))
    pose = np.eye(4)
    pose[:3] = np.stack([right, np.cross(back, right), back, eye], axis=1)
    return pose


def orbit(count=40, radius=4.0, seed=0):
    """Return (count, 4, 4) poses around the balls, looking at them."""
    rng = np.random.default_rng(seed)
    turns, heights = np.arange(count) * 2.4, rng.uniform(-1, 2.5, count)
    eyes = np.stack([radius * np.cos(turns), radius * np.sin(turns), heights], axis=1)
    return np.stack([looking(eye, rng.uniform(-0.3, 0.3, 3)) for eye in eyes])


def outward(count=40, seed=0):
    """Return (count, 4, 4) poses in a small region beside the balls, looking in all directions: mostly sky."""
    rng = np.random.default_rng(seed)
    eyes = rng.uniform((-1, -3.5, -1), (1, -1.5, 1), (count, 3))
    turns, rise = np.arange(count) * 2.4, rng.uniform(-0.3, 0.3, count)
    axes = np.stack([np.cos(turns), np.sin(turns), rise], axis=1)
    return np.stack([looking(eye, eye + axis) for eye, axis in zip(eyes, axes, strict=True)])


def _pattern(points, scale):
    x, y, z = (points * scale).T
    waves = [np.sin(3 * x + 1) * np.cos(2 * y), np.sin(4 * y - z), np.cos(3 * z + 2 * x)]
    return 0.5 + 0.4 * np.stack(waves, axis=1)


def colors(rays_o, rays_d):
    """Return (N, 3) colours in [0, 1] of rays and (N,) distances to the surface, in lengths of the directions."""
    squared = (rays_d**2).sum(axis=1)

    def hit(center, radius):
        offset = rays_o - center
        half, rest = (rays_d * offset).sum(axis=1), (offset**2).sum(axis=1) - radius**2
        root = half**2 - squared * rest
        far = -half + np.sqrt(np.maximum(root, 0))
        near = -half - np.sqrt(np.maximum(root, 0))
        t = np.where(near > 0, near, far) / squared
        return np.where((root > 0) & (t > 0), t, np.inf)

    t = hit(np.zeros(3), SKY)
    shown = 0.3 + 0.6 * _pattern(rays_o + t[:, None] * rays_d, 2 / SKY)
    for ball, (*center, radius) in enumerate(BALLS):
        there = hit(np.array(center), radius)
        nearer = there < t
        t = np.where(nearer, there, t)
        on = rays_o[nearer] + t[nearer, None] * rays_d[nearer]
        shown[nearer] = _pattern(on, 1.5) * np.roll([1.0, 0.6, 0.5], ball)
    return np.clip(shown, 0, 1), t


def undistorted(camera, u, v):
    """Return x right, y down at depth 1 of pixels (u, v), by the fixed-point iteration of OpenCV."""
    distorted = np.stack([(u - camera.cx) / camera.fl_x, (v - camera.cy) / camera.fl_y])
    x, y = distorted
    k1, k2, k3, p1, p2 = camera.lens
    for _ in range(200):
        r2 = x * x + y * y
        radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        shift = 2 * p1 * x * y + p2 * (r2 + 2 * x * x), 2 * p2 * x * y + p1 * (r2 + 2 * y * y)
        x, y = (distorted - shift) / radial
    return x, y


def photograph(c2w, camera=CAMERA, fine=3):
    """Render (H, W, 3) uint8 with ``fine`` x ``fine`` rays per pixel, and (H, W) depth along the axis."""
    steps = (np.arange(fine) + 0.5) / fine
    total = 0
    for du in steps:
        for dv in steps:
            u, v = np.meshgrid(np.arange(camera.width) + du, np.arange(camera.height) + dv)
            x, y = undistorted(camera, u.ravel(), v.ravel())
            rays_d = np.stack([x, -y, -np.ones_like(x)], axis=1) @ c2w[:3, :3].T
            shown, depth = colors(np.broadcast_to(c2w[:3, 3], rays_d.shape), rays_d)
            total = total + shown
            if du == dv == steps[fine // 2]:
                middle = depth
    shape = camera.height, camera.width
    return np.round(total.reshape(*shape, 3) / fine**2 * 255).astype(np.uint8), middle.reshape(shape)


def photographs(poses, cameras=CAMERA):
    """Return a dataset of unknown scale, without labels."""
    cameras = [cameras] * len(poses) if isinstance(cameras, Intrinsics) else cameras
    images = [photograph(pose, camera)[0] for pose, camera in zip(poses, cameras, strict=True)]
    names = [f"{t:03d}.png" for t in range(len(poses))]
    return Dataset(poses, images, cameras, None, None, names, {}, False)


def moved(data, scale=1.0, shift=(0.0, 0.0, 0.0)):
    """Return the same photographs in other coordinates: scaled, then shifted."""
    poses = data.poses.copy()
    poses[:, :3, 3] = scale * poses[:, :3, 3] + shift
    return replace(data, poses=poses)


def write(data, folder):
    """Write a nerfstudio dataset, in which every frame has its own camera."""
    import json

    folder.mkdir(parents=True, exist_ok=True)
    frames = []
    for pose, image, camera, name in zip(data.poses, data.images, data.intrinsics, data.names, strict=True):
        Image.fromarray(image).save(folder / name)
        keys = {key: getattr(camera, key) for key in ("fl_x", "fl_y", "cx", "cy", "k1", "k2", "k3", "p1", "p2")}
        keys |= {"w": camera.width, "h": camera.height}
        frames.append({"file_path": name, "transform_matrix": pose.tolist(), **keys})
    (folder / "transforms.json").write_text(json.dumps({"frames": frames}))
    return folder
