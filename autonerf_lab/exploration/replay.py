"""Replay of a trajectory: the robot's map at some of its steps, rebuilt from the recorded observations."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from autonerf_lab.classes import CLASS_COLORS, NUM_CLASSES
from autonerf_lab.data.dataset import Dataset
from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.errors import DataError, WrongTypeError
from autonerf_lab.geometry import planar_from_pose
from autonerf_lab.mapping import empty_map, update
from autonerf_lab.mapping.semantic_map import FAR, MAP_CELL
from autonerf_lab.types import MapState, Observation

UNKNOWN, EXPLORED, FRONTIER, OCCUPIED = range(4)  # indices of a map image; class k is OCCUPIED + k
PALETTE = np.concatenate(
    [
        [(0, 0, 0, 0), (248, 248, 244, 255), (160, 208, 240, 255), (84, 90, 98, 255)],
        np.insert(CLASS_COLORS[1:], 3, 255, 1),
    ]
).astype(np.uint8)  # (19, 4) RGBA
MAX_MAP = 1200  # cells a side
_MARGIN = 0.25  # metres around the explored area
_LEVEL = 1e-6  # tolerance of a level camera, as in the map


@dataclass(frozen=True)
class Replay:
    """Trajectory with its map and waypoints at K steps."""

    trajectory: Trajectory
    steps: np.ndarray  # (K,) int, increasing
    planar: np.ndarray  # (T, 3) x, y in metres, heading in radians
    length: np.ndarray  # (T,) path length so far, metres
    maps: list[np.ndarray] | None  # K map images, (rows, cols) uint8, [row = y, column = x]; None without depth
    area: np.ndarray | None  # (K,) explored area, m²; None without depth
    corner: np.ndarray  # (2,) world x, y of the outer corner of cell [0, 0], metres
    waypoints: list[tuple[float, float] | None]  # K waypoints, world x, y, metres

    @property
    def name(self) -> str:
        """Name of the policy."""
        return str(self.trajectory.meta.get("policy", "trajectory"))

    def bounds(self) -> np.ndarray:
        """Return the bounds of the path and the explored area at the last step, (2, 2) world x, y of both corners."""
        points = [self.planar[: self.steps[-1] + 1, :2]]
        if self.maps is not None:
            cells = np.argwhere(self.maps[-1] != UNKNOWN)[:, ::-1]
            points += [self.corner + MAP_CELL * cells, self.corner + MAP_CELL * (cells + 1)]
        stacked = np.concatenate(points)
        margin = _MARGIN if self.maps is not None else 1.0
        return np.stack([stacked.min(axis=0) - margin, stacked.max(axis=0) + margin])


def union_box(replays: Sequence[Replay]) -> np.ndarray:
    """Return the smallest box around all known areas: (2, 2), lower and upper corner, world x, y in metres."""
    boxes = np.stack([replay.bounds() for replay in replays])
    return np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])


def replay_map(trajectory: Trajectory, steps: np.ndarray) -> Replay:
    """Rebuild the map of a trajectory and return it at some steps.

    Args:
        trajectory: trajectory; without semantics its map has no classes, without depth there is no map.
        steps: (K,) increasing; steps after the end are replaced by the last step.

    Raises:
        WrongTypeError: not a trajectory.
        DataError: the poses are not those of a level camera at constant height, or the map would be too large.

    Example:
        >>> from autonerf_lab.geometry import Intrinsics, planar_pose
        >>> rgb, depth = np.zeros((2, 9, 9, 3), np.uint8), np.full((2, 9, 9), 2.01, np.float32)
        >>> poses = np.stack([planar_pose(0, 0, 0), planar_pose(0.25, 0, 0)])
        >>> trajectory = Trajectory(poses, rgb, depth, None, Intrinsics.from_fov(9, 9))
        >>> replay = replay_map(trajectory, np.array([0, 1]))
        >>> bool(replay.area[1] > replay.area[0]), replay.length.tolist()
        (True, [0.0, 0.25])
    """
    if isinstance(trajectory, Dataset):
        raise WrongTypeError("play() requires a Trajectory of the robot, not a Dataset of photographs")
    if not isinstance(trajectory, Trajectory):
        raise WrongTypeError(f"play() requires a Trajectory, not a {type(trajectory).__name__}")
    poses = trajectory.poses
    if not len(poses) or np.abs(poses[:, 2, 1] - 1).max() > _LEVEL or np.ptp(poses[:, 2, 3]) > 0.01:
        raise DataError("play() requires a trajectory in a plane: a level camera at constant height, like the robot's")
    steps = np.minimum(steps, len(trajectory) - 1)
    planar = np.array([planar_from_pose(pose) for pose in poses])
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(planar[:, :2], axis=0), axis=1))])
    maps, corner = _maps(trajectory, steps)
    area = None if maps is None else np.array([np.count_nonzero(m != UNKNOWN) for m in maps]) * MAP_CELL**2
    return Replay(trajectory, steps, planar, length, maps, area, corner, _waypoints(trajectory, steps))


def _maps(trajectory: Trajectory, steps: np.ndarray) -> tuple[list[np.ndarray] | None, np.ndarray]:
    if trajectory.depth is None:
        return None, np.zeros(2)
    k = trajectory.intrinsics
    xy = trajectory.poses[:, :2, 3]
    centre = xy[0] + MAP_CELL * np.round((xy.min(axis=0) + np.ptp(xy, axis=0) / 2 - xy[0]) / MAP_CELL)
    reach = FAR * math.hypot(1, max(k.cx, k.width - k.cx) / k.fl_x)
    size = 2 * math.ceil((np.ptp(xy, axis=0).max() / 2 + reach) / MAP_CELL + 1)
    if size > MAX_MAP:
        raise DataError(
            f"the trajectory needs a map of {size * MAP_CELL:.0f} m a side; play() supports up to "
            f"{MAX_MAP * MAP_CELL:.0f} m"
        )
    pose = trajectory.poses[0].copy()
    pose[:2, 3] = centre  # on the grid of the robot's own map, which is centred on its start
    map = empty_map(pose, size, MAP_CELL)
    no_classes = np.zeros(trajectory.depth.shape[1:], np.uint8)
    wanted, images = set(steps.tolist()), {}
    for t in range(steps[-1] + 1):
        classes = no_classes if trajectory.semantics is None else trajectory.semantics[t]
        observation = Observation(trajectory.rgb[t], trajectory.depth[t], classes, trajectory.poses[t])
        map = update(map, observation, k)
        if t in wanted:
            images[t] = map_image(map)
    rows, cols = (np.flatnonzero((images[steps[-1]] != UNKNOWN).any(axis=axis)) for axis in (1, 0))
    window = np.s_[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]  # the explored area only grows
    corner = map.origin + MAP_CELL * np.array([cols[0], rows[0]])
    return [images[t][window] for t in steps.tolist()], corner


def map_image(map: MapState) -> np.ndarray:
    """Convert a map to an image of indices into :data:`PALETTE`.

    A cell with several classes shows the last one, because classes of objects on tables come after the table.

    Returns:
        (M, M) uint8.
    """
    free = map.explored & ~map.occupied
    unknown = np.pad(~map.explored, 1)
    beside = unknown[2:, 1:-1] | unknown[:-2, 1:-1] | unknown[1:-1, 2:] | unknown[1:-1, :-2]
    image = np.where(map.explored, np.uint8(EXPLORED), np.uint8(UNKNOWN))
    image[free & beside] = FRONTIER
    image[map.occupied] = OCCUPIED
    for label in range(1, NUM_CLASSES):
        image[map.semantics[label - 1]] = OCCUPIED + label
    return image


def _waypoints(trajectory: Trajectory, steps: np.ndarray) -> list[tuple[float, float] | None]:
    """Return the waypoints in ``meta``, checked, because ``meta`` may come from any file."""
    waypoints = trajectory.meta.get("waypoints", [None] * len(trajectory))
    if not isinstance(waypoints, list) or len(waypoints) != len(trajectory) or not all(map(_is_waypoint, waypoints)):
        raise DataError(
            f"'waypoints' must hold [x, y] or null for each of the {len(trajectory)} frames; correct or remove it"
        )
    return [waypoints[t] and (float(waypoints[t][0]), float(waypoints[t][1])) for t in steps.tolist()]


def _is_waypoint(value: Any) -> bool:
    if value is None:
        return True
    pair = isinstance(value, list) and len(value) == 2
    return pair and all(isinstance(v, int | float) and math.isfinite(v) for v in value)
