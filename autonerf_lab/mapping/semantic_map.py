"""Top-down semantic map of section 3.1, built from depth, class images and odometry.

* Depths from 0.5 to 5 m are used; other depths are ignored.
* occupied, semantics: cells of points between 25 cm above the floor and 1 cm above the camera.
* explored: cells of points at any height, and cells under the rays that do not rise above the camera, up to their first
  surface. (Points alone would leave stripes: at 5 m, neighbouring pixel rows hit the floor half a metre apart.)
* visited: cells that the robot's body has covered; they are explored too.
* viewpoints: for every cell seen in an image, the direction from the cell to the camera, in 12 bins counter-clockwise
  from world +x.

Cells are never cleared, so a reward that counts new cells is never negative.

The robot's own map grows by the same number of cells on every side, so that its middle stays at the start.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from numba import njit

from autonerf_lab.classes import NUM_CLASSES
from autonerf_lab.errors import SceneError
from autonerf_lab.geometry import AGENT_RADIUS, Intrinsics
from autonerf_lab.types import MapState, Observation, read_only

MAP_SIZE = 480  # cells
MAP_CELL = 0.05  # metres
NEAR, FAR = 0.5, 5.0  # metres, range of the depth sensor
OBSTACLE_MIN = 0.25  # metres above the floor
OBSTACLE_OVER_CAMERA = 0.01  # metres above the camera
VIEWPOINT_BINS = 12
GROWTH = 160  # cells by which a map grows on every side; a multiple of the factors by which policies pool it
BEYOND = 1.5  # metres; a map grows for points farther outside. 1.5 m keep the map of every frozen apartment as it was
EDGE = 1.0  # metres; a map grows if the robot is nearer to its border, outside of which it could not plan
LIMIT = 8000  # cells a side, 400 m: up to here maps grow
_CHANNELS = ("occupied", "explored", "visited", "semantics", "viewpoints")


def empty_map(pose: np.ndarray, size: int = MAP_SIZE, cell: float = MAP_CELL) -> MapState:
    """Make an empty map, centred on the start pose.

    Args:
        pose: (4, 4) camera-to-world at the start.
        size: M, cells a side.
        cell: side of a cell, metres.

    Example:
        >>> from autonerf_lab.geometry import planar_pose
        >>> empty_map(planar_pose(1.0, 2.0, 0.0), size=100).origin
        array([-1.5, -0.5])
    """

    def blank(*channels: int) -> np.ndarray:
        return np.zeros((*channels, size, size), np.bool_)

    pose = np.array(pose, dtype=np.float64)
    origin = pose[:2, 3] - size * cell / 2
    return MapState(blank(), blank(), blank(), blank(NUM_CLASSES - 1), blank(VIEWPOINT_BINS), pose, origin, float(cell))


def update(map: MapState, observation: Observation, intrinsics: Intrinsics) -> MapState:
    """Return the map with one more observation; the given map is unchanged.

    Args:
        map: previous map.
        observation: observation of a level camera (horizontal image rows).
        intrinsics: intrinsics of this camera.

    Raises:
        ValueError: the camera is tilted, or the images have another size than the camera.

    Example:
        >>> from autonerf_lab.geometry import planar_pose
        >>> depth, labels = np.full((9, 9), 2.01, np.float32), np.zeros((9, 9), np.uint8)
        >>> observation = Observation(np.zeros((9, 9, 3), np.uint8), depth, labels, planar_pose(0, 0, 0))
        >>> after = update(empty_map(observation.pose), observation, Intrinsics.from_fov(9, 9))
        >>> bool(after.occupied[240, 280]), bool(after.explored[240, 250]), bool(after.explored[240, 230])
        (True, True, False)
    """
    after = replace(_copied(map), pose=np.array(observation.pose, dtype=np.float64))
    _write(after, observation, intrinsics)
    return after


class Mapper:
    """Mapper that updates in place, faster than :func:`update`, for training.

    Two buffers alternate. Before an update, the older buffer gets the part of the map that the last update changed.

    Args:
        start: map to which the first observation is added; it is not modified.
        intrinsics: intrinsics of the camera.
        grows: enlarge the map (:func:`enlarged`) when the robot or what it sees leaves it, up to 400 m a side; without,
            points outside are ignored.

    Example:
        >>> from autonerf_lab.geometry import planar_pose
        >>> depth, labels = np.full((9, 9), 2.01, np.float32), np.zeros((9, 9), np.uint8)
        >>> observation = Observation(np.zeros((9, 9, 3), np.uint8), depth, labels, planar_pose(0, 0, 0))
        >>> mapper = Mapper(empty_map(observation.pose), Intrinsics.from_fov(9, 9))
        >>> before, after = mapper.add(observation)
        >>> bool(before.explored.any()), bool(after.explored.any())
        (False, True)
    """

    def __init__(self, start: MapState, intrinsics: Intrinsics, grows: bool = False) -> None:
        self._intrinsics = intrinsics
        self._grows = grows
        self._buffers = [_copied(start), _copied(start)]
        self._touched = np.zeros(4, int)  # rows and columns that the last update may have changed
        self.map = read_only(self._buffers[0])

    def add(self, observation: Observation) -> tuple[MapState, MapState]:
        """Return the map before and after one more observation, read-only.

        Buffers are reused after two calls; copy to keep.

        Raises:
            SceneError: the map would exceed 400 m a side.
        """
        while self._grows and _leaves(self.map, observation, self._intrinsics):
            if len(self.map.explored) + 2 * GROWTH > LIMIT:
                raise SceneError(
                    f"the robot's map would exceed {LIMIT * self.map.cell:.0f} m a side; check the scale of the scene"
                )
            self._buffers = [enlarged(buffer, GROWTH) for buffer in self._buffers]
            self._touched = self._touched + GROWTH
            self.map = read_only(self._buffers[0])
        before, stale = self._buffers
        top, bottom, left, right = self._touched
        for name in _CHANNELS:
            getattr(stale, name)[..., top:bottom, left:right] = getattr(before, name)[..., top:bottom, left:right]
        after = replace(stale, pose=np.array(observation.pose, dtype=np.float64))
        self._touched = _write(after, observation, self._intrinsics)
        self._buffers = [after, before]
        seen_before, self.map = self.map, read_only(after)
        return seen_before, self.map


def enlarged(map: MapState, cells: int) -> MapState:
    """Return a copy of a map with more cells on every side.

    Example:
        >>> from autonerf_lab.geometry import planar_pose
        >>> larger = enlarged(empty_map(planar_pose(0, 0, 0), size=100), 10)
        >>> larger.explored.shape, larger.origin
        ((120, 120), array([-3., -3.]))
    """

    def padded(array: np.ndarray) -> np.ndarray:
        return np.pad(array, [(0, 0)] * (array.ndim - 2) + [(cells, cells)] * 2)

    channels: dict[str, Any] = {name: padded(getattr(map, name)) for name in _CHANNELS}
    return replace(map, origin=map.origin - cells * map.cell, **channels)


def _leaves(map: MapState, observation: Observation, intrinsics: Intrinsics) -> bool:
    """Return True if the robot is at the border of the map, or sees points more than ``BEYOND`` outside."""
    half = len(map.explored) * map.cell / 2
    pose = observation.pose
    offset = pose[:2, 3] - map.origin - half
    away = float(np.abs(offset).max())
    if away > half - EDGE:
        return True
    depth = observation.depth
    if away < half + BEYOND - FAR * np.hypot(1, max(intrinsics.cx, intrinsics.width - intrinsics.cx) / intrinsics.fl_x):
        return False
    used = (depth >= NEAR) & (depth <= FAR)
    across = depth * ((np.arange(depth.shape[1]) + 0.5 - intrinsics.cx) / intrinsics.fl_x)
    points = offset[:, None] - depth[used] * pose[:2, 2:3] + across[used] * pose[:2, 0:1]
    return bool((np.abs(points) > half + BEYOND).any())


def _copied(map: MapState) -> MapState:
    return replace(map, **{name: getattr(map, name).copy() for name in _CHANNELS})


def _write(map: MapState, observation: Observation, intrinsics: Intrinsics) -> np.ndarray:
    """Add an observation to the arrays of a map with its pose; return the rows and columns that may have changed."""
    shape = (intrinsics.height, intrinsics.width)
    if observation.depth.shape != shape or observation.semantics.shape != shape:
        raise ValueError(f"images of {observation.depth.shape} pixels do not match the intrinsics of {shape} pixels")
    if abs(map.pose[2, 1] - 1) > 1e-6:
        raise ValueError("the map requires a level camera: the y axis of the pose must point up")
    camera = np.array([intrinsics.fl_x, intrinsics.fl_y, intrinsics.cx, intrinsics.cy])
    box = np.empty(4, np.int64)
    _update(
        observation.depth,
        observation.semantics,
        map.pose,
        camera,
        map.origin,
        map.cell,
        box,
        map.occupied,
        map.explored,
        map.visited,
        map.semantics,
        map.viewpoints,
    )
    return box


@njit(cache=True)
def _write_box(
    pose: np.ndarray, camera: np.ndarray, width: int, origin: np.ndarray, cell: float, size: int, box: np.ndarray
) -> None:
    """Write the rows and columns of the robot's disc and its field of view up to the sensor range."""
    for axis in range(2):  # x and columns, y and rows
        ahead, right = -FAR * pose[axis, 2], FAR / camera[0] * pose[axis, 0]
        left_end, right_end = ahead - camera[2] * right, ahead + (width - camera[2]) * right
        low = pose[axis, 3] + min(-AGENT_RADIUS, left_end, right_end) - origin[axis]
        high = pose[axis, 3] + max(AGENT_RADIUS, left_end, right_end) - origin[axis]
        box[2 - 2 * axis] = min(max(int(np.floor(low / cell)), 0), size)
        box[3 - 2 * axis] = min(max(int(np.floor(high / cell)) + 1, 0), size)


