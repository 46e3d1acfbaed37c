"""Relative motions of the rough poses as priors, and the covariance that they leave to each pose.

A small motion of a camera is a 6-vector: a translation and a rotation vector about its centre, both along the axes of
the world. T: frames.
"""

import numpy as np
from scipy.spatial.transform import Rotation

FIRST_SIGMAS = (0.02, float(np.radians(0.5)))  # metres and radians a step, before they are estimated
LEAST_SIGMAS = (0.002, float(np.radians(0.05)))
_MEDIAN_NORM = {1: 0.6745, 2: 1.1774, 3: 1.5382}  # median length of a normal vector of so many components, unit sigma


def cross_matrix(vectors: np.ndarray) -> np.ndarray:
    """Return the (..., 3, 3) matrices whose product with x is the cross product v x x.

    Example:
        >>> cross_matrix(np.array([0.0, 0.0, 1.0])) @ [1.0, 0.0, 0.0]
        array([0., 1., 0.])
    """
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def motion_errors(poses: np.ndarray, rough: np.ndarray) -> np.ndarray:
    """Return the (T - 1, 6) differences of the motions between consecutive poses from those of the rough poses.

    Metres and radians, in the axes of the first (translation) and second (rotation) camera.
    """
    moved, wanted = relative(poses), relative(rough)
    turned = np.swapaxes(wanted[:, :3, :3], 1, 2) @ moved[:, :3, :3]
    return np.concatenate([moved[:, :3, 3] - wanted[:, :3, 3], Rotation.from_matrix(turned).as_rotvec()], axis=1)


def relative(poses: np.ndarray) -> np.ndarray:
    """Return the (T - 1, 4, 4) poses of the frames from the second on in the camera frames before them."""
    inverse = np.swapaxes(poses[:-1, :3, :3], 1, 2)
    motions = np.tile(np.eye(4), (len(poses) - 1, 1, 1))
    motions[:, :3, :3] = inverse @ poses[1:, :3, :3]
    motions[:, :3, 3] = np.einsum("tij,tj->ti", inverse, poses[1:, :3, 3] - poses[:-1, :3, 3])
    return motions


def estimate_sigmas(errors: np.ndarray, planar: bool) -> tuple[float, float]:
    """Return the standard deviations of motion errors, metres and radians, from their medians.

    Args:
        errors: of :func:`motion_errors`.
        planar: translations have two components that vary, and rotations one.

    Example:
        >>> errors = np.random.default_rng(0).normal(size=(2000, 6)) * [0.01, 0.01, 0.01, 0.02, 0.02, 0.02]
        >>> [round(sigma, 2) for sigma in estimate_sigmas(errors, planar=False)]
        [0.01, 0.02]
    """
    lengths = (np.median(np.linalg.norm(part, axis=1)) for part in (errors[:, :3], errors[:, 3:]))
    counts = (2, 1) if planar else (3, 3)
    found = [length / _MEDIAN_NORM[n] for length, n in zip(lengths, counts, strict=True)]
    return max(float(found[0]), LEAST_SIGMAS[0]), max(float(found[1]), LEAST_SIGMAS[1])


def motion_equations(
    poses: np.ndarray, rough: np.ndarray, sigmas: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the normal equations of the motion errors.

    Args:
        poses: (T, 4, 4), where the errors are linearised.
        rough: (T, 4, 4), whose motions are the prior.
        sigmas: standard deviations of a motion, metres and radians.

    Returns:
        (T - 1, 12, 12) J^T W J and (T - 1, 12) J^T W r of the small motions of both frames of a step.
    """
    into_first, into_second = (np.swapaxes(part[:, :3, :3], 1, 2) for part in (poses[:-1], poses[1:]))
    jacobian = np.zeros((len(poses) - 1, 6, 12))
    jacobian[:, :3, 0:3], jacobian[:, :3, 6:9] = -into_first, into_first
    # Turning the first camera by omega moves the second one in its frame by R^T (moved x omega).
    jacobian[:, :3, 3:6] = into_first @ cross_matrix(poses[1:, :3, 3] - poses[:-1, :3, 3])
    jacobian[:, 3:, 3:6], jacobian[:, 3:, 9:12] = -into_second, into_second
    weighted = jacobian / np.square(np.repeat(sigmas, 3))[:, None]
    errors = motion_errors(poses, rough)
    return np.swapaxes(jacobian, 1, 2) @ weighted, np.einsum("tka,tk->ta", weighted, errors)


def chain_covariances(own: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Return the covariance of each pose of a chain, given a fixed map.

    The information matrix of the chain is block-tridiagonal: each frame is tied to the map and to its neighbours. The
    diagonal blocks of its inverse follow from one elimination forwards and one backwards.

    Args:
        own: (T, k, k) information of each frame about its own pose.
        steps: (T - 1, 2 k, 2 k) information of each step about the poses of its two frames.

    Returns:
        (T, k, k).

    Example:
        >>> step = np.array([[1.0, -1.0], [-1.0, 1.0]])  # of variance 1
        >>> own = np.array([[[1e6]], [[0.0]], [[0.0]]])  # only the first pose is known
        >>> chain_covariances(own, np.stack([step, step]))[:, 0, 0].round(3)
        array([0., 1., 2.])
    """
    k = own.shape[1]
    full = own.copy()
    full[:-1] += steps[:, :k, :k]
    full[1:] += steps[:, k:, k:]
    full += 1e-9 * np.eye(k)  # a pose about which nothing is known has a large variance, not an infinite one
    couplings = steps[:, :k, k:]
    forward, backward = full.copy(), full.copy()
    for t, coupling in enumerate(couplings):
        forward[t + 1] -= coupling.T @ np.linalg.solve(forward[t], coupling)
    for t in range(len(couplings) - 1, -1, -1):
        backward[t] -= couplings[t] @ np.linalg.solve(backward[t + 1], couplings[t].T)
    found = np.linalg.inv(forward + backward - full)
    return (found + np.swapaxes(found, 1, 2)) / 2
