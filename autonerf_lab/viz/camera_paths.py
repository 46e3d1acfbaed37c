"""Smooth camera paths for videos of a radiance field."""

from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation, Slerp

from autonerf_lab.errors import DataError
from autonerf_lab.geometry import FORWARD_STEP, TURN_ANGLE

if TYPE_CHECKING:
    from autonerf_lab.evaluators.radiance_field import RadianceField

FRAMES_PER_STEP = 6  # at 24 frames per second, steps of 0.25 m give a camera speed of 1 m/s
KEY_STEPS = 4  # training poses from one key pose to the next


def camera_path(poses: np.ndarray, frames: int, unit: float = 1.0) -> np.ndarray:
    """Return a smooth camera path through key poses.

    Positions follow a monotone cubic spline (PCHIP) in each coordinate: between two keys the camera stays inside
    their bounding box and cannot swing into a wall. Rotations are interpolated at constant angular speed (Slerp).
    Moving 25 cm takes as long as rotating 30 degrees, as for the robot.

    Args:
        poses: (K, 4, 4) camera-to-world, any frame.
        frames: number of poses to return; the first and the last are the first and last key poses.
        unit: length of a metre in the units of the poses.

    Returns:
        (frames, 4, 4) float64, in the frame of ``poses``.

    Raises:
        DataError: fewer than two different poses, or fewer than two frames.

    Example:
        >>> from autonerf_lab.geometry import planar_pose
        >>> camera_path(np.stack([planar_pose(0, 0, 0), planar_pose(1, 0, 0)]), 5)[:, 0, 3]
        array([0.  , 0.25, 0.5 , 0.75, 1.  ])
    """
    if frames < 2:
        raise DataError(f"a camera path needs two or more frames, not {frames}")
    poses = np.asarray(poses, dtype=np.float64)
    rotations = Rotation.from_matrix(poses[:, :3, :3])
    moved = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1) / (unit * FORWARD_STEP)
    durations = moved + (rotations[:-1].inv() * rotations[1:]).magnitude() / TURN_ANGLE  # robot steps
    different = np.concatenate([[True], durations > 1e-6])  # a collision repeats the pose
    if different.sum() < 2:
        raise DataError("a camera path needs at least two different poses")
    times = np.concatenate([[0.0], np.cumsum(durations)])[different]
    frame_times = np.linspace(0, times[-1], frames)
    path = np.tile(np.eye(4), (frames, 1, 1))
    path[:, :3, :3] = Slerp(times, rotations[different])(frame_times).as_matrix()
    path[:, :3, 3] = PchipInterpolator(times, poses[different, :3, 3])(frame_times)
    return path


def trajectory_path(field: "RadianceField", frames: int) -> np.ndarray:
    """Return a smooth path along the training cameras: through every fourth one, which cuts corners by centimetres.

    Training cameras are taken in order: the trajectory of the robot, or the order of the photographs. If the trajectory
    is too long for the number of frames, the part with the longest path is used.

    Args:
        field: a trained radiance field.
        frames: number of poses to return; six show one step of the robot.

    Returns:
        (frames, 4, 4) float64 camera-to-world, world frame.

    Raises:
        DataError: see :func:`camera_path`.
    """
    steps = max(KEY_STEPS, frames // FRAMES_PER_STEP)
    distances = np.linalg.norm(np.diff(field.poses[:, :3, 3], axis=0), axis=1)
    path_length = np.concatenate([[0.0], np.cumsum(distances)])
    first = int(np.argmax(path_length[steps:] - path_length[:-steps])) if steps < len(path_length) else 0
    last = min(first + steps, len(path_length) - 1)
    return camera_path(field.poses[[*range(first, last, KEY_STEPS), last]], frames, field.frame.unit)
