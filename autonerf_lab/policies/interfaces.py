"""Policy interfaces of the modular policies: how a map becomes an observation, and an action becomes a waypoint.

Training and rollouts use the same interface. ``PaperInterface`` follows the paper and its released code: stacked maps
around the robot, a heading bin, and a waypoint anywhere in the window. ``CompactInterface`` can be trained on two CPU
cores: coarser maps, and a choice among the positions that the robot can reach.
"""

from typing import Any, Protocol

import numpy as np
from gymnasium import spaces
from numba import njit

from autonerf_lab.classes import NUM_CLASSES
from autonerf_lab.geometry import (
    FORWARD_STEP,
    block_shares,
    cell_to_world,
    planar_from_pose,
    world_to_cell,
)
from autonerf_lab.mapping.semantic_map import VIEWPOINT_BINS
from autonerf_lab.planning.dilation import dilate
from autonerf_lab.planning.fast_marching import travel_distance
from autonerf_lab.policies.information_gain import panoramic_gain
from autonerf_lab.types import MapState

HEADING_BINS = 72
FOLLOW_STEPS = 25  # actions of the local policy per waypoint, in the paper
WINDOW_METRES = 12.0  # side of the window of the map around the robot
MAP_WINDOWS = 3  # side of the whole map, in windows: an apartment is at most half as long


class WaypointTiming(Protocol):
    """Conditions that end a waypoint."""

    follow: int  # maximum number of actions of the local policy per waypoint
    arrival: float  # metres; a waypoint at this distance counts as reached. 0: only ``follow`` ends a waypoint


class PolicyInterface(WaypointTiming, Protocol):
    """Observations and actions of a global policy."""

    cell: float  # metres, cell of the maps that it is trained on; finer maps are pooled
    initial_turns: int  # left turns at the start position before the first waypoint
    observation_space: spaces.Dict
    action_space: spaces.Space[Any]

    def reset(self) -> None:
        """Begin an episode."""

    def observe(self, map: MapState) -> dict[str, Any]:
        """Encode a map as an observation."""

    def to_waypoint(self, action: Any, map: MapState) -> np.ndarray:
        """Decode an action that was chosen for this map: (2,) world x, y in metres."""

    def to_action(self, point: np.ndarray, map: MapState) -> Any:
        """Encode a point, (2,) world x, y, as the action that leads nearest to it; None if no action leads near."""


class PaperInterface:
    """Interface of section 3.1 and of the released code: a window of W x W cells around the robot, 12 m wide.

    Observation: ``map``, see :func:`stack_maps`; ``heading``, one of 72 bins, counter-clockwise from +x. Action: (2,)
    in [-1, 1], x and y across the window; 0 is its centre.

    The map may have any size. Each of its channels is pooled by the maximum over k x k cells, k = 12 m / W in cells of
    the map, rounded; cells outside the map are not set.

    Args:
        window: W; 240 gives cells of 5 cm.
        viewpoints: add the viewpoint channels, which only the reward ``view`` needs.
    """

    def __init__(self, window: int = 240, viewpoints: bool = False) -> None:
        self.window, self._viewpoints = window, viewpoints
        self.follow, self.arrival, self.initial_turns = FOLLOW_STEPS, 0.0, 0
        self.cell = WINDOW_METRES / window
        self.channels = 8 + NUM_CLASSES + 2 * VIEWPOINT_BINS * viewpoints
        self.action_space: spaces.Space[Any] = spaces.Box(-1, 1, (2,), np.float32)
        self.observation_space = spaces.Dict(
            {
                "map": spaces.Box(0, 1, (self.channels, window, window), np.uint8),
                "heading": spaces.Discrete(HEADING_BINS),
            }
        )

    def reset(self) -> None:
        """Do nothing: this interface has no state."""

    def observe(self, map: MapState) -> dict[str, Any]:
        """Return the stacked maps and the heading bin."""
        heading = planar_from_pose(map.pose)[2] % (2 * np.pi)
        return {
            "map": stack_maps(map, self.window, self._viewpoints, self._factor(map)),
            "heading": np.int64(int(heading / (2 * np.pi) * HEADING_BINS) % HEADING_BINS),
        }

    def to_waypoint(self, action: np.ndarray, map: MapState) -> np.ndarray:
        """Return the point of the window that the action selects."""
        side = self.window * self._factor(map)
        rows, cols = window_slices(map, side)
        inside = (np.clip(np.asarray(action, np.float64), -1, 1) + 1) / 2 * side
        return map.origin + (inside + np.array([cols.start, rows.start])) * map.cell

    def to_action(self, point: np.ndarray, map: MapState) -> np.ndarray:
        """Return the point in window coordinates, clipped to the border of the window."""
        side = self.window * self._factor(map)
        rows, cols = window_slices(map, side)
        inside = (point - map.origin) / map.cell - np.array([cols.start, rows.start])
        return np.clip(inside / side * 2 - 1, -1, 1).astype(np.float32)

    def _factor(self, map: MapState) -> int:
        """Return the number of map cells a side of one cell of the window."""
        return max(1, round(self.cell / map.cell))


