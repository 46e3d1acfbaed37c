"""Exercises of notebook 10: angle between two rotations, motion of a camera, gradient of a motion.

Students read the solutions. They compute for one camera what ``evaluators.pose_refinement`` computes for a batch.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from autonerf_lab.course.checker import Case, Exercise, Mistake
from autonerf_lab.geometry import planar_pose, so3_exp


def angle(a: np.ndarray, b: np.ndarray) -> float:
    """Return the angle between two rotations, degrees."""
    cosine = (np.trace(a.T @ b) - 1) / 2
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))  # rounding errors may exceed 1


def moved(pose: np.ndarray, omega: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the pose after a rotation and a translation in the camera frame."""
    from autonerf_lab.geometry import so3_exp

    after = pose.copy()
    after[:3, :3] = pose[:3, :3] @ so3_exp(omega)
    after[:3, 3] = pose[:3, 3] + pose[:3, :3] @ v
    return after


def gradient(directions: np.ndarray, rotation: np.ndarray, grad_o: np.ndarray, grad_d: np.ndarray) -> np.ndarray:
    """Return the gradient (6,) of a sum over rays for rotation and translation."""
    local_o, local_d = grad_o @ rotation, grad_d @ rotation  # multiplying rows by R applies R^T to each
    return np.concatenate([np.cross(directions, local_d).sum(axis=0), local_o.sum(axis=0)])


def _composed(pose: np.ndarray, rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    after = pose.copy()
    after[:3, :3], after[:3, 3] = rotation, translation
    return after


_TILTED = so3_exp(np.radians([30.0, 0, 0]))
_BOTH = so3_exp(np.radians([40.0, 0, 0])) @ so3_exp(np.radians([0.0, 30, 0]))
_EAST = planar_pose(2.0, 1.0, 0.0)
_X, _Y, _Z = np.eye(3)

ANGLE = Exercise(
    "10-angle",
    "Return the angle between two rotations, degrees in [0, 180].",
    (
        Case("two rotations that are 30 degrees apart", (np.eye(3), _TILTED), 30.0),
        Case("30 degrees about x and -60 degrees about x", (_TILTED, so3_exp(np.radians([-60.0, 0, 0]))), 90.0),
        Case("a rotation of 180 degrees", (np.eye(3), np.diag([1.0, -1.0, -1.0])), 180.0),
        Case(
            "40 degrees about x, then 30 about y",
            (np.eye(3), _BOTH),
            float(np.degrees(2 * np.arccos(np.cos(np.radians(20)) * np.cos(np.radians(15))))),
        ),
        Case("a rotation with itself, where rounding makes the trace 3.000000006", ((1 + 1e-9) * np.eye(3),) * 2, 0.0),
    ),
    angle,
    (
        Mistake("The result is in radians. Return degrees.", lambda a, b: np.radians(angle(a, b))),
        Mistake(
            "The relative rotation is the transpose of the first times the second, a.T @ b.",
            lambda a, b: angle(a.T, b),
        ),
        Mistake(
            "The trace of a rotation is 1 + 2 cos(angle).",
            lambda a, b: np.degrees(np.arccos(np.clip(np.trace(a.T @ b) / 3, -1, 1))),
        ),
        Mistake(
            "Rounding can make the cosine exceed 1, where arccos is NaN. Clip it to [-1, 1].",
            lambda a, b: np.degrees(np.arccos((np.trace(a.T @ b) - 1) / 2)),
        ),
        Mistake(
            "The sum of Euler angles depends on the choice of axes and is too large. (The released code uses it.)",
            lambda a, b: np.abs(Rotation.from_matrix(a.T @ b).as_euler("xyz", degrees=True)).sum(),
        ),
    ),
)

MOVED = Exercise(
    "10-moved",
    "Return a pose, (4, 4), after a rotation (vector omega) and a translation v, both in the camera frame.",
    (
        Case(
            "1 m to the right, of a camera at (2, 1) that looks along +x",
            (_EAST, 0 * _X, _X),
            planar_pose(2.0, 0.0, 0.0),
        ),
        Case(
            "90 degrees to the left without translation",
            (_EAST, np.pi / 2 * _Y, 0 * _X),
            planar_pose(2.0, 1.0, np.pi / 2),
        ),
        Case(
            "90 degrees to the left, and 1 m along the previous viewing direction",
            (_EAST, np.pi / 2 * _Y, -_Z),
            planar_pose(3.0, 1.0, np.pi / 2),
        ),
    ),
    moved,
    (
        Mistake(
            "The camera rotates about the origin of the world: multiply the motion on the right of the pose.",
            lambda pose, w, v: _composed(np.eye(4), so3_exp(w), v) @ pose,
        ),
        Mistake(
            "The rotation is about the axes of the world: use R exp(omega), not exp(omega) R.",
            lambda pose, w, v: _composed(pose, so3_exp(w) @ pose[:3, :3], pose[:3, 3] + pose[:3, :3] @ v),
        ),
        Mistake(
            "The translation is along the axes of the world, but v is in the camera frame: add R v.",
            lambda pose, w, v: _composed(pose, pose[:3, :3] @ so3_exp(w), pose[:3, 3] + v),
        ),
        Mistake(
            "The translation uses the rotation after the motion: use the rotation before it.",
            lambda pose, w, v: pose @ _composed(np.eye(4), so3_exp(w), so3_exp(w) @ v),
        ),
        Mistake(
            "1 + [omega]x is only a first-order approximation of a rotation: use so3_exp(omega).",
            lambda pose, w, v: _composed(
                pose, pose[:3, :3] @ (np.eye(3) + np.cross(np.eye(3), w)), pose[:3, 3] + pose[:3, :3] @ v
            ),
        ),
    ),
)

_RAYS = np.array([[0.0, 0, -1], [0.5, 0, -1], [0, 0.5, -1]])
_GRAD_O = np.array([[1.0, 0, 0], [0, 2, 0], [0, 0, 4]])
_GRAD_D = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])

