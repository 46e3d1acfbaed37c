"""Frontier exploration as the paper's baseline does it (Ramakrishnan et al. 2021, *An Exploration of Embodied Visual
Exploration*): without an estimate of what a frontier will reveal.

A frontier cell is free ground with an unexplored 4-neighbour. The target is a random cell on one of the three longest
contours of frontier cells. A new one is chosen when the robot has reached the target, when the target turns out to be
occupied, after two steps in which no path leads to it, and after 200 steps. Without frontier cells the target is a
random cell of the reachable ground, so that the episode goes on.

Contours that the planner cannot reach when the target is chosen do not count: maps have many of them, under furniture
and behind window panes, and the robot would stand before them for 200 steps.
"""

import numpy as np
from scipy import ndimage

from autonerf_lab.geometry import cell_to_world, world_to_cell
from autonerf_lab.planning.dilation import nearest_set_cell
from autonerf_lab.planning.local_policy import LocalPolicy
from autonerf_lab.policies.frontier import path_lengths_from_robot, reachable_frontier
from autonerf_lab.types import MapState, Observation

_CONTOURS = 3  # longest contours among which the target is drawn
_MAX_FAILURES = 2  # steps without a path to the target
_MAX_STEPS = 200  # per target
_ARRIVED = 0.35  # metres


class FrontierClassic:
    """Frontier exploration that draws its target from the three longest contours.

    Source: Ramakrishnan et al. 2021, whose baseline the paper takes over.

    Example:
        >>> from autonerf_lab.geometry import Intrinsics
        >>> from autonerf_lab.scenes import load_scene
        >>> from autonerf_lab.simulator import Simulator
        >>> from autonerf_lab.exploration import explore
        >>> sim = Simulator(load_scene("train-00"), Intrinsics.from_fov(32, 32), rgb=False)
        >>> len(explore(sim, FrontierClassic(), steps=5, progress=False))
        5
    """

    def __init__(self) -> None:
        self.reset(np.random.default_rng(0))

    @property
    def waypoint(self) -> np.ndarray | None:
        """Current target, (2,) world x, y in metres; None before the first."""
        return self._point

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode."""
        self._rng = rng
        self._local = LocalPolicy()
        self._point: np.ndarray | None = None
        self._age = 0
        self._failures = 0

    def act(self, map: MapState, observation: Observation) -> int:
        """Return the next action towards the target."""
        if self._point is None or self._done(map, self._point):
            self._point = cell_to_world(np.array(_target(map, self._rng)), map.origin, map.cell)
            self._age = self._failures = 0
        action = self._local.act(map, self._point)
        self._age += 1
        self._failures += self._local.blocked
        return action

    def _done(self, map: MapState, point: np.ndarray) -> bool:
        reached = float(np.linalg.norm(map.pose[:2, 3] - point)) < _ARRIVED or (self._age > 0 and self._local.arrived)
        cell = world_to_cell(point, map.origin, map.cell)  # the map may have grown
        return reached or bool(map.occupied[tuple(cell)]) or self._failures >= _MAX_FAILURES or self._age >= _MAX_STEPS


def _target(map: MapState, rng: np.random.Generator) -> tuple[int, int]:
    """Return the standing place nearest to a random cell of one of the longest contours, or a random standing place."""
    distance = path_lengths_from_robot(map)
    standing = np.argwhere(np.isfinite(distance))
    labels, count = ndimage.label(reachable_frontier(map, distance), np.ones((3, 3)))
    cells = standing
    if count:
        lengths = np.bincount(labels.ravel())[1:]
        longest = np.argsort(-lengths, kind="stable")[:_CONTOURS]
        cells = np.argwhere(labels == 1 + rng.choice(longest))
    return nearest_set_cell(np.isfinite(distance), *cells[rng.integers(len(cells))])
