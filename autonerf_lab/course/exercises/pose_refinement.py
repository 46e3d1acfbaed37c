"""Exercises of notebook 10: the angle between two poses, a motion of the camera, the gradient of a motion.

The solutions are read by students: they say for one camera what ``evaluators.pose_refinement`` does for many at once.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from autonerf_lab.course.checker import Case, Exercise, Mistake
from autonerf_lab.geometry import planar_pose, skew, so3_exp


def angle(a: np.ndarray, b: np.ndarray) -> float:
    cosine = (np.trace(a.T @ b) - 1) / 2
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))  # rounding may lead a little beyond 1


def moved(pose: np.ndarray, omega: np.ndarray, v: np.ndarray) -> np.ndarray:
    after = pose.copy()
    after[:3, :3] = pose[:3, :3] @ so3_exp(omega)
    after[:3, 3] = pose[:3, 3] + pose[:3, :3] @ v
    return after


def gradient(directions: np.ndarray, rotation: np.ndarray, grad_o: np.ndarray, grad_d: np.ndarray) -> np.ndarray:
    local_o, local_d = grad_o @ rotation, grad_d @ rotation  # rows times R is R^T times each
    return np.concatenate([np.cross(directions, local_d).sum(axis=0), local_o.sum(axis=0)])


def _composed(pose: np.ndarray, turn: np.ndarray, shift: np.ndarray) -> np.ndarray:
    after = pose.copy()
    after[:3, :3], after[:3, 3] = turn, shift
    return after


_TILTED = so3_exp(np.radians([30.0, 0, 0]))
_BOTH = so3_exp(np.radians([40.0, 0, 0])) @ so3_exp(np.radians([0.0, 30, 0]))
_EAST = planar_pose(2.0, 1.0, 0.0)
_X, _Y, _Z = np.eye(3)

ANGLE = Exercise(
    "10-angle",
    "By how much one rotation has to be turned to become another, degrees in [0, 180].",
    (
        Case("two rotations that are 30 degrees apart", (np.eye(3), _TILTED), 30.0),
        Case("30 degrees to one side, and 60 to the other", (_TILTED, so3_exp(np.radians([-60.0, 0, 0]))), 90.0),
        Case("a half turn", (np.eye(3), np.diag([1.0, -1.0, -1.0])), 180.0),
        Case(
            "40 degrees about x, then 30 about y",
            (np.eye(3), _BOTH),
            float(np.degrees(2 * np.arccos(np.cos(np.radians(20)) * np.cos(np.radians(15))))),
        ),
        Case("a rotation with itself, where rounding made the trace 3.000000006", ((1 + 1e-9) * np.eye(3),) * 2, 0.0),
    ),
    angle,
    (
        Mistake("Degrees, please.", lambda a, b: np.radians(angle(a, b))),
        Mistake(
            "From one to the other leads the inverse of the first, its transpose, times the second.",
            lambda a, b: angle(a.T, b),
        ),
        Mistake(
            "The trace of a rotation is 1 + 2 cos(angle).",
            lambda a, b: np.degrees(np.arccos(np.clip(np.trace(a.T @ b) / 3, -1, 1))),
        ),
        Mistake(
            "Rounding can bring the cosine beyond 1, and arccos is NaN there: clip it.",
            lambda a, b: np.degrees(np.arccos((np.trace(a.T @ b) - 1) / 2)),
        ),
        Mistake(
            "The sum of three Euler angles depends on how the axes lie, and is too large. (The released code took it.)",
            lambda a, b: np.abs(Rotation.from_matrix(a.T @ b).as_euler("xyz", degrees=True)).sum(),
        ),
    ),
)

MOVED = Exercise(
    "10-moved",
    "A pose, (4, 4), after a motion: turned by a rotation vector and moved, both as the camera sees them.",
    (
        Case(
            "1 m to the right, of a camera at (2, 1) that looks along +x",
            (_EAST, 0 * _X, _X),
            planar_pose(2.0, 0.0, 0.0),
        ),
        Case(
            "a quarter turn to the left, on the spot",
            (_EAST, np.pi / 2 * _Y, 0 * _X),
            planar_pose(2.0, 1.0, np.pi / 2),
        ),
        Case(
            "a quarter turn to the left, and 1 m to where it looked before",
            (_EAST, np.pi / 2 * _Y, -_Z),
            planar_pose(3.0, 1.0, np.pi / 2),
        ),
    ),
    moved,
    (
        Mistake(
            "It flew around the middle of the world: the motion belongs on the right of the pose, not on the left.",
            lambda pose, w, v: _composed(np.eye(4), so3_exp(w), v) @ pose,
        ),
        Mistake(
            "The turn is about the world's axes: the camera's are meant, R exp and not exp R.",
            lambda pose, w, v: _composed(pose, so3_exp(w) @ pose[:3, :3], pose[:3, 3] + pose[:3, :3] @ v),
        ),
        Mistake(
            "The shift is along the world's axes: R v goes along the camera's.",
            lambda pose, w, v: _composed(pose, pose[:3, :3] @ so3_exp(w), pose[:3, 3] + v),
        ),
        Mistake(
            "It moves along the axes that it has after the turn: the rotation before it is meant.",
            lambda pose, w, v: pose @ _composed(np.eye(4), so3_exp(w), so3_exp(w) @ v),
        ),
        Mistake(
            "1 + [omega]x is no rotation but for a tiny turn: so3_exp(omega) is one.",
            lambda pose, w, v: _composed(pose, pose[:3, :3] @ (np.eye(3) + skew(w)), pose[:3, 3] + pose[:3, :3] @ v),
        ),
    ),
)

_RAYS = np.array([[0.0, 0, -1], [0.5, 0, -1], [0, 0.5, -1]])
_GRAD_O = np.array([[1.0, 0, 0], [0, 2, 0], [0, 0, 4]])
_GRAD_D = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])

GRADIENT = Exercise(
    "10-gradient",
    "The gradient, (6,), of a sum over rays for a turn and a shift of the camera, in its own frame.",
    (
        Case(
            "three rays of a camera that stands as the world does",
            (_RAYS, np.eye(3), _GRAD_O, _GRAD_D),
            np.array([1.0, -1.5, -0.5, 1, 2, 4]),
        ),
        Case(
            "the same of a camera that looks along +x",
            (_RAYS, _EAST[:3, :3], _GRAD_O, _GRAD_D),
            gradient(_RAYS, _EAST[:3, :3], _GRAD_O, _GRAD_D),
        ),
    ),
    gradient,
    (
        Mistake(
            "A turn delta changes a ray d by delta x d, so its gradient is d x g: the cross product is reversed.",
            lambda d, r, o, g: np.concatenate([np.cross(g @ r, d).sum(axis=0), (o @ r).sum(axis=0)]),
        ),
        Mistake(
            "The gradients are in the world's frame: R^T brings them into the camera's.",
            lambda d, r, o, g: gradient(d, np.eye(3), o, g),
        ),
        Mistake("This is R and not R^T: for vectors in rows it is g @ R.", lambda d, r, o, g: gradient(d, r.T, o, g)),
        Mistake("First the turn, then the shift.", lambda d, r, o, g: np.roll(gradient(d, r, o, g), 3)),
        Mistake("The sum over the rays, please, and not the mean.", lambda d, r, o, g: gradient(d, r, o, g) / len(d)),
        Mistake(
            "One motion moves all rays: sum over them.",
            lambda d, r, o, g: np.concatenate([np.cross(d, g @ r), o @ r], axis=1),
        ),
    ),
)

EXERCISES = (ANGLE, MOVED, GRADIENT)
