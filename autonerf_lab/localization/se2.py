"""Planar poses (x, y, heading) as arrays of three numbers, metres and radians, and covariances of motions."""

import numpy as np

from autonerf_lab.geometry import CAMERA_HEIGHT


def rotation(heading: float) -> np.ndarray:
    """Return the (2, 2) rotation matrix of an angle in radians."""
    c, s = np.cos(heading), np.sin(heading)
    return np.array([[c, -s], [s, c]])


def compose(pose: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """Return a pose after a motion given in its own frame; (..., 3) each.

    Example:
        >>> compose(np.array([1.0, 1.0, np.pi / 2]), np.array([0.25, 0.0, 0.1])).round(3)
        array([1.   , 1.25 , 1.671])
    """
    pose, motion = np.asarray(pose), np.asarray(motion)
    c, s = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    return np.stack(
        [
            pose[..., 0] + c * motion[..., 0] - s * motion[..., 1],
            pose[..., 1] + s * motion[..., 0] + c * motion[..., 1],
            pose[..., 2] + motion[..., 2],
        ],
        axis=-1,
    )


def between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the motion from pose ``a`` to pose ``b`` in the frame of ``a``, with its angle in [-pi, pi).

    Example:
        >>> between(np.array([1.0, 1.0, np.pi / 2]), np.array([1.0, 1.25, np.pi / 2 + 0.1])).round(3)
        array([0.25, 0.  , 0.1 ])
    """
    a, b = np.asarray(a), np.asarray(b)
    dx, dy, c, s = b[..., 0] - a[..., 0], b[..., 1] - a[..., 1], np.cos(a[..., 2]), np.sin(a[..., 2])
    turn = (b[..., 2] - a[..., 2] + np.pi) % (2 * np.pi) - np.pi
    return np.stack([c * dx + s * dy, c * dy - s * dx, turn], axis=-1)


def moved_covariance(pose: np.ndarray, covariance: np.ndarray, motion: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Propagate the (3, 3) world covariance of a pose through a noisy motion, to first order.

    Args:
        pose: (3,) x, y, heading before the motion.
        covariance: (3, 3) of this pose, world frame.
        motion: (3,) in the frame of the pose.
        noise: (3, 3) covariance of the motion, in the frame of the pose.

    Example:
        >>> after = moved_covariance(np.zeros(3), np.diag([0, 0, 0.01]), np.array([2.0, 0, 0]), np.zeros((3, 3)))
        >>> round(float(after[1, 1]), 6)  # (2 m * 0.1 rad) ** 2
        0.04
    """
    turn = np.eye(3)
    turn[:2, :2] = rotation(pose[2])
    step = turn[:2, :2] @ motion[:2]
    jacobian = np.eye(3)
    jacobian[:2, 2] = -step[1], step[0]
    return jacobian @ covariance @ jacobian.T + turn @ noise @ turn.T


def to_matrices(poses: np.ndarray, height: float = CAMERA_HEIGHT) -> np.ndarray:
    """Return (T, 4, 4) level camera-to-world poses of (T, 3) planar poses; ``height``: of the camera, metres."""
    matrices = np.zeros((len(poses), 4, 4))
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    matrices[:, 0, 0], matrices[:, 0, 2], matrices[:, 0, 3] = s, -c, poses[:, 0]
    matrices[:, 1, 0], matrices[:, 1, 2], matrices[:, 1, 3] = -c, -s, poses[:, 1]
    matrices[:, 2, 1], matrices[:, 2, 3], matrices[:, 3, 3] = 1, height, 1
    return matrices


def to_planar(c2w: np.ndarray) -> np.ndarray:
    """Return the (..., 3) planar poses of (..., 4, 4) camera-to-world poses.

    Example:
        >>> to_planar(to_matrices(np.array([[1.0, 2.0, 0.5]])))
        array([[1. , 2. , 0.5]])
    """
    return np.stack([c2w[..., 0, 3], c2w[..., 1, 3], np.arctan2(-c2w[..., 1, 2], -c2w[..., 0, 2])], axis=-1)
