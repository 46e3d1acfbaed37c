"""Exercises of notebook 13: the up axis, poses of COLMAP, lens distortion.

Students read the solutions. They compute for one point what the package computes for all.
"""

import numpy as np

from autonerf_lab.course.checker import Case, Exercise, Mistake


def upright(point: np.ndarray) -> np.ndarray:
    """Convert a point from y up to z up."""
    x, y, z = point  # y is up, z points backwards
    return np.array([x, -z, y])  # rotation by 90 degrees about x


def camera_to_world(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """Return the OpenGL camera-to-world pose of a COLMAP camera."""
    pose = np.eye(4)
    pose[:3, :3] = rotation.T @ np.diag([1.0, -1.0, -1.0])  # OpenCV axes (y down, z forward) to OpenGL (y up, z back)
    pose[:3, 3] = -rotation.T @ translation
    return pose


def seen_at(x: float, y: float, k1: float, k2: float) -> np.ndarray:
    """Return the distorted position, (2,), of normalised image coordinates (x, y)."""
    r2 = x * x + y * y
    return np.array([x, y]) * (1 + k1 * r2 + k2 * r2 * r2)


UPRIGHT = Exercise(
    "13-upright",
    "Convert a point, (3,), from a frame with y up to a frame with z up; x is unchanged.",
    (
        Case("a lamp 2 m above the origin", (np.array([0.0, 2.0, 0.0]),), np.array([0.0, 0.0, 2.0])),
        Case("the point (1, 2, 3)", (np.array([1.0, 2.0, 3.0]),), np.array([1.0, -3.0, 2.0])),
    ),
    upright,
    (
        Mistake(
            "The room is mirrored: the axes are swapped without a sign change. A rotation also changes one sign.",
            lambda p: np.array([p[0], p[2], p[1]]),
        ),
        Mistake("The room is upside down.", lambda p: np.array([p[0], p[2], -p[1]])),
        Mistake("The room is mirrored and upside down.", lambda p: np.array([p[0], -p[2], -p[1]])),
        Mistake("The point is unchanged: y is still up.", np.array),
        Mistake(
            "The axes are permuted cyclically: z is up, but x has changed.",
            lambda p: np.array([p[2], p[0], p[1]]),
        ),
    ),
)

_AHEAD = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])  # level, looks along +x
_MOVED = np.array([2.0, 1.0, -3.0])


def _pose(rotation: np.ndarray, position: np.ndarray) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, position
    return pose


_FLIP = np.diag([1.0, -1.0, -1.0])

CAMERA_TO_WORLD = Exercise(
    "13-camera-to-world",
    "Return the pose (4, 4), camera-to-world, OpenGL axes, from the world-to-camera R and t of COLMAP.",
    (
        Case("a camera at the origin, not rotated", (np.eye(3), np.zeros(3)), np.diag([1.0, -1.0, -1.0, 1.0])),
        Case("not rotated, translation (2, 1, -3)", (np.eye(3), _MOVED), _pose(_FLIP, -_MOVED)),
        Case(
            "level, looking along +x, translation (2, 1, -3)",
            (_AHEAD, _MOVED),
            np.array([[0, 0, -1, 3.0], [-1, 0, 0, 2.0], [0, 1, 0, 1.0], [0, 0, 0, 1]]),
        ),
    ),
    camera_to_world,
    (
        Mistake(
            "These are OpenCV axes (y down, z forward). In OpenGL y is up and z points back: negate two columns.",
            lambda R, t: _pose(R.T, -R.T @ t),
        ),
        Mistake(
            "This is still world-to-camera. The inverse has rotation R^T and position -R^T t.",
            lambda R, t: _pose(R @ _FLIP, t),
        ),
        Mistake(
            "The translation t is not the camera position: a world point p has camera coordinates R p + t, which are 0 "
            "at the camera.",
            lambda R, t: _pose(R.T @ _FLIP, t),
        ),
        Mistake("The sign of the position is wrong: it is -R^T t.", lambda R, t: _pose(R.T @ _FLIP, R.T @ t)),
        Mistake("The position is -R^T t, not -t: rotate the translation as well.", lambda R, t: _pose(R.T @ _FLIP, -t)),
        Mistake(
            "This negates rows of the rotation, which changes the world axes. The camera axes are its columns.",
            lambda R, t: _pose(_FLIP @ R.T, -R.T @ t),
        ),
    ),
)

SEEN_AT = Exercise(
    "13-seen-at",
    "Return the distorted position, (2,), of normalised image coordinates (x, y): radial part of the OpenCV model.",
    (
        Case("the image centre, k1 = -0.2", (0.0, 0.0, -0.2, 0.05), np.zeros(2)),
        Case("x = 1, y = 0, k1 = -0.2, k2 = 0", (1.0, 0.0, -0.2, 0.0), np.array([0.8, 0.0])),
        Case("x = 1, y = 1, k1 = -0.2, k2 = 0.05", (1.0, 1.0, -0.2, 0.05), np.array([0.8, 0.8])),
    ),
    seen_at,
    (
        Mistake(
            "The powers are wrong: k1 multiplies r^2 and k2 multiplies r^4, not r and r^2.",
            lambda x, y, k1, k2: np.array([x, y]) * (1 + k1 * np.hypot(x, y) + k2 * (x * x + y * y)),
        ),
        Mistake(
            "This is only the displacement. Add the point itself: 1 + k1 r^2 + k2 r^4.",
            lambda x, y, k1, k2: np.array([x, y]) * (k1 * (x * x + y * y) + k2 * (x * x + y * y) ** 2),
        ),
        Mistake(
            "Radial distortion depends on the distance from the axis: use r^2 = x^2 + y^2 in both coordinates.",
            lambda x, y, k1, k2: np.array([x * (1 + k1 * x * x + k2 * x**4), y * (1 + k1 * y * y + k2 * y**4)]),
        ),
        Mistake("The term with k2 is missing.", lambda x, y, k1, k2: seen_at(x, y, k1, 0.0)),
        Mistake(
            "This divides by the factor, which removes distortion. Multiply instead.",
            lambda x, y, k1, k2: np.array([x, y]) / (1 + k1 * (x * x + y * y) + k2 * (x * x + y * y) ** 2),
        ),
    ),
)

EXERCISES = (UPRIGHT, CAMERA_TO_WORLD, SEEN_AT)
