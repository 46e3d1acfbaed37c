"""Alignment of trajectories in SE(2), and their errors (Sturm et al. 2012; Zhang and Scaramuzza 2018).

Estimated poses are in a frame of their own: it agrees with the true one at the start, and drifts away from it. Before
errors are computed, or a field that was trained on these poses is scored, the estimated frame is moved by the planar
rigid motion that brings the positions closest to the true ones. Nothing else is corrected.
"""

from dataclasses import dataclass

import numpy as np

from autonerf_lab.localization.se2 import between, compose, rotation


def align(estimated: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Return the planar motion (3,) x, y, heading that moves estimated poses onto the true ones.

    It minimises the squared distances of the positions (Horn 1987). Without two different positions, the mean of the
    heading errors sets the rotation.

    Args:
        estimated: (T, 3) x, y, heading.
        true: (T, 3) x, y, heading.

    Example:
        >>> true = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 1.5]])
        >>> drifted = compose(np.array([2.0, 0.0, 0.5]), true)
        >>> compose(align(drifted, true), drifted).round(6) + 0
        array([[0. , 0. , 0. ],
               [1. , 0. , 0. ],
               [1. , 1. , 1.5]])
    """
    a, b = estimated[:, :2] - estimated[:, :2].mean(axis=0), true[:, :2] - true[:, :2].mean(axis=0)
    along, across = (a * b).sum(), (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()
    if np.hypot(along, across) < 1e-12:
        turns = true[:, 2] - estimated[:, 2]
        along, across = np.cos(turns).sum(), np.sin(turns).sum()
    heading = float(np.arctan2(across, along))
    shift = true[:, :2].mean(axis=0) - rotation(heading) @ estimated[:, :2].mean(axis=0)
    return np.array([*shift, heading])


def transformed(c2w: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """Return (..., 4, 4) camera-to-world poses after a planar motion (3,) of their frame."""
    return motion_matrix(motion) @ c2w


def motion_matrix(motion: np.ndarray) -> np.ndarray:
    """Return the (4, 4) matrix of a planar motion (3,): x, y and a rotation about the vertical axis."""
    matrix = np.eye(4)
    matrix[:2, :2], matrix[:2, 3] = rotation(motion[2]), motion[:2]
    return matrix


@dataclass(frozen=True)
class TrajectoryErrors:
    """Errors of an estimated trajectory."""

    ate_m: float  # root mean square of the distances of the positions after alignment
    ate_unaligned_m: float  # without alignment
    heading_error_deg: float  # root mean square after alignment
    error_per_metre: float  # mean distance between the end points of 1 m of the path, m/m
    error_per_degree: float  # mean heading error over 90 degrees of turning, deg/deg
    distances: np.ndarray  # (T,) metres, after alignment
    headings: np.ndarray  # (T,) degrees in [-180, 180), after alignment
    aligned: np.ndarray  # (T, 3) estimated poses after alignment


SEGMENT, TURN = 1.0, float(np.pi / 2)  # metres and radians over which relative errors are measured


def trajectory_errors(estimated: np.ndarray, true: np.ndarray) -> TrajectoryErrors:
    """Compare an estimated trajectory with the true one.

    Relative errors compare the motion over a part of the trajectory, 1 m of path or 90 degrees of turning, and do not
    depend on the alignment; they are NaN for a shorter trajectory.

    Args:
        estimated: (T, 3) x, y, heading.
        true: (T, 3) x, y, heading.

    Example:
        >>> true = np.stack([np.arange(5) / 2, np.zeros(5), np.zeros(5)], axis=1)
        >>> errors = trajectory_errors(true * [1.02, 1, 1], true)
        >>> round(errors.error_per_metre, 6), round(errors.ate_unaligned_m, 4), errors.error_per_degree
        (0.02, 0.0245, nan)
    """
    aligned = compose(align(estimated, true), estimated)
    distances = np.linalg.norm(aligned[:, :2] - true[:, :2], axis=1)
    headings = np.degrees(between(true, aligned)[:, 2])
    path = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(true[:, :2], axis=0), axis=1))])
    turned = np.concatenate([[0], np.cumsum(np.abs(between(true[:-1], true[1:])[:, 2]))])
    moved, rotated = _relative(estimated, true, path, SEGMENT), _relative(estimated, true, turned, TURN)
    return TrajectoryErrors(
        _rms(distances),
        _rms(np.linalg.norm(estimated[:, :2] - true[:, :2], axis=1)),
        _rms(headings),
        float(np.linalg.norm(moved[:, :2], axis=1).mean() / SEGMENT) if len(moved) else float("nan"),
        float(np.abs(rotated[:, 2]).mean() / TURN) if len(rotated) else float("nan"),
        distances,
        headings,
        aligned,
    )


def _relative(estimated: np.ndarray, true: np.ndarray, done: np.ndarray, length: float) -> np.ndarray:
    """Return the errors (N, 3) of the motions over parts of a given length; ``done`` (T,) is the length so far."""
    ends = np.searchsorted(done, done + length - 1e-9)
    first = np.flatnonzero(ends < len(done))
    last = ends[first]
    return between(between(true[first], true[last]), between(estimated[first], estimated[last]))


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
