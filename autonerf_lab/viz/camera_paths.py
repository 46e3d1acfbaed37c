"""Ways for a camera that flies through a field."""

from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation, Slerp

from autonerf_lab.errors import DataError
from autonerf_lab.geometry import FORWARD_STEP, TURN_ANGLE

if TYPE_CHECKING:
    from autonerf_lab.evaluators.radiance_field import Field

FRAMES_PER_STEP = 6  # of a walk: at 24 frames a second a robot that goes straight on moves at walking pace, 1 m/s
KEY_STEPS = 4  # poses of a walk from one key pose to the next


def camera_path(poses: np.ndarray, frames: int, unit: float = 1.0) -> np.ndarray:
    """A smooth way through key poses.

    Positions follow a monotone cubic spline (PCHIP) in each coordinate: between two keys the camera stays in the box
    that they span, so that it does not swing out into a wall. Rotations turn evenly from key to key (Slerp). The camera
    takes as long for 25 cm as for a turn of 30 degrees, as the robot does.

    Args:
        poses: (K, 4, 4) camera-to-world, any frame.
        frames: how many poses to return; the first and the last are those of the keys.
        unit: what counts as a metre, in the units of the poses.

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
        raise DataError(f"a camera path of {frames} frames goes nowhere; ask for two or more")
    poses = np.asarray(poses, dtype=np.float64)
    turns = Rotation.from_matrix(poses[:, :3, :3])
    moved = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1) / (unit * FORWARD_STEP)
    lasts = moved + (turns[:-1].inv() * turns[1:]).magnitude() / TURN_ANGLE
    different = np.concatenate([[True], lasts > 1e-6])  # a robot that bumps into something stays where it is
    if different.sum() < 2:
        raise DataError("a camera path needs at least two different poses")
    times = np.concatenate([[0.0], np.cumsum(lasts)])[different]
    shown = np.linspace(0, times[-1], frames)
    path = np.tile(np.eye(4), (frames, 1, 1))
    path[:, :3, :3] = Slerp(times, turns[different])(shown).as_matrix()
    path[:, :3, 3] = PchipInterpolator(times, poses[different, :3, 3])(shown)
    return path


def walk_path(field: "Field", frames: int) -> np.ndarray:
    """The way of the robot, smoothed: through every fourth training camera, which cuts corners by centimetres.

    Of photographs it is the way in their order.

    Where the walk is too long for the frames, the stretch of it that covers the most ground is taken.

    Args:
        field: its training cameras are those of a walk, in order.
        frames: how many poses to return. Six show one step of the robot.

    Returns:
        (frames, 4, 4) float64 camera-to-world, world frame.

    Raises:
        DataError: as :func:`camera_path`.
    """
    steps = max(KEY_STEPS, frames // FRAMES_PER_STEP)
    way = np.linalg.norm(np.diff(field.cameras[:, :3, 3], axis=0), axis=1)
    so_far = np.concatenate([[0.0], np.cumsum(way)])
    first = int(np.argmax(so_far[steps:] - so_far[:-steps])) if steps < len(so_far) else 0
    last = min(first + steps, len(so_far) - 1)
    return camera_path(field.cameras[[*range(first, last, KEY_STEPS), last]], frames, field.frame.unit)