@njit(cache=True)
def _update(
    depth: np.ndarray,
    semantics: np.ndarray,
    pose: np.ndarray,
    camera: np.ndarray,
    origin: np.ndarray,
    cell: float,
    box: np.ndarray,
    occupied: np.ndarray,
    explored: np.ndarray,
    visited: np.ndarray,
    classes: np.ndarray,
    viewpoints: np.ndarray,
) -> None:
    size = explored.shape[0]
    height, width = depth.shape
    fl_x, fl_y, cx, cy = camera[0], camera[1], camera[2], camera[3]
    x0, y0, z0 = pose[0, 3], pose[1, 3], pose[2, 3]
    ahead_x, ahead_y = -pose[0, 2], -pose[1, 2]
    right_x, right_y = pose[0, 0], pose[1, 0]
    _write_box(pose, camera, width, origin, cell, size, box)
    seen = np.zeros((box[1] - box[0], box[3] - box[2]), np.bool_)
    reach = np.zeros(width)  # per image column: largest depth of a ray that does not rise
    for v in range(height):
        up = -(v + 0.5 - cy) / fl_y
        for u in range(width):
            d = depth[v, u]
            if d < NEAR:
                continue
            if up <= 0:
                reach[u] = max(reach[u], min(d, FAR))
            if d > FAR:
                continue
            across = d * (u + 0.5 - cx) / fl_x
            col = int(np.floor((x0 + d * ahead_x + across * right_x - origin[0]) / cell))
            row = int(np.floor((y0 + d * ahead_y + across * right_y - origin[1]) / cell))
            if row < 0 or col < 0 or row >= size or col >= size:
                continue
            if box[0] <= row < box[1] and box[2] <= col < box[3]:
                seen[row - box[0], col - box[2]] = True
            z = z0 + d * up
            if OBSTACLE_MIN <= z <= z0 + OBSTACLE_OVER_CAMERA:
                occupied[row, col] = True
                label = semantics[v, u]
                if label > 0:
                    classes[label - 1, row, col] = True
    for row in range(box[0], box[1]):
        dy = origin[1] + (row + 0.5) * cell - y0
        for col in range(box[2], box[3]):
            dx = origin[0] + (col + 0.5) * cell - x0
            if dx * dx + dy * dy <= AGENT_RADIUS**2:
                visited[row, col] = True
                explored[row, col] = True
            if not seen[row - box[0], col - box[2]]:
                forward = dx * ahead_x + dy * ahead_y
                if forward <= 0 or forward > FAR:
                    continue
                # Use the smaller reach of the two neighbouring image columns.
                u = fl_x * (dx * right_x + dy * right_y) / forward + cx - 0.5
                left = int(np.floor(u))
                if left < 0 or left + 1 >= width or forward > min(reach[left], reach[left + 1]):
                    continue
            explored[row, col] = True
            angle = np.arctan2(-dy, -dx)
            turn = angle / (2 * np.pi) + (1.0 if angle < 0 else 0.0)
            viewpoints[min(int(turn * VIEWPOINT_BINS), VIEWPOINT_BINS - 1), row, col] = True
