"""Exercises of notebook 01: frames, rays, depth.

The solutions are read by students: they say in the notebook's words what ``geometry`` does for all pixels at once.
"""

import numpy as np

from autonerf_lab.course.checker import Case, Exercise, Mistake
from autonerf_lab.geometry import Intrinsics, planar_pose

_SQUARE = Intrinsics(width=4, height=4, fl_x=2.0, fl_y=2.0, cx=2.0, cy=2.0)
_WIDE = Intrinsics(width=8, height=4, fl_x=4.0, fl_y=2.0, cx=4.0, cy=2.0)
_TINY = Intrinsics(width=2, height=2, fl_x=1.0, fl_y=1.0, cx=1.0, cy=1.0)
_EAST, _NORTH = planar_pose(1.0, 2.0, 0.0), planar_pose(0.0, 0.0, np.pi / 2)


def pixel_to_ray(column: int, row: int, camera: Intrinsics, pose: np.ndarray) -> np.ndarray:
    right = (column + 0.5 - camera.cx) / camera.fl_x  # the centre of a pixel lies at a half
    down = (row + 0.5 - camera.cy) / camera.fl_y
    return pose[:3, :3] @ np.array([right, -down, -1.0])  # rows grow downwards; the camera looks along -z


def depth_to_points(depth: np.ndarray, camera: Intrinsics, pose: np.ndarray) -> np.ndarray:
    column, row = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    right, down = (column - camera.cx) / camera.fl_x, (row - camera.cy) / camera.fl_y
    points = depth[..., None] * np.stack([right, -down, -np.ones_like(right)], axis=-1)
    return points @ pose[:3, :3].T + pose[:3, 3]


def heading(pose: np.ndarray) -> float:
    forward = -pose[:3, 2]  # the third column is the camera's z axis, and it looks along -z
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
    "The world direction through the centre of a pixel, (3,), as long as it takes to be at depth 1.",
    (
        Case("column 2, row 1, 4 x 4 pixels, pose = identity", (2, 1, _SQUARE, np.eye(4)), np.array([0.25, 0.25, -1])),
        Case("the same pixel of a camera that looks along +x", (2, 1, _SQUARE, _EAST), np.array([1, -0.25, 0.25])),
        Case("the same pixel of a camera that looks along +y", (2, 1, _SQUARE, _NORTH), np.array([0.25, 1, 0.25])),
        Case("column 0, row 3, 8 x 4 pixels, along +x", (0, 3, _WIDE, _EAST), np.array([1, 0.875, -0.75])),
    ),
    pixel_to_ray,
    (
        Mistake(
            "Rows grow downwards, and the camera's y axis points upwards.",
            lambda u, v, k, pose: pose[:3, :3] @ _ray(u, v, k, flip=1),
        ),
        Mistake(
            "The ray goes backwards: an OpenGL camera looks along its own -z.",
            lambda u, v, k, pose: pose[:3, :3] @ _ray(u, v, k, z=1),
        ),
        Mistake(
            "y down and z forward is the frame of OpenCV; here y is up, and the camera looks along -z.",
            lambda u, v, k, pose: pose[:3, :3] @ _ray(u, v, k, flip=1, z=1),
        ),
        Mistake(
            "That is the pixel's corner. Its centre lies half a pixel to the right and half a pixel further down.",
            lambda u, v, k, pose: pose[:3, :3] @ _ray(u, v, k, shift=0),
        ),
        Mistake(
            "This is the direction in the camera's frame; the rotation of the pose brings it into the world.",
            lambda u, v, k, pose: _ray(u, v, k),
        ),
        Mistake(
            "A direction is turned but not moved: the last column of the pose belongs to points.",
            lambda u, v, k, pose: pose[:3, :3] @ _ray(u, v, k) + pose[:3, 3],
        ),
        Mistake(
            "It has length 1. To be at depth 1 it must be longer, the more the farther the pixel is from the middle.",
            lambda u, v, k, pose: _unit(pose[:3, :3] @ _ray(u, v, k)),
        ),
        Mistake(
            "The rotation goes the wrong way: its transpose leads from the world to the camera.",
            lambda u, v, k, pose: pose[:3, :3].T @ _ray(u, v, k),
        ),
        Mistake(
            "Columns belong to x and rows to y: they have changed places.",
            lambda u, v, k, pose: pose[:3, :3] @ _ray(v, u, k),
        ),
    ),
)


