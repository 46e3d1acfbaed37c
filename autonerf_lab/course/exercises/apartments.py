"""Exercises of notebook 01: frames, rays, depth.

Students read the solutions. They use the notation of the notebook; ``geometry`` computes the same for all pixels.
"""

import numpy as np

from autonerf_lab.course.checker import Case, Exercise, Mistake
from autonerf_lab.geometry import Intrinsics, planar_pose

_SQUARE = Intrinsics(width=4, height=4, fl_x=2.0, fl_y=2.0, cx=2.0, cy=2.0)
_WIDE = Intrinsics(width=8, height=4, fl_x=4.0, fl_y=2.0, cx=4.0, cy=2.0)
_TINY = Intrinsics(width=2, height=2, fl_x=1.0, fl_y=1.0, cx=1.0, cy=1.0)
_EAST, _NORTH = planar_pose(1.0, 2.0, 0.0), planar_pose(0.0, 0.0, np.pi / 2)


def pixel_to_ray(column: int, row: int, camera: Intrinsics, pose: np.ndarray) -> np.ndarray:
    """Return the world direction (3,) through the centre of a pixel, at depth 1."""
    right = (column + 0.5 - camera.cx) / camera.fl_x  # the centre of a pixel is at + 0.5
    down = (row + 0.5 - camera.cy) / camera.fl_y
    return pose[:3, :3] @ np.array([right, -down, -1.0])  # rows grow downwards; the camera looks along -z


def depth_to_points(depth: np.ndarray, camera: Intrinsics, pose: np.ndarray) -> np.ndarray:
    """Return the world points (H, W, 3), metres, of a depth image (H, W)."""
    column, row = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    right, down = (column - camera.cx) / camera.fl_x, (row - camera.cy) / camera.fl_y
    points = depth[..., None] * np.stack([right, -down, -np.ones_like(right)], axis=-1)
    return points @ pose[:3, :3].T + pose[:3, 3]


def heading(pose: np.ndarray) -> float:
    """Return the heading of a level camera, radians."""
    forward = -pose[:3, 2]  # the third column is the z axis of the camera, which looks along -z
    return float(np.arctan2(forward[1], forward[0]))


def _tangents(column: float, row: float, camera: Intrinsics) -> tuple[float, float]:
    return (column - camera.cx) / camera.fl_x, (row - camera.cy) / camera.fl_y


def _ray(column: int, row: int, camera: Intrinsics, flip: float = -1, z: float = -1, shift: float = 0.5) -> np.ndarray:
    right, down = _tangents(column + shift, row + shift, camera)
    return np.array([right, flip * down, z])


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


PIXEL_TO_RAY = Exercise(
    "01-pixel-to-ray",
    "Return the world direction through the centre of a pixel, (3,), scaled to a depth of 1.",
    (
        Case("column 2, row 1, 4 x 4 pixels, pose = identity", (2, 1, _SQUARE, np.eye(4)), np.array([0.25, 0.25, -1])),
        Case("the same pixel of a camera that looks along +x", (2, 1, _SQUARE, _EAST), np.array([1, -0.25, 0.25])),
        Case("the same pixel of a camera that looks along +y", (2, 1, _SQUARE, _NORTH), np.array([0.25, 1, 0.25])),
        Case("column 0, row 3, 8 x 4 pixels, along +x", (0, 3, _WIDE, _EAST), np.array([1, 0.875, -0.75])),
    ),
    pixel_to_ray,
    (
        Mistake(
            "The row index grows downwards, but the y axis of the camera points upwards.",
            lambda u, v, k, pose: pose[:3, :3] @ _ray(u, v, k, flip=1),
        ),
        Mistake(
            "The ray points backwards: an OpenGL camera looks along its own -z axis.",
            lambda u, v, k, pose: pose[:3, :3] @ _ray(u, v, k, z=1),
        ),
        Mistake(
            "y down and z forward is the OpenCV convention. Here y is up and the camera looks along -z.",
            lambda u, v, k, pose: pose[:3, :3] @ _ray(u, v, k, flip=1, z=1),
        ),
        Mistake(
            "This is the corner of the pixel. Its centre is half a pixel further right and half a pixel further down.",
            lambda u, v, k, pose: pose[:3, :3] @ _ray(u, v, k, shift=0),
        ),
        Mistake(
            "This direction is in the camera frame. Rotate it into the world frame with the rotation of the pose.",
            lambda u, v, k, pose: _ray(u, v, k),
        ),
        Mistake(
            "Rotate a direction, but do not translate it: the translation of the pose applies to points only.",
            lambda u, v, k, pose: pose[:3, :3] @ _ray(u, v, k) + pose[:3, 3],
        ),
        Mistake(
            "This direction has length 1. For a depth of 1 it must be longer, except at the image centre.",
            lambda u, v, k, pose: _unit(pose[:3, :3] @ _ray(u, v, k)),
        ),
        Mistake(
            "The transposed rotation maps from the world to the camera. Use the rotation itself.",
            lambda u, v, k, pose: pose[:3, :3].T @ _ray(u, v, k),
        ),
        Mistake(
            "Row and column are swapped: columns belong to x, rows to y.",
            lambda u, v, k, pose: pose[:3, :3] @ _ray(v, u, k),
        ),
    ),
)


