"""Depth that a robot knows without a depth camera: it saw the floor where it drove, and nothing stands there.

A field trained on colours alone is poor on floors without texture: they bulge, or haze stands on them, and the planner
finds corridors blocked that the robot itself drove through. Where the whole path from the camera to a point of the
floor lies over the area that the body of the robot swept, the distance to this point follows from the pose alone.
"""

import numpy as np
from scipy import ndimage

from autonerf_lab.data.dataset import Dataset
from autonerf_lab.geometry import AGENT_RADIUS, is_planar

CELL = 0.05  # side of a cell of the swept area, metres
REACH = 6.0  # largest distance on the floor, metres
STEP = 0.5  # poses farther apart are not joined by a straight motion, metres


def drove_here(data: Dataset) -> bool:
    """Return True for the episode of a robot with a level camera that drove on the plane z = 0."""
    level = data.poses[0, 2, 1] > 1 - 1e-6 and not any(data.intrinsics[0].lens)
    return data.metric and bool(data.meta.get("actions")) and is_planar(data.poses) and level


def driven_floor_depth(data: Dataset) -> list[np.ndarray]:
    """Return (H, W) float32 depth of each image, metres: that of the floor the robot drove over, 0 elsewhere.

    Args:
        data: episode of a robot, see :func:`drove_here`; images of one camera.

    Example:
        >>> from autonerf_lab.data.trajectory import Trajectory
        >>> from autonerf_lab.geometry import Intrinsics, planar_pose
        >>> poses = np.stack([planar_pose(0.25 * t, 0, 0) for t in range(12)])
        >>> trajectory = Trajectory(poses, np.zeros((12, 16, 16, 3), np.uint8), None, None, Intrinsics.from_fov(16, 16))
        >>> depth = driven_floor_depth(Dataset.from_trajectory(trajectory))[0]
        >>> (100 * depth[10:, 8]).round().tolist()  # cm; the camera is 88 cm above the floor, row 10 looks 2.8 m ahead
        [0.0, 201.0, 156.0, 128.0, 108.0, 94.0]
    """
    swept, origin = _swept_area(data.poses[:, :2, 3])
    size, distances = np.array(swept.shape), np.arange(0, REACH, CELL)
    directions = data.intrinsics[0].directions()
    rays = directions @ data.poses[0, :3, :3].T  # (H, W, 3) of depth 1; those of other images are turned about z
    below = rays[..., 2] < -1e-3
    depth = np.where(below, data.poses[0, 2, 3] / np.where(below, -rays[..., 2], 1), 0)
    length = depth * np.hypot(rays[..., 0], rays[..., 1])  # on the floor
    columns = directions[len(directions) // 2]  # (W, 3); a level camera sees the floor of a column in one heading
    found = []
    for c2w in data.poses:
        heading = columns @ c2w[:2, :3].T
        heading = heading / np.linalg.norm(heading, axis=1, keepdims=True)
        cells = ((c2w[:2, 3] + distances[:, None, None] * heading - origin) / CELL).astype(np.int64)
        free = ((cells >= 0) & (cells < size)).all(axis=-1)
        cells = np.clip(cells, 0, size - 1)
        free &= swept[cells[..., 0], cells[..., 1]]
        reach = distances[np.logical_and.accumulate(free, axis=0).sum(axis=0) - 1]
        found.append(np.where(below & (length < reach), depth, 0).astype(np.float32))
    return found


def _swept_area(positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the (X, Y) cells that the robot's body covered on its path, and the (2,) corner of the first cell."""
    origin = positions.min(axis=0) - 2 * AGENT_RADIUS
    size = np.ceil((positions.max(axis=0) + 2 * AGENT_RADIUS - origin) / CELL).astype(np.int64)
    motion = np.diff(positions, axis=0)
    start, motion = positions[:-1], motion * (np.linalg.norm(motion, axis=1) < STEP)[:, None]
    places = np.concatenate([positions, *(start + share * motion for share in np.arange(0.1, 1, 0.1))])
    elsewhere = np.ones(size, bool)
    elsewhere[tuple(((places - origin) / CELL).astype(np.int64).T)] = False
    distance: np.ndarray = CELL * ndimage.distance_transform_edt(elsewhere)
    return distance <= AGENT_RADIUS - CELL / 2, origin
