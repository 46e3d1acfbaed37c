"""Exercises of notebook 13: which way is up, poses of other programs, what a lens does.

The solutions are read by students: they say for one point what the package does for all.
"""

import numpy as np

from autonerf_lab.course.checker import Case, Exercise, Mistake


def upright(point: np.ndarray) -> np.ndarray:
    x, y, z = point  # y is up here, and z points to whoever looks along -z
    return np.array([x, -z, y])  # a quarter turn around x: nothing is mirrored


def camera_to_world(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = rotation.T @ np.diag([1.0, -1.0, -1.0])  # y down becomes y up, and z forward becomes backward
    pose[:3, 3] = -rotation.T @ translation
    return pose


def seen_at(x: float, y: float, k1: float, k2: float) -> np.ndarray:
    r2 = x * x + y * y
    return np.array([x, y]) * (1 + k1 * r2 + k2 * r2 * r2)


UPRIGHT = Exercise(
    "13-upright",
    "A point of a file whose y axis is up, (3,), in a world whose z axis is up; x stays as it is.",
    (
        Case("a lamp 2 m above the origin", (np.array([0.0, 2.0, 0.0]),), np.array([0.0, 0.0, 2.0])),
        Case("the point (1, 2, 3)", (np.array([1.0, 2.0, 3.0]),), np.array([1.0, -3.0, 2.0])),
    ),
    upright,
    (
        Mistake(
            "The room is mirrored: two axes change places, and nothing else. A turn also changes a sign.",
            lambda p: np.array([p[0], p[2], p[1]]),
        ),
        Mistake("The room stands on its ceiling.", lambda p: np.array([p[0], p[2], -p[1]])),
        Mistake("The room is mirrored and upside down.", lambda p: np.array([p[0], -p[2], -p[1]])),
        Mistake("Nothing has changed: y is still up.", np.array),
        Mistake(
            "All axes have moved on by one: up is right, and no point is mirrored, but x was to stay as it is.",
            lambda p: np.array([p[2], p[0], p[1]]),
        ),
    ),
)

_AHEAD = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])  # level, looking along +x
_MOVED = np.array([2.0, 1.0, -3.0])


def _posed(rotation: np.ndarray, place: np.ndarray) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, place
    return pose


_FLIP = np.diag([1.0, -1.0, -1.0])

CAMERA_TO_WORLD = Exercise(
    "13-camera-to-world",
    "The pose of a camera (4, 4), camera-to-world and OpenGL, from COLMAP's world-to-camera rotation and translation.",
    (
        Case("a camera in the origin, not turned", (np.eye(3), np.zeros(3)), np.diag([1.0, -1.0, -1.0, 1.0])),
        Case("not turned, translation (2, 1, -3)", (np.eye(3), _MOVED), _posed(_FLIP, -_MOVED)),
        Case(
            "level, looking along +x, translation (2, 1, -3)",
            (_AHEAD, _MOVED),
            np.array([[0, 0, -1, 3.0], [-1, 0, 0, 2.0], [0, 1, 0, 1.0], [0, 0, 0, 1]]),
        ),
    ),
    camera_to_world,
    (
        Mistake(
            "The axes of OpenCV: y down, z forward. In OpenGL y is up and the camera looks along -z: two columns flip.",
            lambda R, t: _posed(R.T, -R.T @ t),
        ),
        Mistake(
            "This still leads from the world to the camera. Inverted, the rotation is R^T, and the place is -R^T t.",
            lambda R, t: _posed(R @ _FLIP, t),
        ),
        Mistake(
            "The place of the camera is not the translation: a world point p is seen at R p + t, and the camera is "
            "where that is 0.",
            lambda R, t: _posed(R.T @ _FLIP, t),
        ),
        Mistake("The camera has the wrong sign: its place is -R^T t.", lambda R, t: _posed(R.T @ _FLIP, R.T @ t)),
        Mistake("The translation is turned back, by R^T, and not only reversed.", lambda R, t: _posed(R.T @ _FLIP, -t)),
        Mistake(
            "Rows of the rotation are flipped, which turns the world. Columns belong to the camera's axes.",
            lambda R, t: _posed(_FLIP @ R.T, -R.T @ t),
        ),
    ),
)

SEEN_AT = Exercise(
    "13-seen-at",
    "Where a lens shows what a pinhole would show at (x, y), as tangents, (2,): the radial part of OpenCV's model.",
    (
        Case("the middle of the image, k1 = -0.2", (0.0, 0.0, -0.2, 0.05), np.zeros(2)),
        Case("x = 1, y = 0, k1 = -0.2, k2 = 0", (1.0, 0.0, -0.2, 0.0), np.array([0.8, 0.0])),
        Case("x = 1, y = 1, k1 = -0.2, k2 = 0.05", (1.0, 1.0, -0.2, 0.05), np.array([0.8, 0.8])),
    ),
    seen_at,
    (
        Mistake(
            "k1 belongs to r squared and k2 to r to the fourth: here they stand with r and r squared.",
            lambda x, y, k1, k2: np.array([x, y]) * (1 + k1 * np.hypot(x, y) + k2 * (x * x + y * y)),
        ),
        Mistake(
            "That is what the lens adds. The point itself is missing: 1 + k1 r^2 + k2 r^4.",
            lambda x, y, k1, k2: np.array([x, y]) * (k1 * (x * x + y * y) + k2 * (x * x + y * y) ** 2),
        ),
        Mistake(
            "A lens bends away from the axis in all directions at once: r^2 = x^2 + y^2 in both coordinates.",
            lambda x, y, k1, k2: np.array([x * (1 + k1 * x * x + k2 * x**4), y * (1 + k1 * y * y + k2 * y**4)]),
        ),
        Mistake("k2 is missing.", lambda x, y, k1, k2: seen_at(x, y, k1, 0.0)),
        Mistake(
            "The other way round: this divides, as if to take the distortion away.",
            lambda x, y, k1, k2: np.array([x, y]) / (1 + k1 * (x * x + y * y) + k2 * (x * x + y * y) ** 2),
        ),
    ),
)

EXERCISES = (UPRIGHT, CAMERA_TO_WORLD, SEEN_AT)
