"""Frontier exploration (Yamauchi 1997): the strong baseline for the learned policies.

A frontier is free ground next to unexplored ground. The gain of a contour of frontier cells is the unexplored area
visible from it, its cost the number of steps to reach it; the target is the contour with the best ratio. The policy
chooses a new target when it has reached the last one, when most of its gain has been seen on the way, when another
target is much better, when the path was blocked twice, and after 200 steps. When nothing is left to discover, the
targets are positions that see explored ground from new directions, which improves a radiance field.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from autonerf_lab.geometry import (
    AGENT_RADIUS,
    FORWARD_STEP,
    TURN_ANGLE,
    cell_to_world,
    planar_from_pose,
    world_to_cell,
    wrap_angle,
)
from autonerf_lab.planning.dilation import bounding_box, dilate, nearest_set_cell, resized
from autonerf_lab.planning.fast_marching import travel_distance
from autonerf_lab.planning.local_policy import LocalPolicy
from autonerf_lab.policies.information_gain import RAYS, new_views, unknown_area
from autonerf_lab.types import Action, MapState, Observation

_FULL_TURN = round(2 * np.pi / TURN_ANGLE)
_NEAR = 0.5  # metres, minimum range of the depth sensor
_REACH = 3.0  # metres, range of the gain in unexplored ground
_VIEW_REACH = 4.0  # metres, range of the gain in new directions on explored ground
_MIN_GAIN = 0.2  # m²; smaller gains are gaps behind furniture
_MIN_CONTOUR = 0.25  # metres
_SPENT = 0.35  # share of the initial gain below which a target is dropped
_BETTER = 1.5  # minimum ratio of utilities for a change of target
_RECONSIDER = 12  # steps between two comparisons with other targets
_MAX_STEPS = 200  # per target
_ARRIVED = 0.35  # metres
_OVERHEAD = 4.0  # steps, fixed cost of a new target
_CANDIDATES = 48  # random positions that are compared when nothing is left to discover


@dataclass(frozen=True)
class Target:
    """Waypoint with its gain and utility."""

    cell: tuple[int, int]  # row, column
    point: np.ndarray  # (2,) world x, y, metres
    gain: float  # m²
    utility: float  # m² per step
    discovers: bool  # True: the gain is unexplored ground; False: new directions on explored ground


class Frontier:
    """Frontier exploration; the local policy follows the waypoints."""

    def __init__(self) -> None:
        self.reset(np.random.default_rng(0))

    @property
    def waypoint(self) -> np.ndarray | None:
        """Current waypoint, (2,) world x, y in metres; None before the first."""
        return None if self._target is None else self._target.point

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode."""
        self._rng = rng
        self._local = LocalPolicy()
        self._target: Target | None = None
        self._given_up: np.ndarray | None = None  # (M, M) bool, frontier cells that a visit did not resolve
        self._spin = _FULL_TURN - 1  # left turns at the start: cheaper than a path to frontiers behind the robot
        self._age = 0
        self._looks = 0
        self._failures = 0

    def act(self, map: MapState, observation: Observation) -> int:
        """Return the next action."""
        if self._given_up is None or self._given_up.shape != map.explored.shape:
            self._given_up = resized(self._given_up, len(map.explored))
            self._target = None  # its cell is that of the smaller map
        if self._spin > 0:
            self._spin -= 1
            return Action.TURN_LEFT
        self._age += 1
        self._review(map)
        if self._target is None:
            self._choose(map)
        if self._target is None:  # no reachable target
            return Action.TURN_LEFT
        if self._distance(map, self._target) < _ARRIVED or self._local.arrived:
            look = self._look(map, self._target)
            if look is not None:
                return look
            self._give_up(map, self._target)
            self._choose(map)
            if self._target is None:
                return Action.TURN_LEFT
        return self._local.act(map, self._target.point)

    def _review(self, map: MapState) -> None:
        """Drop the target if it is spent or has failed; replace it by a much better one."""
        target = self._target
        if target is None:
            return
        if self._local.blocked:
            self._failures += 1
        if self._failures >= 2 or self._age >= _MAX_STEPS:
            self._give_up(map, target)
        elif target.discovers and self._gain(map, target.cell).sum() < max(_SPENT * target.gain, _MIN_GAIN):
            self._target = None
        elif target.discovers and self._age % _RECONSIDER == 0:
            self._choose(map, current=target)

    def _give_up(self, map: MapState, target: Target) -> None:
        """Drop the target and exclude the frontier cells around it."""
        assert self._given_up is not None
        if target.discovers:
            rows, cols = np.ogrid[: len(map.explored), : len(map.explored)]
            near = (rows - target.cell[0]) ** 2 + (cols - target.cell[1]) ** 2 <= (0.5 / map.cell) ** 2
            self._given_up |= near
        self._target = None

    def _look(self, map: MapState, target: Target) -> int | None:
        """Return the turn at the waypoint towards the largest remaining gain; None if little gain is left."""
        x, y, heading = planar_from_pose(map.pose)
        row, col = (int(i) for i in world_to_cell(np.array([x, y]), map.origin, map.cell))
        gain = self._gain(map, (row, col)) if target.discovers else self._views(map, (row, col))
        if self._looks >= _FULL_TURN or gain.sum() < (_MIN_GAIN if target.discovers else _SPENT * target.gain):
            return None
        # The field of view is 90 degrees: sum the gain over a quarter of the rays for each direction.
        quarter = RAYS // 4
        in_view = np.convolve(np.append(gain, gain[: quarter - 1]), np.ones(quarter), "valid")
        middle = 2 * np.pi * (np.arange(RAYS) + quarter / 2) / RAYS
        error = wrap_angle(middle[int(np.argmax(in_view))] - heading)
        if abs(error) <= TURN_ANGLE / 2 + 1e-6:
            return None  # the robot faces the gain already and cannot see it
        self._looks += 1
        return Action.TURN_LEFT if error > 0 else Action.TURN_RIGHT

    def _choose(self, map: MapState, current: Target | None = None) -> None:
        """Set the best target; ``current`` stays unless another target is much better."""
        distance = path_lengths_from_robot(map)
        found = self._best_frontier(map, distance)
        if current is not None:
            metres, utility = distance[current.cell], 0.0
            if np.isfinite(metres):
                utility = self._gain(map, current.cell).sum() / self._steps(map, current.cell, metres)
            if found is None or found.utility < _BETTER * utility:
                return
        self._target = found or self._best_view(map, distance)
        self._age = self._looks = self._failures = 0

    def _best_frontier(self, map: MapState, distance: np.ndarray) -> Target | None:
        """Return the frontier contour of highest utility."""
        assert self._given_up is not None
        window = _around(map.explored, 1)
        corner = np.array([window[0].start, window[1].start])
        labels, _ = ndimage.label((reachable_frontier(map, distance) & ~self._given_up)[window], np.ones((3, 3)))
        best: Target | None = None
        reachable = np.isfinite(distance)
        for number, box in enumerate(ndimage.find_objects(labels), start=1):
            cells = np.argwhere(labels[box] == number) + corner + [box[0].start, box[1].start]
            if len(cells) * map.cell < _MIN_CONTOUR:
                continue
            centre = cells[np.argmin(((cells - cells.mean(axis=0)) ** 2).sum(axis=1))]
            best = self._better(map, best, nearest_set_cell(reachable, *centre), distance, discovers=True)
        return best

    def _best_view(self, map: MapState, distance: np.ndarray) -> Target | None:
        """Return the best of several random reachable positions by the area seen from new directions."""
        cells = np.argwhere(np.isfinite(distance) & (distance > 0))
        best: Target | None = None
        if len(cells):
            for row, col in cells[self._rng.integers(len(cells), size=_CANDIDATES)]:
                best = self._better(map, best, (int(row), int(col)), distance, discovers=False)
        return best

    def _better(
        self,
        map: MapState,
        best: Target | None,
        cell: tuple[int, int],
        distance: np.ndarray,
        *,
        discovers: bool,
    ) -> Target | None:
        """Return ``best``, or a target at ``cell`` if its utility is higher."""
        gain = float((self._gain(map, cell) if discovers else self._views(map, cell)).sum())
        if discovers and gain < _MIN_GAIN:
            return best
        utility = gain / self._steps(map, cell, float(distance[cell]))
        if best is not None and best.utility >= utility:
            return best
        return Target(cell, cell_to_world(np.array(cell), map.origin, map.cell), gain, utility, discovers)

    def _steps(self, map: MapState, cell: tuple[int, int], metres: float) -> float:
        """Estimate the number of actions to a cell at the end of a path of this length."""
        x, y, heading = planar_from_pose(map.pose)
        point = cell_to_world(np.array(cell), map.origin, map.cell)
        turn = abs(wrap_angle(float(np.arctan2(point[1] - y, point[0] - x)) - heading))
        return metres / FORWARD_STEP + turn / TURN_ANGLE + _OVERHEAD

    def _gain(self, map: MapState, cell: tuple[int, int]) -> np.ndarray:
        """Return the unexplored area visible from a cell, (RAYS,) m²."""
        rays = unknown_area(map.explored, map.occupied, *cell, _NEAR / map.cell, _REACH / map.cell)
        return rays * map.cell**2

    def _views(self, map: MapState, cell: tuple[int, int]) -> np.ndarray:
        """Return the area visible from a cell in a new direction, (RAYS,) m²."""
        return (
            new_views(map.explored, map.occupied, map.viewpoints, *cell, _NEAR / map.cell, _VIEW_REACH / map.cell)
            * map.cell**2
        )

    def _distance(self, map: MapState, target: Target) -> float:
        return float(np.linalg.norm(map.pose[:2, 3] - target.point))


