"""Local policy: from a waypoint on the map to the next action.

A fast-marching field gives the path length from every cell to the waypoint; the robot heads for the best cell a few
cells ahead. Unexplored cells count as free, cells of collisions as blocked. The field is computed again if the waypoint
changes, an obstacle appears near the planned path, the robot leaves the field, or after 25 steps. For the same
waypoint, only the part that the changes of the map may affect is computed.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from autonerf_lab.geometry import AGENT_RADIUS, TURN_ANGLE, planar_from_pose, world_to_cell, wrap_angle
from autonerf_lab.planning.dilation import bounding_box, dilate, nearest_set_cell, resized
from autonerf_lab.planning.fast_marching import UpdatedDistance, descend, travel_distance
from autonerf_lab.types import Action, MapState

_MARGIN = 1.5  # metres around the explored area that are planned on; a larger margin takes more time
_RING = 0.25  # metres to the short-term goal
_REPLAN_STEPS = 25
_MIN_MOVE = 0.20  # metres; a shorter forward step is a collision
_ARRIVED = 0.2  # metres from the end of the plan
_ESCAPE_AFTER = 4  # collisions within _ESCAPE_WINDOW steps
_ESCAPE_WINDOW = 12


@dataclass(frozen=True)
class Plan:
    """Path lengths to a waypoint over a part of the map."""

    target: tuple[int, int]  # cell of the waypoint
    corner: tuple[int, int]  # map cell of distance[0, 0]
    distance: np.ndarray  # (R, C) float64, metres; inf for blocked cells; the next plan overwrites it
    path: np.ndarray  # (K, 2) map cells from the robot to the goal
    exact: bool  # True: the path ends at the waypoint; False: at the reachable cell nearest to it


class LocalPolicy:
    """Follow waypoints with the robot's actions; cells of collisions stay blocked for the episode.

    Example:
        >>> from autonerf_lab.geometry import planar_pose
        >>> from autonerf_lab.mapping import empty_map
        >>> LocalPolicy().act(empty_map(planar_pose(0, 0, 0)), np.array([2.0, 0.0]))
        <Action.FORWARD: 0>
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Begin an episode."""
        self._plan: Plan | None = None
        self._lengths: UpdatedDistance | None = None  # of the last plan
        self._bumped: np.ndarray | None = None  # (M, M) bool, cells blocked by collisions
        self._last: tuple[float, float, float] | None = None
        self._last_action: Action | None = None
        self._bump_steps: list[int] = []
        self._age = 0
        self._steps = 0
        self._left = np.inf  # metres to the end of the plan
        self._escape: list[Action] = []

    @property
    def path(self) -> np.ndarray:
        """Planned path, (K, 2) map cells from the position at planning time; empty without a plan."""
        return np.empty((0, 2), np.int64) if self._plan is None else self._plan.path

    @property
    def blocked(self) -> bool:
        """True if the last waypoint is unreachable and the robot heads for the reachable cell nearest to it."""
        return self._plan is not None and not self._plan.exact

    @property
    def arrived(self) -> bool:
        """True if the robot is at the end of its plan, within 0.2 m."""
        return self._left < _ARRIVED

    def act(self, map: MapState, waypoint: np.ndarray) -> Action:
        """Return the next action towards a waypoint.

        Args:
            map: current map, with the robot's pose.
            waypoint: (2,) world x, y, metres.
        """
        x, y, heading = planar_from_pose(map.pose)
        self._steps += 1
        self._age += 1
        self._detect_collision(map, x, y, heading)
        action = self._escape.pop(0) if self._escape else self._towards(map, np.asarray(waypoint), x, y, heading)
        self._last, self._last_action = (x, y, heading), action
        return action

    def _detect_collision(self, map: MapState, x: float, y: float, heading: float) -> None:
        """Block the cells ahead if the last forward step was too short."""
        if self._bumped is None or self._bumped.shape != map.occupied.shape:
            self._bumped = resized(self._bumped, len(map.occupied))
            self._plan = None  # its cells are those of the smaller map
        if self._last is None or self._last_action != Action.FORWARD:
            return
        if np.hypot(x - self._last[0], y - self._last[1]) >= _MIN_MOVE:
            return
        self._bump_steps = [*(s for s in self._bump_steps if s > self._steps - _ESCAPE_WINDOW), self._steps]
        repeats = len(self._bump_steps)
        # Block a strip in front of the body; it grows with repeated collisions.
        ahead = AGENT_RADIUS + map.cell * np.arange(0.5, 2.0)
        across = map.cell * np.arange(-repeats, repeats + 1)
        a, b = np.meshgrid(ahead, across)
        last_heading = self._last[2]
        points = np.stack(
            [
                x + a * np.cos(last_heading) - b * np.sin(last_heading),
                y + a * np.sin(last_heading) + b * np.cos(last_heading),
            ],
            axis=-1,
        ).reshape(-1, 2)
        cells = world_to_cell(points, map.origin, map.cell)
        inside = ((cells >= 0) & (cells < len(self._bumped))).all(axis=1)
        self._bumped[tuple(cells[inside].T)] = True
        self._plan = None
        if repeats >= _ESCAPE_AFTER:
            # Repeated collisions on ground that the map calls free: turn away, move, and plan again.
            turn = Action.TURN_LEFT if self._steps % 2 else Action.TURN_RIGHT
            self._escape = [turn] * (2 + self._steps % 4) + [Action.FORWARD] * 2
            self._bump_steps = []

    def _towards(self, map: MapState, waypoint: np.ndarray, x: float, y: float, heading: float) -> Action:
        """Return the action along the plan; make a new plan if necessary."""
        row, col = (int(i) for i in world_to_cell(waypoint, map.origin, map.cell))
        target = (min(max(row, 0), len(map.occupied) - 1), min(max(col, 0), len(map.occupied) - 1))
        start = tuple(int(i) for i in world_to_cell(np.array([x, y]), map.origin, map.cell))
        goal = None
        if self._plan is not None and self._plan.target == target and not self._stale(map, self._plan, start):
            goal = self._short_term_goal(map, self._plan, start)
        if goal is None:
            self._plan = self._make_plan(map, target, start)
            self._age = 0
            goal = self._short_term_goal(map, self._plan, start)
        assert self._plan is not None
        corner = self._plan.corner
        self._left = float(self._plan.distance[start[0] - corner[0], start[1] - corner[1]])
        if goal is None or (self.arrived and self.blocked):
            return Action.TURN_LEFT  # no better position: look around
        error = wrap_angle(np.arctan2(goal[1] - y, goal[0] - x) - heading)
        if abs(error) <= TURN_ANGLE / 2 + 1e-6:
            return Action.FORWARD
        turn = Action.TURN_LEFT if error > 0 else Action.TURN_RIGHT
        reverses = {Action.TURN_LEFT, Action.TURN_RIGHT} == {turn, self._last_action}
        # Do not alternate between left and right turns.
        return Action.FORWARD if reverses and abs(error) < TURN_ANGLE else turn

    def _stale(self, map: MapState, plan: Plan, start: tuple[int, ...]) -> bool:
        """Return True if the plan is old or an obstacle is too close to the rest of its path."""
        if self._age >= _REPLAN_STEPS:
            return True
        reach = max(1, round(AGENT_RADIUS / map.cell) - 1)
        nearest = int(np.argmin(((plan.path - np.array(start)) ** 2).sum(axis=1)))
        return bool(_near_obstacle(map.occupied, plan.path[nearest:], reach, start[0], start[1]))

    def _short_term_goal(self, map: MapState, plan: Plan, start: tuple[int, ...]) -> np.ndarray | None:
        """Return world x, y of the first step of the descent; None if the robot is outside the field or at its end."""
        row, col = start[0] - plan.corner[0], start[1] - plan.corner[1]
        if not (0 <= row < plan.distance.shape[0] and 0 <= col < plan.distance.shape[1]):
            return None
        if not np.isfinite(plan.distance[row, col]):
            return None
        ring = max(2, round(_RING / map.cell))
        path = descend(plan.distance, (row, col), map.cell, ring, max_steps=1)
        if len(path) < 2:
            return None
        return (path[1][::-1] + np.array(plan.corner)[::-1] + 0.5) * map.cell + map.origin

    def _make_plan(self, map: MapState, target: tuple[int, int], start: tuple[int, ...]) -> Plan:
        """Plan with the largest possible clearance, to the reachable cell nearest to the target."""
        assert self._bumped is not None
        self._lengths = self._lengths or UpdatedDistance(map.cell)
        window = _window(map, start, target)
        corner = (window[0].start, window[1].start)
        goal = (target[0] - corner[0], target[1] - corner[1])
        here = (start[0] - corner[0], start[1] - corner[1])
        occupied, visited, bumped = map.occupied[window], map.visited[window], self._bumped[window]
        radius = round(AGENT_RADIUS / map.cell)
        free = np.ones(occupied.shape, bool)
        for reach in range(radius, -1, -1):  # a smaller clearance opens doorways that are mapped too narrow
            free = (~dilate(occupied, reach + 0.5) | visited) & ~bumped
            free[max(0, here[0] - 1) : here[0] + 2, max(0, here[1] - 1) : here[1] + 2] = True
            goal_cells = _goal_cells(free, goal, max(2, round(0.15 / map.cell)))
            distance = self._lengths.update(free, goal_cells, here, corner)
            if np.isfinite(distance[here]):
                return Plan(target, corner, distance, descend(distance, here, map.cell) + corner, True)
            if reach <= radius - 2 and bumped.any():
                # A cell blocked by a collision may close the only path.
                self._bumped[window] = False
                bumped = self._bumped[window]
        reachable = np.isfinite(travel_distance(free, np.array([here]), map.cell))
        nearest = np.array(nearest_set_cell(reachable, *goal))
        distance = travel_distance(free, nearest[None], map.cell, here)
        return Plan(target, corner, distance, descend(distance, here, map.cell) + corner, False)


def _window(map: MapState, *cells: tuple[int, ...]) -> tuple[slice, slice]:
    """Return the rows and columns of the explored area and the given cells, with a margin."""
    margin = round(_MARGIN / map.cell)
    size = len(map.explored)
    box = bounding_box(map.explored)
    slices = []
    for axis in range(2):
        low, high = box[2 * axis : 2 * axis + 2]
        ends = [int(c[axis]) for c in cells] + ([low, high - 1] if high else [])
        slices.append(slice(max(0, min(ends) - margin), min(size, max(ends) + margin + 1)))
    return slices[0], slices[1]


def _goal_cells(free: np.ndarray, goal: tuple[int, int], radius: int) -> np.ndarray:
    """Return the mask of free cells within ``radius`` cells of the goal."""
    rows = np.arange(max(0, goal[0] - radius), min(free.shape[0], goal[0] + radius + 1))
    cols = np.arange(max(0, goal[1] - radius), min(free.shape[1], goal[1] + radius + 1))
    found, box = np.zeros_like(free), np.ix_(rows, cols)
    found[box] = free[box] & ((rows[:, None] - goal[0]) ** 2 + (cols - goal[1]) ** 2 <= radius**2)
    return found


@njit(cache=True)
def _near_obstacle(occupied: np.ndarray, path: np.ndarray, reach: int, row0: int, col0: int) -> bool:
    """Return True if a path comes within ``reach`` cells of an obstacle; its surroundings at the start do not count."""
    size = occupied.shape[0]
    for i in range(len(path) - 1):
        steps = max(abs(path[i + 1, 0] - path[i, 0]), abs(path[i + 1, 1] - path[i, 1]))
        for s in range(steps):
            r = path[i, 0] + (path[i + 1, 0] - path[i, 0]) * s // steps
            c = path[i, 1] + (path[i + 1, 1] - path[i, 1]) * s // steps
            if abs(r - row0) + abs(c - col0) <= reach + 1:
                continue
            for y in range(max(0, r - reach), min(size, r + reach + 1)):
                for x in range(max(0, c - reach), min(size, c + reach + 1)):
                    if occupied[y, x] and (y - r) ** 2 + (x - c) ** 2 <= reach * reach:
                        return True
    return False
