"""Frontier exploration (Yamauchi 1997), as strong as we could make it: the rival the learned policies have to beat.

A frontier is free ground next to ground nobody has seen. Every contour of frontier cells is worth the unseen area that
could be looked at from it and costs the steps to get there; the robot walks to the best ratio. It chooses again when it
has arrived, when what it was going to see has been seen on the way, when something better turns up, when the way is
blocked twice, and after 200 steps. When nothing is left to discover it walks to where it sees known ground from new
directions, which is what a radiance field asks for.
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
from autonerf_lab.planning.dilation import dilate
from autonerf_lab.planning.fast_marching import travel_distance
from autonerf_lab.planning.local_policy import LocalPolicy
from autonerf_lab.policies.information_gain import RAYS, new_views, unknown_area
from autonerf_lab.types import Action, MapState, Observation

_FULL_TURN = round(2 * np.pi / TURN_ANGLE)
_NEAR = 0.5  # metres, where the depth sensor begins
_REACH = 3.0  # metres, how far ahead unseen ground is promised
_VIEW_REACH = 4.0  # metres, for new directions on known ground
_MIN_GAIN = 0.2  # square metres: less is the crack behind a cupboard
_MIN_CONTOUR = 0.25  # metres
_SPENT = 0.35  # of the promised gain: when less is left, the waypoint has done its work
_BETTER = 1.5  # times the utility of the present waypoint: worth turning round for
_RECONSIDER = 12  # steps
_MAX_STEPS = 200
_ARRIVED = 0.35  # metres
_OVERHEAD = 4.0  # steps that every new waypoint costs: turning, starting
_CANDIDATES = 48  # places that are compared when nothing is left to discover


@dataclass(frozen=True)
class Target:
    """A waypoint and what it was chosen for."""

    cell: tuple[int, int]
    point: np.ndarray  # (2,) world x, y
    gain: float  # square metres
    utility: float  # square metres a step
    discovers: bool  # unseen ground; else new directions on known ground


class Frontier:
    """Frontier exploration with the local policy."""

    def __init__(self) -> None:
        self.reset(np.random.default_rng(0))

    @property
    def waypoint(self) -> np.ndarray | None:
        """(2,) world x, y, None before the first."""
        return None if self._target is None else self._target.point

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode."""
        self._rng = rng
        self._local = LocalPolicy()
        self._target: Target | None = None
        self._given_up: np.ndarray | None = None  # (M, M) bool, frontier cells that stayed one when visited
        self._spin = _FULL_TURN - 1  # a look around from the start costs less than a walk to what is behind
        self._age = 0
        self._looks = 0
        self._failures = 0

    def act(self, map: MapState, observation: Observation) -> int:
        """The next action."""
        if self._given_up is None or self._given_up.shape != map.explored.shape:
            self._given_up = np.zeros_like(map.explored)
        if self._spin > 0:
            self._spin -= 1
            return Action.TURN_LEFT
        self._age += 1
        self._review(map)
        if self._target is None:
            self._choose(map)
        if self._target is None:  # walled in on all sides
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
        """Drop the target when it has served or failed; exchange it for a much better one."""
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
            self._choose(map, keep=target)

    def _give_up(self, map: MapState, target: Target) -> None:
        assert self._given_up is not None
        if target.discovers:
            rows, cols = np.ogrid[: len(map.explored), : len(map.explored)]
            near = (rows - target.cell[0]) ** 2 + (cols - target.cell[1]) ** 2 <= (0.5 / map.cell) ** 2
            self._given_up |= near
        self._target = None

    def _look(self, map: MapState, target: Target) -> int | None:
        """At the waypoint: turn to where most is left to see; None when it was seen."""
        x, y, heading = planar_from_pose(map.pose)
        row, col = (int(i) for i in world_to_cell(np.array([x, y]), map.origin, map.cell))
        gain = self._gain(map, (row, col)) if target.discovers else self._views(map, (row, col))
        if self._looks >= _FULL_TURN or gain.sum() < (_MIN_GAIN if target.discovers else _SPENT * target.gain):
            return None
        # The field of view is 90 degrees: what a quarter turn of rays around each direction would show.
        quarter = RAYS // 4
        in_view = np.convolve(np.append(gain, gain[: quarter - 1]), np.ones(quarter), "valid")
        middle = 2 * np.pi * (np.arange(RAYS) + quarter / 2) / RAYS
        error = wrap_angle(middle[int(np.argmax(in_view))] - heading)
        if abs(error) <= TURN_ANGLE / 2 + 1e-6:
            return None  # it is looking there, and still does not see it
        self._looks += 1
        return Action.TURN_LEFT if error > 0 else Action.TURN_RIGHT

    def _choose(self, map: MapState, keep: Target | None = None) -> None:
        """Set the best target; ``keep`` stays unless another is much better."""
        distance = travel_from_robot(map)
        found = self._best_frontier(map, distance)
        if keep is not None:
            steps = distance[keep.cell]
            now = self._gain(map, keep.cell).sum() / self._steps(map, keep.cell, steps) if np.isfinite(steps) else 0.0
            if found is None or found.utility < _BETTER * now:
                return
        self._target = found or self._best_view(map, distance)
        self._age = self._looks = self._failures = 0

    def _best_frontier(self, map: MapState, distance: np.ndarray) -> Target | None:
        assert self._given_up is not None
        reachable = np.isfinite(distance)
        frontier = _border(map.explored) & ~map.occupied & ~self._given_up
        # Obstacles grown by the radius of the body may part a frontier from the ground it is seen from, no wider.
        frontier &= dilate(_border(reachable), AGENT_RADIUS / map.cell + 2) | reachable
        labels, _ = ndimage.label(frontier, np.ones((3, 3)))
        best: Target | None = None
        stand = np.argwhere(reachable)
        for number, box in enumerate(ndimage.find_objects(labels), start=1):
            cells = np.argwhere(labels[box] == number) + np.array([box[0].start, box[1].start])
            if len(cells) * map.cell < _MIN_CONTOUR:
                continue
            middle = cells[np.argmin(((cells - cells.mean(axis=0)) ** 2).sum(axis=1))]
            cell = tuple(int(i) for i in stand[np.argmin(((stand - middle) ** 2).sum(axis=1))])
            best = self._better(map, best, (cell[0], cell[1]), distance, discovers=True)
        return best

    def _best_view(self, map: MapState, distance: np.ndarray) -> Target | None:
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
        gain = float((self._gain(map, cell) if discovers else self._views(map, cell)).sum())
        if discovers and gain < _MIN_GAIN:
            return best
        utility = gain / self._steps(map, cell, float(distance[cell]))
        if best is not None and best.utility >= utility:
            return best
        return Target(cell, cell_to_world(np.array(cell), map.origin, map.cell), gain, utility, discovers)

    def _steps(self, map: MapState, cell: tuple[int, int], metres: float) -> float:
        x, y, heading = planar_from_pose(map.pose)
        point = cell_to_world(np.array(cell), map.origin, map.cell)
        turn = abs(wrap_angle(float(np.arctan2(point[1] - y, point[0] - x)) - heading))
        return metres / FORWARD_STEP + turn / TURN_ANGLE + _OVERHEAD

    def _gain(self, map: MapState, cell: tuple[int, int]) -> np.ndarray:
        rays = unknown_area(map.explored, map.occupied, *cell, _NEAR / map.cell, _REACH / map.cell)
        return rays * map.cell**2

    def _views(self, map: MapState, cell: tuple[int, int]) -> np.ndarray:
        return (
            new_views(map.explored, map.occupied, map.viewpoints, *cell, _NEAR / map.cell, _VIEW_REACH / map.cell)
            * map.cell**2
        )

    def _distance(self, map: MapState, target: Target) -> float:
        return float(np.linalg.norm(map.pose[:2, 3] - target.point))


def travel_from_robot(map: MapState) -> np.ndarray:
    """(M, M) metres from the robot over explored ground that its body fits on; infinite elsewhere.

    Example:
        >>> from autonerf_lab.geometry import planar_pose
        >>> from autonerf_lab.mapping import empty_map
        >>> bool(np.isinf(travel_from_robot(empty_map(planar_pose(0, 0, 0)))).all())  # nothing is explored yet
        True
    """
    radius = round(AGENT_RADIUS / map.cell)
    free = (map.explored & ~dilate(map.occupied, radius + 0.5)) | map.visited
    start = world_to_cell(map.pose[:2, 3], map.origin, map.cell)
    return travel_distance(free, start[None], map.cell)


def _border(mask: np.ndarray) -> np.ndarray:
    """Set cells with an unset one above, below, left or right."""
    inner = mask.copy()
    inner[1:] &= mask[:-1]
    inner[:-1] &= mask[1:]
    inner[:, 1:] &= mask[:, :-1]
    inner[:, :-1] &= mask[:, 1:]
    return mask & ~inner