class CompactInterface:
    """Interface over 16 m around the robot in 32 x 32 blocks of 50 cm; a waypoint is a block.

    Each block has at most one candidate position: the reachable cell nearest to its centre, at least 0.6 m from the
    robot. Up to 1.5 m of unexplored ground count as free, because waypoints exactly on the border of the explored area
    discover little.

    Observation: ``map`` (19, 32, 32) float32, the share of each block that is occupied, explored, visited, of each of
    the 15 classes, and occupied without a class. ``heading`` (2,), its cosine and sine. ``reach`` (6, 32, 32) float32,
    the candidate position of each block:

    * channel 0: 1 if the block has a candidate, else 0;
    * channel 1: path length from the robot, 10 m;
    * channels 2 to 4: gain at the candidate by :func:`~autonerf_lab.policies.information_gain.panoramic_gain`, 10 m²:
      unexplored ground, ground from new directions, obstacles from new directions;
    * channel 5: log(1 + n), n = number of previous waypoints near the candidate, weighted by distance. Only waypoints
      count that one decision can reach. A tried candidate that still has a large gain is usually a gap in the map.

    Action: index of the block, row times 32 plus column.

    Args:
        follow: maximum number of actions of the local policy per waypoint.
        arrival: metres; a waypoint at this distance counts as reached, and the next one is chosen.

    Example:
        >>> from autonerf_lab.geometry import planar_pose
        >>> from autonerf_lab.mapping import empty_map
        >>> interface, map = CompactInterface(), empty_map(planar_pose(0, 0, 0))
        >>> observation = interface.observe(map)
        >>> observation["reach"][0, 16, 10:22].astype(int)  # only the robot's own position is known
        array([0, 0, 1, 1, 1, 1, 1, 1, 1, 1, 0, 0])
        >>> interface.to_waypoint(16 * 32 + 18, map)
        array([1.25, 0.25])
    """

    cell = 0.1
    initial_turns = 9  # of 30 degrees: with a field of view of 90 degrees the robot sees all directions
    SIDE = 160  # cells a side of the window
    BLOCK = 5  # cells a side of a block
    GRID = SIDE // BLOCK
    CHANNELS = 3 + NUM_CLASSES
    REACH = 6  # channels of ``reach``
    CLEARANCE = 1.5  # cells around an obstacle that the body cannot enter; a larger value closes gaps of half a metre
    UNKNOWN_MARGIN = 15  # cells of unexplored ground that count as free
    TRIED_RADIUS = 0.5  # metres, standard deviation of the weight of previous waypoints
    MATCH_RADIUS = 0.5  # metres from a point to the candidate that represents it
    MIN_DISTANCE = 0.6  # metres from the robot to the nearest candidate: a waypoint at the robot ends at once

    def __init__(self, follow: int = FOLLOW_STEPS, arrival: float = 0.35) -> None:
        self.follow, self.arrival = follow, arrival
        self.reset()
        self.action_space: spaces.Space[Any] = spaces.Discrete(self.GRID**2)
        self.observation_space = spaces.Dict(
            {
                "map": spaces.Box(0, 1, (self.CHANNELS, self.GRID, self.GRID), np.float32),
                "reach": spaces.Box(0, np.inf, (self.REACH, self.GRID, self.GRID), np.float32),
                "heading": spaces.Box(-1, 1, (2,), np.float32),
            }
        )

    def reset(self) -> None:
        """Clear the waypoints of the last episode."""
        self._tried: list[np.ndarray] = []
        self._last: tuple[np.ndarray, tuple[np.ndarray, np.ndarray]] | None = None  # argument and result of _candidates

    def observe(self, map: MapState) -> dict[str, Any]:
        """Return the maps, the candidate positions and the heading."""
        known = self._known(map)
        top, left, factor = self._window(map)
        classes = pooled(map.semantics, top, left, self.SIDE, factor)
        unclassified = known[0] & ~classes.any(axis=0)
        viewpoints = pooled(map.viewpoints, top, left, self.SIDE, factor)
        candidates, distance = self._candidates(known)
        valid = candidates[..., 0] >= 0
        cells = candidates[valid]
        reach = np.zeros((self.REACH, self.GRID, self.GRID), np.float32)
        reach[0] = valid
        reach[1][valid] = distance[tuple(cells.T)] / 10
        walls = dilate(known[0], 1.5)  # distant walls are mapped as separate cells; rays must not pass between them
        reach[2:5, valid] = panoramic_gain(known[1], walls, viewpoints, cells).T * self.cell**2 / 10
        if self._tried:
            points = self._points(cells, map)
            squared = ((points[:, None] - np.array(self._tried)[None]) ** 2).sum(axis=2)
            reach[5][valid] = np.log1p(np.exp(-squared / (2 * self.TRIED_RADIUS**2)).sum(axis=1))
        heading = planar_from_pose(map.pose)[2]
        return {
            "map": block_shares(np.concatenate([known, classes, unclassified[None]]), self.BLOCK),
            "reach": reach,
            "heading": np.array([np.cos(heading), np.sin(heading)], np.float32),
        }

    def to_waypoint(self, action: int, map: MapState) -> np.ndarray:
        """Return the candidate of a block, or the block's centre; record it if one decision reaches it."""
        row, col = divmod(int(action), self.GRID)
        candidates, distance = self._candidates(self._known(map))
        cell = candidates[row, col]
        if cell[0] < 0:
            cell = np.array([row, col]) * self.BLOCK + self.BLOCK // 2
        point = self._points(cell, map)
        if distance[tuple(cell)] <= self.follow * FORWARD_STEP:
            self._tried.append(point)
        return point

    def to_action(self, point: np.ndarray, map: MapState) -> int | None:
        """Return the block whose candidate is nearest to the point; None if it is farther than 0.5 m."""
        candidates = self._candidates(self._known(map))[0]
        blocks = np.argwhere(candidates[..., 0] >= 0)
        distances = np.linalg.norm(self._points(candidates[tuple(blocks.T)], map) - point, axis=1)
        row, col = blocks[np.argmin(distances)]
        return int(row * self.GRID + col) if distances.min() <= self.MATCH_RADIUS else None

    def _points(self, cells: np.ndarray, map: MapState) -> np.ndarray:
        """Return world x, y of cells of the window."""
        top, left, _ = self._window(map)
        return cell_to_world(cells, map.origin + np.array([left, top]) * map.cell, self.cell)

    def _window(self, map: MapState) -> tuple[int, int, int]:
        """Return first row and column of the window, which may lie outside the map, and map cells per window cell."""
        factor = max(1, round(self.cell / map.cell))
        robot = world_to_cell(map.pose[:2, 3], map.origin, map.cell) // factor
        top, left = ((int(i) - self.SIDE // 2) * factor for i in robot)
        return top, left, factor

    def _known(self, map: MapState) -> np.ndarray:
        """Return (3, SIDE, SIDE) bool: occupied, explored, visited."""
        top, left, factor = self._window(map)
        channels = (map.occupied, map.explored, map.visited)
        return np.concatenate([pooled(channel[None], top, left, self.SIDE, factor) for channel in channels])

    def _candidates(self, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the candidate cell of each block, (GRID, GRID, 2), -1 without one, and path lengths, metres."""
        if self._last is not None and np.array_equal(self._last[0], known):
            return self._last[1]  # an action is decoded on the map that was encoded
        occupied, explored, visited = known
        middle = self.SIDE // 2
        clear = ~dilate(occupied, self.CLEARANCE)
        free = (explored & clear) | visited
        free[middle - 1 : middle + 2, middle - 1 : middle + 2] = True
        unknown = ~explored & clear
        free |= travel_distance(free | unknown, free, limit=self.UNKNOWN_MARGIN) <= self.UNKNOWN_MARGIN
        distance = travel_distance(free, np.array([[middle, middle]]), self.cell)
        reachable = np.isfinite(distance)
        distant = reachable & (distance >= self.MIN_DISTANCE)
        candidates = _nearest_to_centre(distant if distant.any() else reachable, self.BLOCK)
        self._last = known, (candidates, distance)
        return candidates, distance


@njit(cache=True, nogil=True)
def pooled(channels: np.ndarray, top: int, left: int, side: int, factor: int) -> np.ndarray:
    """Pool a window of a map by the maximum of ``factor`` x ``factor`` cells; false outside the map.

    Args:
        channels: (C, M, M) bool.
        top: first row of the window, may be negative.
        left: first column of the window, may be negative.
        side: cells a side of the result.
        factor: map cells a side of one cell of the result.

    Returns:
        (C, side, side) bool.

    Example:
        >>> pooled(np.eye(3, dtype=np.bool_)[None], -1, -1, 2, 2)[0].tolist()
        [[True, False], [False, True]]
    """
    count, size = channels.shape[0], channels.shape[1]
    out = np.zeros((count, side, side), np.bool_)
    first = max(0, left)
    last = max(first, min(size, left + side * factor))
    line = np.empty(side * factor, np.bool_)  # maximum over the rows of the blocks
    for k in range(count):
        for i in range(side):
            line[:] = False
            inside = line[first - left : last - left]
            for row in range(max(0, top + i * factor), min(size, top + (i + 1) * factor)):
                inside |= channels[k, row, first:last]  # a slice: compiled to vector instructions
            blocks = out[k, i]
            for part in range(factor):
                blocks |= line[part::factor]
    return out


@njit(cache=True, nogil=True)
def _nearest_to_centre(mask: np.ndarray, block: int) -> np.ndarray:
    """Return the set cell of each block nearest to its centre, (G, G, 2), -1 for a block without one."""
    grid = mask.shape[0] // block
    found = np.full((grid, grid, 2), -1, np.int64)
    half = (block - 1) / 2
    for i in range(grid):
        for j in range(grid):
            nearest = np.inf
            for r in range(block):
                for c in range(block):
                    squared = (r - half) ** 2 + (c - half) ** 2
                    if mask[i * block + r, j * block + c] and squared < nearest:
                        nearest = squared
                        found[i, j, 0], found[i, j, 1] = i * block + r, j * block + c
    return found


def waypoint_reached(timing: WaypointTiming, waypoint: np.ndarray, map: MapState) -> bool:
    """Return True if the robot is within ``timing.arrival`` of a waypoint."""
    return float(np.linalg.norm(map.pose[:2, 3] - waypoint)) < timing.arrival


def waypoint_finished(timing: WaypointTiming, waypoint: np.ndarray | None, map: MapState, steps: int) -> bool:
    """Return True if a waypoint that was followed for ``steps`` actions is reached or has used up its actions."""
    reached = waypoint is not None and waypoint_reached(timing, waypoint, map)
    return steps > 0 and (reached or steps >= timing.follow)


def window_slices(map: MapState, window: int) -> tuple[slice, slice]:
    """Return the rows and columns of the window centred on the robot, shifted to stay inside the map.

    A window larger than the map is centred on the map, with a negative start.
    """
    size = len(map.explored)
    robot = np.clip(world_to_cell(map.pose[:2, 3], map.origin, map.cell), 0, size - 1)
    low, high = (0, size - window) if size >= window else ((size - window) // 2,) * 2
    top, left = (int(i) for i in np.clip(robot - window // 2, low, high))
    return slice(top, top + window), slice(left, left + window)


def robot_mask(map: MapState) -> np.ndarray:
    """Return (M, M) uint8, 1 in the cell of the robot."""
    mask = np.zeros(map.explored.shape, np.uint8)
    mask[tuple(np.clip(world_to_cell(map.pose[:2, 3], map.origin, map.cell), 0, len(mask) - 1))] = 1
    return mask


def stack_maps(map: MapState, window: int, viewpoints: bool = False, factor: int = 1) -> np.ndarray:
    """Stack the input channels of the paper's global policy (section 3.1 and the released code).

    Args:
        map: map of any size; in training it has M = 3 W cells a side.
        window: W, cells a side of the window around the robot.
        viewpoints: append the 12 viewpoint channels of the window and the 12 of the whole map.
        factor: map cells a side of one cell of the window.

    Returns:
        (24, W, W) uint8: occupied, explored, the robot's cell and visited, in the window; the same four of the central
        3 x 3 windows of the map, maximum over 3 x 3 cells of the window; the 15 classes and occupied cells without a
        class, in the window. (48, W, W) with ``viewpoints``.
    """
    rows, cols = window_slices(map, window * factor)
    first = (len(map.explored) - MAP_WINDOWS * window * factor) // 2

    def near(channels: np.ndarray) -> np.ndarray:
        return pooled(channels, rows.start, cols.start, window, factor)

    def whole(channels: np.ndarray) -> np.ndarray:
        return pooled(channels, first, first, window, MAP_WINDOWS * factor)

    state = np.stack([map.occupied, map.explored, robot_mask(map).astype(bool), map.visited])
    here, classes = near(state), near(map.semantics)
    parts = [here, whole(state), classes, (here[0] & ~classes.any(axis=0))[None]]
    if viewpoints:
        parts += [near(map.viewpoints), whole(map.viewpoints)]
    return np.concatenate(parts).view(np.uint8)
