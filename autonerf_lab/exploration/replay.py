"""A walk once more, from what it kept: the map that the robot had at some of its steps."""

import math
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

UNKNOWN, EXPLORED, FRONTIER, OCCUPIED = range(4)  # what a cell of a picture is; class k is OCCUPIED + k
PALETTE = np.concatenate(
    [
        [(0, 0, 0, 0), (248, 248, 244, 255), (160, 208, 240, 255), (84, 90, 98, 255)],
        np.insert(CLASS_COLORS[1:], 3, 255, 1),
    ]
).astype(np.uint8)  # (19, 4) RGBA
MAX_MAP = 1200  # cells a side
_MARGIN = 0.25  # metres around what is known
_LEVEL = 1e-6  # what the map accepts


@dataclass(frozen=True)
class Retraced:
    """What is drawn of a walk. K: the steps that are shown."""

    trajectory: Trajectory
    steps: np.ndarray  # (K,) int, rising
    planar: np.ndarray  # (T, 3) x, y, heading
    length: np.ndarray  # (T,) metres walked so far
    maps: (
        list[np.ndarray] | None
    )  # K of (rows, cols) uint8, see PALETTE, [row = y, column = x]; None: no depth was kept
    area: np.ndarray | None  # (K,) square metres explored
    corner: np.ndarray  # (2,) world x, y of the outer corner of cell [0, 0]
    waypoints: list[tuple[float, float] | None]  # K

    @property
    def name(self) -> str:
        """Who walked."""
        return str(self.trajectory.meta.get("policy", "walk"))

    def box(self) -> np.ndarray:
        """(2, 2) lower and upper corner of all that is known at the last of the steps, world x, y."""
        places = [self.planar[: self.steps[-1] + 1, :2]]
        if self.maps is not None:
            cells = np.argwhere(self.maps[-1] != UNKNOWN)[:, ::-1]
            places += [self.corner + MAP_CELL * cells, self.corner + MAP_CELL * (cells + 1)]
        every = np.concatenate(places)
        margin = _MARGIN if self.maps is not None else 1.0
        return np.stack([every.min(axis=0) - margin, every.max(axis=0) + margin])


def retrace(trajectory: Trajectory, steps: np.ndarray) -> Retraced:
    """Build the map of a walk again, and keep it at some steps.

    Args:
        trajectory: a walk of the robot. Without semantics its map has no classes, without depth it has no map.
        steps: (K,) rising; those after the walk's end show its end.

    Raises:
        WrongTypeError: not a trajectory.
        DataError: the poses are not those of a level camera at one height, or the walk is too wide for a map.

    Example:
        >>> from autonerf_lab.geometry import Intrinsics, planar_pose
        >>> depth = np.full((2, 9, 9), 2.01, np.float32)
        >>> poses = np.stack([planar_pose(0, 0, 0), planar_pose(0.25, 0, 0)])
        >>> walk = Trajectory(poses, np.zeros((2, 9, 9, 3), np.uint8), depth, None, Intrinsics.from_fov(9, 9))
        >>> seen = retrace(walk, np.array([0, 1]))
        >>> bool(seen.area[1] > seen.area[0]), seen.length.tolist()
        (True, [0.0, 0.25])
    """
    if isinstance(trajectory, Dataset):
        raise WrongTypeError("photographs are not a walk of the robot: play() wants a Trajectory")
    if not isinstance(trajectory, Trajectory):
        raise WrongTypeError(f"play() wants a Trajectory, not a {type(trajectory).__name__}")
    poses = trajectory.poses
    if not len(poses) or np.abs(poses[:, 2, 1] - 1).max() > _LEVEL or np.ptp(poses[:, 2, 3]) > 0.01:
        raise DataError("only a walk in a plane can be played: a level camera at one height, as the robot's is")
    steps = np.minimum(steps, len(trajectory) - 1)
    planar = np.array([planar_from_pose(pose) for pose in poses])
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(planar[:, :2], axis=0), axis=1))])
    maps, corner = _maps(trajectory, steps)
    area = None if maps is None else np.array([np.count_nonzero(m != UNKNOWN) for m in maps]) * MAP_CELL**2
    return Retraced(trajectory, steps, planar, length, maps, area, corner, _waypoints(trajectory, steps))


def _maps(trajectory: Trajectory, steps: np.ndarray) -> tuple[list[np.ndarray] | None, np.ndarray]:
    if trajectory.depth is None:
        return None, np.zeros(2)
    k = trajectory.intrinsics
    place = trajectory.poses[:, :2, 3]
    middle = place[0] + MAP_CELL * np.round((place.min(axis=0) + np.ptp(place, axis=0) / 2 - place[0]) / MAP_CELL)
    reach = FAR * math.hypot(1, max(k.cx, k.width - k.cx) / k.fl_x)
    size = 2 * math.ceil((np.ptp(place, axis=0).max() / 2 + reach) / MAP_CELL + 1)
    if size > MAX_MAP:
        raise DataError(
            f"the walk needs a map of {size * MAP_CELL:.0f} m a side; play() draws {MAX_MAP * MAP_CELL:.0f}"
        )
    pose = trajectory.poses[0].copy()
    pose[:2, 3] = middle  # on the grid of the robot's own map, which is centred on its start
    known = empty_map(pose, size, MAP_CELL)
    nothing = np.zeros(trajectory.depth.shape[1:], np.uint8)
    shown, drawn = set(steps.tolist()), {}
    for t in range(steps[-1] + 1):
        classes = nothing if trajectory.semantics is None else trajectory.semantics[t]
        seen = Observation(trajectory.rgb[t], trajectory.depth[t], classes, trajectory.poses[t])
        known = update(known, seen, k)
        if t in shown:
            drawn[t] = cells(known)
    rows, cols = (np.flatnonzero((drawn[steps[-1]] != UNKNOWN).any(axis=axis)) for axis in (1, 0))
    window = np.s_[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]  # a map only grows: the last holds all others
    corner = known.origin + MAP_CELL * np.array([cols[0], rows[0]])
    return [drawn[t][window] for t in steps.tolist()], corner


def cells(known: MapState) -> np.ndarray:
    """A map as a picture of indices into PALETTE.

    Of several classes in a cell the last is drawn: what stands on a table comes after the table.

    Returns:
        (M, M) uint8.
    """
    free = known.explored & ~known.occupied
    unseen = np.pad(~known.explored, 1)
    beside = unseen[2:, 1:-1] | unseen[:-2, 1:-1] | unseen[1:-1, 2:] | unseen[1:-1, :-2]
    picture = np.where(known.explored, np.uint8(EXPLORED), np.uint8(UNKNOWN))
    picture[free & beside] = FRONTIER
    picture[known.occupied] = OCCUPIED
    for label in range(1, NUM_CLASSES):
        picture[known.semantics[label - 1]] = OCCUPIED + label
    return picture


def _waypoints(trajectory: Trajectory, steps: np.ndarray) -> list[tuple[float, float] | None]:
    """Where the robot was heading, from ``meta``, which may come from a file by other hands."""
    kept = trajectory.meta.get("waypoints", [None] * len(trajectory))
    if not isinstance(kept, list) or len(kept) != len(trajectory) or not all(map(_is_place, kept)):
        raise DataError(f"'waypoints' must hold [x, y] or null for each of the {len(trajectory)} frames; leave it out")
    return [kept[t] and (float(kept[t][0]), float(kept[t][1])) for t in steps.tolist()]


def _is_place(value: Any) -> bool:
    if value is None:
        return True
    pair = isinstance(value, list) and len(value) == 2
    return pair and all(isinstance(v, int | float) and math.isfinite(v) for v in value)
