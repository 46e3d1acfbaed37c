"""Exercises of notebook 14: sum of motions, Jacobian of a point-to-plane distance, Gauss-Newton step."""

import numpy as np

from autonerf_lab.course.checker import Case, Exercise, Mistake


def after(pose: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """Return the planar pose after a motion in the frame of the robot."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    forward, left, turn = motion
    return np.array([pose[0] + c * forward - s * left, pose[1] + s * forward + c * left, pose[2] + turn])


def row(normal: np.ndarray, point: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Return the derivative of a point-to-plane distance with respect to x, y and heading of the robot."""
    x, y = point - position
    return np.array([normal[0], normal[1], normal[1] * x - normal[0] * y])


def step(jacobian: np.ndarray, residuals: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the weighted Gauss-Newton step."""
    weighted = jacobian * weights[:, None]
    return -np.linalg.solve(weighted.T @ jacobian, weighted.T @ residuals)


_EAST, _NORTH = np.array([1.0, 2.0, 0.0]), np.array([1.0, 2.0, np.pi / 2])
_CURVE = np.array([0.25, 0.02, 0.3])

AFTER = Exercise(
    "14-after",
    "Return x, y and heading, (3,), after a motion: metres forward, metres to the left, radians counter-clockwise.",
    (
        Case("looking along +x", (_EAST, _CURVE), np.array([1.25, 2.02, 0.3])),
        Case("looking along +y", (_NORTH, _CURVE), np.array([0.98, 2.25, np.pi / 2 + 0.3])),
        Case("looking back", (np.array([0.0, 0.0, np.pi]), np.array([1.0, 0.0, 0.0])), np.array([-1.0, 0.0, np.pi])),
    ),
    after,
    (
        Mistake(
            "The motion is in the frame of the robot. Rotate it into the world.", lambda pose, motion: pose + motion
        ),
        Mistake(
            "The robot turns at the end of the motion: rotate by the heading before it.",
            lambda pose, motion: after(pose + motion * [0, 0, 1], motion * [1, 1, 0]),
        ),
        Mistake(
            "The rotation has the wrong sign: forward is (cos, sin) and left is (-sin, cos).",
            lambda pose, motion: after(pose * [1, 1, -1], motion * [1, 1, -1]) * [1, 1, -1],
        ),
        Mistake(
            "Left has the wrong sign: at heading 0, left is +y.",
            lambda pose, motion: after(pose, motion * [1, -1, 1]),
        ),
    ),
)

_AT = np.array([1.0, 1.0])

ROW = Exercise(
    "14-row",
    "Return the derivative, (3,), of the distance between a seen point and a wall, by x, y and heading of the robot.",
    (
        Case("a wall ahead, straight in front", (np.array([-1.0, 0]), np.array([3.0, 1]), _AT), np.array([-1.0, 0, 0])),
        Case("a wall ahead, 1 m to the left", (np.array([-1.0, 0]), np.array([3.0, 2]), _AT), np.array([-1.0, 0, 1])),
        Case("a wall to the left, 2 m ahead", (np.array([0.0, -1]), np.array([3.0, 2]), _AT), np.array([0.0, -1, -2])),
    ),
    row,
    (
        Mistake(
            "The robot turns about itself, not about the origin of the world: use the point minus the position.",
            lambda normal, point, position: row(normal, point, 0 * position),
        ),
        Mistake(
            "The heading has the wrong sign: counter-clockwise, (x, y) moves by (-y, x).",
            lambda normal, point, position: row(normal, point, position) * [1, 1, -1],
        ),
        Mistake(
            "The seen point moves with the robot, so that the first two entries are the normal itself, not minus.",
            lambda normal, point, position: row(normal, point, position) * [-1, -1, 1],
        ),
        Mistake(
            "The entry of the heading is missing: a turn moves points that are far from the robot.",
            lambda normal, point, position: row(normal, position, position),
        ),
    ),
)

_JACOBIAN = np.array([[1.0, 0, 0], [0, 2, 0], [0, 0, 1], [1, 1, 1]])
_RESIDUALS = np.array([0.1, -0.2, 0.3, 0.4])

STEP = Exercise(
    "14-step",
    "Return the Gauss-Newton step (k,) of weighted residuals, from Jacobian (N, k), residuals (N,) and weights (N,).",
    (
        Case("one variable", (np.array([[2.0]]), np.array([1.0]), np.ones(1)), np.array([-0.5])),
        Case("three variables", (_JACOBIAN, _RESIDUALS, np.ones(4)), step(_JACOBIAN, _RESIDUALS, np.ones(4))),
        Case(
            "the last residual counts a tenth",
            (_JACOBIAN, _RESIDUALS, np.array([1, 1, 1, 0.1])),
            step(_JACOBIAN, _RESIDUALS, np.array([1, 1, 1, 0.1])),
        ),
    ),
    step,
    (
        Mistake("The sign is wrong: the step makes the residuals smaller.", lambda j, r, w: -step(j, r, w)),
        Mistake("The weights are missing.", lambda j, r, w: step(j, r, np.ones_like(w))),
        Mistake("This is the negative gradient. Solve J^T W J step = -J^T W r.", lambda j, r, w: -(j.T @ (w * r))),
        Mistake("The weights are squared. They belong once into each product.", lambda j, r, w: step(j, r, w**2)),
    ),
)

EXERCISES = (AFTER, ROW, STEP)