def _rays(camera: Intrinsics, flip: float = -1) -> np.ndarray:
    return camera.directions() * [1, -flip, 1]


DEPTH_TO_POINTS = Exercise(
    "01-depth-to-points",
    "Return the world points of a depth image, (H, W, 3), metres.",
    (
        Case(
            "2 x 2 pixels at x = 1, y = 2, along +x, depth 2 m on the left and 4 m on the right",
            (np.array([[2.0, 4.0], [2.0, 4.0]]), _TINY, _EAST),
            np.array([[[3, 3, 1.88], [5, 0, 2.88]], [[3, 3, -0.12], [5, 0, -1.12]]]),
        ),
        Case(
            "2 x 2 pixels at the origin, along +y, a wall at 2 m",
            (np.full((2, 2), 2.0), _TINY, _NORTH),
            np.array([[[-1, 2, 1.88], [1, 2, 1.88]], [[-1, 2, -0.12], [1, 2, -0.12]]]),
        ),
    ),
    depth_to_points,
    (
        Mistake(
            "The wall becomes curved: depth is measured along the optical axis, not along the ray. Do not normalise.",
            lambda d, k, pose: d[..., None] * _unit(_rays(k)) @ pose[:3, :3].T + pose[:3, 3],
        ),
        Mistake(
            "The points are rotated, but not translated: add the position of the camera.",
            lambda d, k, pose: d[..., None] * _rays(k) @ pose[:3, :3].T,
        ),
        Mistake(
            "The points are translated, but not rotated: multiply them by the rotation of the pose first.",
            lambda d, k, pose: d[..., None] * _rays(k) + pose[:3, 3],
        ),
        Mistake(
            "This is the inverse rotation: points stored as rows are multiplied by the transpose, p R^T.",
            lambda d, k, pose: d[..., None] * _rays(k) @ pose[:3, :3] + pose[:3, 3],
        ),
        Mistake(
            "The points are upside down: the row index grows downwards, but the y axis of the camera points upwards.",
            lambda d, k, pose: d[..., None] * _rays(k, flip=1) @ pose[:3, :3].T + pose[:3, 3],
        ),
    ),
)

HEADING = Exercise(
    "01-heading",
    "Return the heading of a level camera from its pose, radians in (-pi, pi].",
    (
        Case("a camera that looks along +x", (planar_pose(3.0, 1.0, 0.0),), 0.0),
        Case("a heading of 30 degrees", (planar_pose(3.0, 1.0, np.pi / 6),), np.pi / 6),
        Case("a heading of 120 degrees", (planar_pose(3.0, 1.0, 2 * np.pi / 3),), 2 * np.pi / 3),
        Case("a heading of -60 degrees", (planar_pose(0.0, 0.0, -np.pi / 3),), -np.pi / 3),
    ),
    heading,
    (
        Mistake(
            "The result is off by 90 degrees: the first column is the x axis of the camera, which points to its right.",
            lambda pose: np.arctan2(pose[1, 0], pose[0, 0]),
        ),
        Mistake(
            "The result is off by 180 degrees: the camera looks along -z.",
            lambda pose: np.arctan2(pose[1, 2], pose[0, 2]),
        ),
        Mistake(
            "arctan loses the signs of x and y. Use arctan2(y, x).",
            lambda pose: np.arctan(pose[1, 2] / pose[0, 2]),
        ),
        Mistake("The result is in degrees. Return radians.", lambda pose: np.degrees(heading(pose))),
        Mistake(
            "The arguments of arctan2 are swapped: y comes first. This is an angle from +y, as on a compass.",
            lambda pose: np.arctan2(-pose[0, 2], -pose[1, 2]),
        ),
        Mistake("The sign is wrong: angles grow counter-clockwise, seen from above.", lambda pose: -heading(pose)),
    ),
)

EXERCISES = (PIXEL_TO_RAY, DEPTH_TO_POINTS, HEADING)
