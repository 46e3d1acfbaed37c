"""What a modular policy sees of the map, and how it names a waypoint: the same in training and on a walk.

``PaperView`` is that of the paper and its released code: stacked maps around the robot, a heading bin, a waypoint
anywhere in the window. ``CompactView`` is what learns on two cores: coarser maps, and a choice among the places the
robot can reach, each with the way there and what could be seen from it.
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
from autonerf_lab.policies.information_gain import outlook
from autonerf_lab.types import MapState

HEADINGS = 72
FOLLOW_STEPS = 25  # actions of the local policy a waypoint, in the paper
WINDOW_METRES = 12.0  # side of the part of the map around the robot
MAP_WINDOWS = 3  # side of the whole map, in windows: no apartment is longer than half of it


class View(Protocol):
    """Observations and actions of a global policy."""

    cell: float  # metres, of the maps it is trained on; finer ones are pooled
    follow: int  # actions of the local policy until the next waypoint, at most
    arrival: float  # metres from a waypoint at which the next is due; 0: only time decides
    opening: int  # turns on the spot before the first waypoint
    observation_space: spaces.Dict
    action_space: spaces.Space[Any]

    def reset(self) -> None:
        """Begin an episode."""

    def see(self, map: MapState) -> dict[str, Any]:
        """The observation of a map."""

    def waypoint(self, action: Any, map: MapState) -> np.ndarray:
        """(2,) world x, y of an action that was chosen for this map."""

    def action(self, point: np.ndarray, map: MapState) -> Any:
        """The action that leads nearest to a point, (2,) world x, y; None where none leads near."""


class PaperView:
    """Section 3.1 and the released code: W x W cells around the robot, 12 m wide.

    Observation: ``map``, see :func:`global_input`; ``heading``, one of 72 bins, counter-clockwise from +x. Action: (2,)
    in [-1, 1], x and y across the window; 0 is its middle.

    Args:
        window: W; 240 are cells of 5 cm.
        viewpoints: add the viewpoint channels, which only the reward ``view`` needs.
    """

    def __init__(self, window: int = 240, viewpoints: bool = False) -> None:
        self.window, self._viewpoints = window, viewpoints
        self.follow, self.arrival, self.opening = FOLLOW_STEPS, 0.0, 0
        self.cell = WINDOW_METRES / window
        self.channels = 8 + NUM_CLASSES + 2 * VIEWPOINT_BINS * viewpoints
        self.action_space: spaces.Space[Any] = spaces.Box(-1, 1, (2,), np.float32)
        self.observation_space = spaces.Dict(
            {"map": spaces.Box(0, 1, (self.channels, window, window), np.uint8), "heading": spaces.Discrete(HEADINGS)}
        )

    def reset(self) -> None:
        """There is nothing to forget."""

    def see(self, map: MapState) -> dict[str, Any]:
        """Stacked maps and the heading."""
        heading = planar_from_pose(map.pose)[2] % (2 * np.pi)
        return {
            "map": global_input(map, self.window, self._viewpoints),
            "heading": np.int64(int(heading / (2 * np.pi) * HEADINGS) % HEADINGS),
        }

    def waypoint(self, action: np.ndarray, map: MapState) -> np.ndarray:
        """Where in the window the action points."""
        rows, cols = window_of(map, self.window)
        inside = (np.clip(np.asarray(action, np.float64), -1, 1) + 1) / 2 * self.window
        return map.origin + (inside + np.array([cols.start, rows.start])) * map.cell

    def action(self, point: np.ndarray, map: MapState) -> np.ndarray:
        """Where the point lies in the window, or the border next to it."""
        rows, cols = window_of(map, self.window)
        inside = (point - map.origin) / map.cell - np.array([cols.start, rows.start])
        return np.clip(inside / self.window * 2 - 1, -1, 1).astype(np.float32)


class CompactView:
    """16 m around the robot in 32 x 32 blocks of 50 cm; a waypoint is a block.

    Observation: ``map`` (19, 32, 32) float32, the share of each block that is occupied, explored, visited, of the 15
    classes, and occupied without a class. ``heading`` (2,), its cosine and sine. ``reach`` (6, 32, 32) float32, about
    one place a block, that of the reachable ground nearest to its middle, 0.6 m or more away, where up to 1.5 m of what
    nobody has seen are taken for free (who stops where the known ends does not get on):

    0. whether there is one; 1. the way there, 10 m;
    2. to 4. by :func:`~autonerf_lab.policies.information_gain.outlook` what could be seen from it, 10 m²: unseen
       ground, ground from new directions, obstacles from new directions;
    5. log(1 + how often it, or a place near it, was chosen from so near that one decision leads there): what was tried
       and still promises much is a gap in the map, and a place that is far is chosen again and again on the way.

    Action: the block, row times 32 plus column.

    Args:
        follow: actions of the local policy until the next waypoint, at most.
        arrival: metres from a waypoint at which the next is due: who waits for the end of his time only turns about.

    Example:
        >>> from autonerf_lab.geometry import planar_pose
        >>> from autonerf_lab.mapping import empty_map
        >>> view, map = CompactView(), empty_map(planar_pose(0, 0, 0))
        >>> seen = view.see(map)
        >>> seen["reach"][0, 16, 10:22].astype(int)  # the robot knows nothing but where it stands
        array([0, 0, 1, 1, 1, 1, 1, 1, 1, 1, 0, 0])
        >>> view.waypoint(16 * 32 + 18, map)
        array([1.25, 0.25])
    """

    cell = 0.1
    opening = 9  # turns of 30 degrees, and eyes of 90 have seen all around; frontier exploration begins so too
    SIDE = 160  # cells of the window
    BLOCK = 5  # cells a side of a block
    GRID = SIDE // BLOCK
    CHANNELS = 3 + NUM_CLASSES
    REACH = 6  # channels of what is known about a place
    CLEAR = 1.5  # cells around an obstacle where the body does not fit: more, and gaps of half a metre would be closed
    BEYOND = 15  # cells into the unknown
    NEAR = 0.5  # metres between places that are tried together
    ACROSS = 0.5  # metres from a point to the place that stands for it
    AWAY = 0.6  # metres from the robot to the nearest place: who chooses where he stands chooses again at once

    def __init__(self, follow: int = 12, arrival: float = 0.35) -> None:
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
        """Forget the waypoints of the last episode."""
        self._chosen: list[np.ndarray] = []

    def see(self, map: MapState) -> dict[str, Any]:
        """Maps, reachable places and the heading."""
        known = self._known(map)
        top, left, factor = self._window(map)
        classes = pooled(map.semantics, top, left, self.SIDE, factor)
        nameless = known[0] & ~classes.any(axis=0)
        viewpoints = pooled(map.viewpoints, top, left, self.SIDE, factor)
        places, distance = self._places(known)
        there = places[..., 0] >= 0
        cells = places[there]
        reach = np.zeros((self.REACH, self.GRID, self.GRID), np.float32)
        reach[0] = there
        reach[1][there] = distance[tuple(cells.T)] / 10
        walls = dilate(known[0], 1.5)  # from afar they are seen in dots, which no ray should slip through
        reach[2:5, there] = outlook(known[1], walls, viewpoints, cells).T * self.cell**2 / 10
        if self._chosen:
            points = self._points(cells, map)
            away = ((points[:, None] - np.array(self._chosen)[None]) ** 2).sum(axis=2)
            reach[5][there] = np.log1p(np.exp(-away / (2 * self.NEAR**2)).sum(axis=1))
        heading = planar_from_pose(map.pose)[2]
        return {
            "map": block_shares(np.concatenate([known, classes, nameless[None]]), self.BLOCK),
            "reach": reach,
            "heading": np.array([np.cos(heading), np.sin(heading)], np.float32),
        }

    def waypoint(self, action: int, map: MapState) -> np.ndarray:
        """The place of a block, or the middle of the block where there is none; if near, it is remembered as chosen."""
        row, col = divmod(int(action), self.GRID)
        places, distance = self._places(self._known(map))
        place = places[row, col]
        if place[0] < 0:
            place = np.array([row, col]) * self.BLOCK + self.BLOCK // 2
        point = self._points(place, map)
        if distance[tuple(place)] <= self.follow * FORWARD_STEP:
            self._chosen.append(point)
        return point

    def action(self, point: np.ndarray, map: MapState) -> int | None:
        """The block whose place is nearest to the point, within half a metre."""
        places = self._places(self._known(map))[0]
        blocks = np.argwhere(places[..., 0] >= 0)
        away = np.linalg.norm(self._points(places[tuple(blocks.T)], map) - point, axis=1)
        row, col = blocks[np.argmin(away)]
        return int(row * self.GRID + col) if away.min() <= self.ACROSS else None

    def _points(self, cells: np.ndarray, map: MapState) -> np.ndarray:
        """World x, y of cells of the window."""
        top, left, _ = self._window(map)
        return cell_to_world(cells, map.origin + np.array([left, top]) * map.cell, self.cell)

    def _window(self, map: MapState) -> tuple[int, int, int]:
        """First row and column of the map, maybe outside it, and how many of its cells make one here."""
        factor = max(1, round(self.cell / map.cell))
        robot = world_to_cell(map.pose[:2, 3], map.origin, map.cell) // factor
        top, left = ((int(i) - self.SIDE // 2) * factor for i in robot)
        return top, left, factor

    def _known(self, map: MapState) -> np.ndarray:
        """(3, SIDE, SIDE) bool: occupied, explored, visited."""
        top, left, factor = self._window(map)
        return pooled(np.stack([map.occupied, map.explored, map.visited]), top, left, self.SIDE, factor)

    def _places(self, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(GRID, GRID, 2) cell of each block's place, -1 without one, and the way to every cell, metres."""
        occupied, explored, visited = known
        middle = self.SIDE // 2
        clear = ~dilate(occupied, self.CLEAR)
        free = (explored & clear) | visited
        free[middle - 1 : middle + 2, middle - 1 : middle + 2] = True
        free |= travel_distance(free | (~explored & clear), free) <= self.BEYOND
        distance = travel_distance(free, np.array([[middle, middle]]), self.cell)
        reachable = np.isfinite(distance)
        away = reachable & (distance >= self.AWAY)
        return _nearest_to_middle(away if away.any() else reachable, self.BLOCK), distance