def path_lengths_from_robot(map: MapState) -> np.ndarray:
    """Compute path lengths from the robot over explored ground with clearance for its body.

    Returns:
        (M, M) float64, metres; inf for unreachable cells.

    Example:
        >>> from autonerf_lab.geometry import planar_pose
        >>> from autonerf_lab.mapping import empty_map
        >>> bool(np.isinf(path_lengths_from_robot(empty_map(planar_pose(0, 0, 0)))).all())  # nothing is explored yet
        True
    """
    radius = round(AGENT_RADIUS / map.cell)
    window = _around(map.explored, radius)
    free = (map.explored[window] & ~dilate(map.occupied[window], radius + 0.5)) | map.visited[window]
    goal = np.zeros_like(map.explored)
    goal[tuple(world_to_cell(map.pose[:2, 3], map.origin, map.cell))] = True
    distance = np.full(map.explored.shape, np.inf)
    distance[window] = travel_distance(free, goal[window], map.cell)
    return distance


def reachable_frontier(map: MapState, distance: np.ndarray) -> np.ndarray:
    """Return the (M, M) bool mask of free cells with an unexplored 4-neighbour, at or beside reachable ground.

    Args:
        map: current map.
        distance: of :func:`path_lengths_from_robot`.

    Example:
        >>> from dataclasses import replace
        >>> from autonerf_lab.geometry import planar_pose
        >>> from autonerf_lab.mapping import empty_map
        >>> map = empty_map(planar_pose(0, 0, 0), 30)
        >>> explored = np.zeros_like(map.explored)
        >>> explored[14:17, 13:17] = True  # 3 x 4 cells around the robot: all but two have an unexplored neighbour
        >>> map = replace(map, explored=explored)
        >>> int(reachable_frontier(map, path_lengths_from_robot(map)).sum())
        10
    """
    window = _around(map.explored, 1)
    reachable = np.isfinite(distance[window])
    # Dilated obstacles may separate a frontier from the reachable ground, by at most this margin.
    near = dilate(_border(reachable), AGENT_RADIUS / map.cell + 2) | reachable
    frontier = np.zeros_like(map.explored)
    frontier[window] = _border(map.explored[window]) & ~map.occupied[window] & near
    return frontier


def _around(mask: np.ndarray, margin: int) -> tuple[slice, slice]:
    """Return the rows and columns of the set cells with a margin."""
    top, bottom, left, right = bounding_box(mask)
    return slice(max(0, top - margin), bottom + margin), slice(max(0, left - margin), right + margin)


def _border(mask: np.ndarray) -> np.ndarray:
    """Return the set cells with at least one unset 4-neighbour."""
    inner = mask.copy()
    inner[1:] &= mask[:-1]
    inner[:-1] &= mask[1:]
    inner[:, 1:] &= mask[:, :-1]
    inner[:, :-1] &= mask[:, 1:]
    return mask & ~inner