GRADIENT = Exercise(
    "10-gradient",
    "Return the gradient, (6,), of a sum over rays with respect to rotation and translation in the camera frame.",
    (
        Case(
            "three rays of a camera aligned with the world",
            (_RAYS, np.eye(3), _GRAD_O, _GRAD_D),
            np.array([1.0, -1.5, -0.5, 1, 2, 4]),
        ),
        Case(
            "the same for a camera that looks along +x",
            (_RAYS, _EAST[:3, :3], _GRAD_O, _GRAD_D),
            gradient(_RAYS, _EAST[:3, :3], _GRAD_O, _GRAD_D),
        ),
    ),
    gradient,
    (
        Mistake(
            "The cross product is reversed: a rotation delta changes a ray d by delta x d, so the gradient is d x g.",
            lambda d, r, o, g: np.concatenate([np.cross(g @ r, d).sum(axis=0), (o @ r).sum(axis=0)]),
        ),
        Mistake(
            "The gradients are in the world frame: transform them into the camera frame with R^T.",
            lambda d, r, o, g: gradient(d, np.eye(3), o, g),
        ),
        Mistake(
            "This applies R instead of R^T: for vectors stored as rows, use g @ R.",
            lambda d, r, o, g: gradient(d, r.T, o, g),
        ),
        Mistake(
            "The order is wrong: rotation first, then translation.", lambda d, r, o, g: np.roll(gradient(d, r, o, g), 3)
        ),
        Mistake("This is the mean over the rays. Return the sum.", lambda d, r, o, g: gradient(d, r, o, g) / len(d)),
        Mistake(
            "This is one gradient per ray. One motion moves all rays: sum over them.",
            lambda d, r, o, g: np.concatenate([np.cross(d, g @ r), o @ r], axis=1),
        ),
    ),
)

EXERCISES = (ANGLE, MOVED, GRADIENT)