def _rays(camera: Intrinsics, flip: float = -1) -> np.ndarray:
    return camera.directions() * [1, -flip, 1]


DEPTH_TO_POINTS = Exercise(
    "01-depth-to-points",
    "The world points of a depth image, (H, W, 3), metres.",
    (
        Case(
            "2 x 2 pixels at x = 1, y = 2, along +x, depth 2 m on the left and 4 m on the right",
            (np.array([[2.0, 4.0], [2.0, 4.0]]), _TINY, _EAST),
            np.array([[[3, 3, 1.88], [5, 0, 2.88]], [[3, 3, -0.12], [5, 0, -1.12]]]),
        ),
        Case(
            "2 x 2 pixels in the origin, along +y, a wall at 2 m",
            (np.full((2, 2), 2.0), _TINY, _NORTH),
            np.array([[[-1, 2, 1.88], [1, 2, 1.88]], [[-1, 2, -0.12], [1, 2, -0.12]]]),
        ),
    ),
    depth_to_points,
    (
        Mistake(
            "The wall has become round: depth is measured along the optical axis, not along the ray. Do not normalise.",
            lambda d, k, pose: d[..., None] * _unit(_rays(k)) @ pose[:3, :3].T + pose[:3, 3],
        ),
        Mistake(
            "The camera is missing: the points are turned into the world, but not moved to where the camera is.",
            lambda d, k, pose: d[..., None] * _rays(k) @ pose[:3, :3].T,
        ),
        Mistake(
            "The points are not turned: multiply them by the rotation of the pose before they are moved.",
            lambda d, k, pose: d[..., None] * _rays(k) + pose[:3, 3],
        ),
        Mistake(
            "Points in rows are multiplied by the transpose of the rotation, p R^T: this is the inverse rotation.",
            lambda d, k, pose: d[..., None] * _rays(k) @ pose[:3, :3] + pose[:3, 3],
        ),
        Mistake(
            "The room is upside down: rows grow downwards, and the camera's y axis points upwards.",
            lambda d, k, pose: d[..., None] * _rays(k, flip=1) @ pose[:3, :3].T + pose[:3, 3],
        ),
    ),
)

HEADING = Exercise(
    "01-heading",
    "The heading of a level camera from its pose, radians in (-pi, pi].",
    (
        Case("a camera that looks along +x", (planar_pose(3.0, 1.0, 0.0),), 0.0),
        Case("a camera turned 30 degrees to the left of that", (planar_pose(3.0, 1.0, np.pi / 6),), np.pi / 6),
        Case("one turned by 120 degrees", (planar_pose(3.0, 1.0, 2 * np.pi / 3),), 2 * np.pi / 3),
        Case("one turned by 60 degrees to the right", (planar_pose(0.0, 0.0, -np.pi / 3),), -np.pi / 3),
    ),
    heading,
    (
        Mistake(
            "A quarter turn off: the first column is the camera's x axis, which points to its right.",
            lambda pose: np.arctan2(pose[1, 0], pose[0, 0]),
        ),
        Mistake("Half a turn off: the camera looks along -z.", lambda pose: np.arctan2(pose[1, 2], pose[0, 2])),
        Mistake(
            "arctan cannot tell forward from backward: arctan2(y, x) keeps the signs of both.",
            lambda pose: np.arctan(pose[1, 2] / pose[0, 2]),
        ),
        Mistake("Radians, please.", lambda pose: np.degrees(heading(pose))),
        Mistake(
            "arctan2 takes y first: this is an angle from +y, as on a compass.",
            lambda pose: np.arctan2(-pose[0, 2], -pose[1, 2]),
        ),
        Mistake("Angles grow counter-clockwise, seen from above.", lambda pose: -heading(pose)),
    ),
)

EXERCISES = (PIXEL_TO_RAY, DEPTH_TO_POINTS, HEADING)
