"""Notebook 01: right answers in other styles, wrong ones with the start of the hint that they get."""

import cmath
import math

import numpy as np
import torch
from scipy.spatial.transform import Rotation


def ray_torch(u, v, k, pose):
    local = torch.tensor([(u + 0.5 - k.cx) / k.fl_x, -(v + 0.5 - k.cy) / k.fl_y, -1.0], requires_grad=True)
    return torch.tensor(pose[:3, :3], dtype=torch.float32) @ local


def ray_loops(u, v, k, pose):
    local = [(u + 0.5 - k.cx) / k.fl_x, (k.cy - v - 0.5) / k.fl_y, -1]
    return [sum(pose[i, j] * local[j] for j in range(3)) for i in range(3)]


def ray_homogeneous(u, v, k, pose):
    matrix = np.array([[k.fl_x, 0, k.cx], [0, k.fl_y, k.cy], [0, 0, 1]])
    opencv = np.linalg.solve(matrix, [u + 0.5, v + 0.5, 1])
    return (pose @ np.append(opencv * [1, -1, -1], 0))[:3]


def points_loops(depth, k, pose):
    points = np.empty((*depth.shape, 3), np.float32)
    for v, u in np.ndindex(depth.shape):
        points[v, u] = pose[:3, 3] + depth[v, u] * np.array(ray_loops(u, v, k, pose))
    return points


def points_torch(depth, k, pose):
    v, u = torch.meshgrid(torch.arange(k.height) + 0.5, torch.arange(k.width) + 0.5, indexing="ij")
    local = torch.stack([(u - k.cx) / k.fl_x, -(v - k.cy) / k.fl_y, -torch.ones_like(u)], -1).double()
    pose = torch.tensor(pose, requires_grad=True)
    return torch.einsum("ij,hwj->hwi", pose[:3, :3], torch.tensor(depth)[..., None] * local) + pose[:3, 3]


def points_homogeneous(depth, k, pose):
    rays = k.directions().reshape(-1, 3) * depth.reshape(-1, 1)
    return (np.c_[rays, np.ones(len(rays))] @ pose.T)[:, :3].reshape(*depth.shape, 3)


def of_pixels(depth, k, ray):
    return np.array([[d * ray(u, v) for u, d in enumerate(row)] for v, row in enumerate(depth)])


RIGHT = {
    "01-heading": (
        lambda pose: math.atan2(-pose[1, 2], -pose[0, 2]),
        lambda pose: torch.atan2(*(-torch.tensor(pose)[[1, 0], 2])),
        lambda pose: cmath.phase(-pose[0, 2] - 1j * pose[1, 2]),
        lambda pose: np.arctan2(pose[0, 0], -pose[1, 0], dtype=np.float32),
        lambda pose: np.angle(-(pose[0, 2] + 1j * pose[1, 2])),
        lambda pose: math.atan2(*(pose[:3, :3] @ [0, 0, -1])[1::-1]),
    ),
    "01-pixel-to-ray": (
        ray_torch,
        ray_loops,
        ray_homogeneous,
        lambda u, v, k, pose: Rotation.from_matrix(pose[:3, :3]).apply(ray_loops(u, v, k, np.eye(4))),
        lambda u, v, k, pose: (k.directions().reshape(k.height, k.width, 3)[v, u] @ pose[:3, :3].T).astype(np.float32),
    ),
    "01-depth-to-points": (
        points_loops,
        points_torch,
        points_homogeneous,
        lambda d, k, pose: points_homogeneous(d, k, pose).tolist(),
        lambda d, k, pose: (
            np.einsum(
                "ij,hwj->hwi", pose[:3, :3], of_pixels(d, k, lambda u, v: np.array(ray_loops(u, v, k, np.eye(4))))
            )
            + pose[:3, 3]
        ),
    ),
}
WRONG = {
    "01-heading": (
        ("The result is off by 90", lambda pose: math.atan2(pose[1, 0], pose[0, 0])),
        ("The result is off by 180", lambda pose: torch.tensor(math.atan2(pose[1, 2], pose[0, 2]))),
        ("arctan loses", lambda pose: math.atan((pose[:3, :3] @ [0, 0, -1])[1] / (pose[:3, :3] @ [0, 0, -1])[0])),
        ("The result is in degrees", lambda pose: math.degrees(math.atan2(-pose[1, 2], -pose[0, 2]))),
        ("The sign is wrong", lambda pose: cmath.phase(-pose[0, 2] + 1j * pose[1, 2])),
    ),
    "01-pixel-to-ray": (
        ("This is the corner", lambda u, v, k, pose: ray_loops(u - 0.5, v - 0.5, k, pose)),
        ("This direction is in the camera frame", lambda u, v, k, pose: ray_loops(u, v, k, np.eye(3))),
        ("Rotate a direction", lambda u, v, k, pose: (pose @ [*ray_loops(u, v, k, np.eye(3)), 1])[:3]),
        ("The transposed", lambda u, v, k, pose: torch.tensor(np.array(ray_loops(u, v, k, np.eye(3))) @ pose[:3, :3])),
        ("This direction has length 1", lambda u, v, k, pose: (r := ray_homogeneous(u, v, k, pose)) / math.hypot(*r)),
    ),
    "01-depth-to-points": (
        (
            "The points are rotated, but",
            lambda d, k, pose: of_pixels(d, k, lambda u, v: ray_homogeneous(u, v, k, pose)),
        ),
        ("The points are translated, but", lambda d, k, pose: points_homogeneous(d, k, np.eye(4)) + pose[:3, 3]),
        (
            "This is the inverse rotation",
            lambda d, k, pose: (
                of_pixels(d, k, lambda u, v: pose[:3, :3].T @ ray_loops(u, v, k, np.eye(3))) + pose[:3, 3]
            ),
        ),
        (
            "expected an array of shape (2, 2, 3), got shape (4, 3)",
            lambda d, k, pose: points_loops(d, k, pose).reshape(-1, 3),
        ),
        (
            "expected an array of shape (2, 2, 3), got shape (3, 2, 2)",
            lambda d, k, pose: np.moveaxis(points_loops(d, k, pose), -1, 0),
        ),
    ),
}
