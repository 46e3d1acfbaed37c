"""Policies that do not look where they go: what any exploration has to beat."""

import numpy as np

from autonerf_lab.geometry import cell_to_world
from autonerf_lab.planning.local_policy import LocalPolicy
from autonerf_lab.policies.interfaces import FOLLOW_STEPS
from autonerf_lab.types import Action, MapState, Observation

_WINDOW = 240  # cells a side of the window around the robot, as they choose in


class RandomWalk:
    """The three actions with equal probability."""

    waypoint: np.ndarray | None = None

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode."""
        self._rng = rng

    def act(self, map: MapState, observation: Observation) -> int:
        """Any action."""
        return int(self._rng.integers(len(Action)))


class RandomWaypoints:
    """A waypoint drawn every 25 steps, uniform in the window around the robot, followed by the local policy."""

    waypoint: np.ndarray | None = None

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode."""
        self._rng = rng
        self._local = LocalPolicy()
        self._age = 0
        self.waypoint = None

    def act(self, map: MapState, observation: Observation) -> int:
        """Towards the waypoint."""
        if self.waypoint is None or self._age >= FOLLOW_STEPS:
            # The window slides over the map, and never over its border.
            size = len(map.explored)
            half = min(_WINDOW, size) // 2
            centre = np.clip((map.pose[:2, 3] - map.origin) // map.cell, half, size - half)
            cell = centre[::-1] + self._rng.uniform(-half, half, 2)
            self.waypoint = cell_to_world(cell, map.origin, map.cell)
            self._age = 0
        self._age += 1
        return self._local.act(map, self.waypoint)