@njit(cache=True, nogil=True)
def pooled(channels: np.ndarray, top: int, left: int, side: int, factor: int) -> np.ndarray:
    """Maximum of ``factor`` x ``factor`` cells, false outside the map.

    Args:
        channels: (C, M, M) bool.
        top: first row, may be negative.
        left: first column, may be negative.
        side: cells a side of the result.
        factor: cells of the map a side of one of the result.

    Returns:
        (C, side, side) bool.

    Example:
        >>> pooled(np.eye(3, dtype=np.bool_)[None], -1, -1, 2, 2)[0].tolist()
        [[True, False], [False, True]]
    """
    count, size = channels.shape[0], channels.shape[1]
    out = np.zeros((count, side, side), np.bool_)
    for k in range(count):
        for row in range(max(0, top), min(size, top + side * factor)):
            for col in range(max(0, left), min(size, left + side * factor)):
                if channels[k, row, col]:
                    out[k, (row - top) // factor, (col - left) // factor] = True
    return out


@njit(cache=True, nogil=True)
def _nearest_to_middle(mask: np.ndarray, block: int) -> np.ndarray:
    """(G, G, 2) set cell of each block that is nearest to its middle, -1 where none is set."""
    grid = mask.shape[0] // block
    places = np.full((grid, grid, 2), -1, np.int64)
    half = (block - 1) / 2
    for i in range(grid):
        for j in range(grid):
            nearest = np.inf
            for r in range(block):
                for c in range(block):
                    away = (r - half) ** 2 + (c - half) ** 2
                    if mask[i * block + r, j * block + c] and away < nearest:
                        nearest = away
                        places[i, j, 0], places[i, j, 1] = i * block + r, j * block + c
    return places


def done(view: View, waypoint: np.ndarray | None, map: MapState, steps: int) -> bool:
    """Whether a waypoint that was followed for so many steps, one at least, makes way for the next."""
    reached = waypoint is not None and float(np.linalg.norm(map.pose[:2, 3] - waypoint)) < view.arrival
    return steps > 0 and (reached or steps >= view.follow)


def window_of(map: MapState, window: int) -> tuple[slice, slice]:
    """Rows and columns of the map around the robot, who leaves the middle where the map ends."""
    size = len(map.explored)
    robot = np.clip(world_to_cell(map.pose[:2, 3], map.origin, map.cell), 0, size - 1)
    top, left = (int(i) for i in np.clip(robot - window // 2, 0, size - window))
    return slice(top, top + window), slice(left, left + window)


def place_of(map: MapState) -> np.ndarray:
    """(M, M) uint8, 1 in the cell the robot is in."""
    place = np.zeros(map.explored.shape, np.uint8)
    place[tuple(np.clip(world_to_cell(map.pose[:2, 3], map.origin, map.cell), 0, len(place) - 1))] = 1
    return place


def global_input(map: MapState, window: int, viewpoints: bool = False) -> np.ndarray:
    """What the global policy of the paper sees (section 3.1 and the released code).

    Returns:
        (24, window, window) uint8: occupied, explored, the robot's cell and where it has been, around the robot; the
        same four of the whole map, the maximum of 3x3 cells each; then 15 classes and what is occupied without a class,
        around the robot. With ``viewpoints`` 12 directions around the robot and 12 of the whole map follow.
    """
    view = window_of(map, window)
    state = np.stack([map.occupied, map.explored, place_of(map).astype(bool), map.visited])
    nameless = map.occupied[view] & ~map.semantics[(slice(None), *view)].any(axis=0)
    parts = [state[(slice(None), *view)], _whole(state), map.semantics[(slice(None), *view)], nameless[None]]
    if viewpoints:
        parts += [map.viewpoints[(slice(None), *view)], _whole(map.viewpoints)]
    return np.concatenate(parts).view(np.uint8)


def _whole(channels: np.ndarray) -> np.ndarray:
    return pooled(channels, 0, 0, channels.shape[1] // MAP_WINDOWS, MAP_WINDOWS)
