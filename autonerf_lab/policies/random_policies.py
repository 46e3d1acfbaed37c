"""Random baselines, which use neither the map nor the observation to decide."""

import numpy as np

from autonerf_lab.geometry import cell_to_world
from autonerf_lab.policies.interfaces import FOLLOW_STEPS
from autonerf_lab.policies.waypoints import WaypointPolicy
from autonerf_lab.types import Action, MapState, Observation

_WINDOW = 240  # cells a side of the window around the robot, as in the paper


class RandomActions:
    """Baseline that samples the three actions uniformly."""

    waypoint: np.ndarray | None = None

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode."""
        self._rng = rng

    def act(self, map: MapState, observation: Observation) -> int:
        """Return a random action."""
        return int(self._rng.integers(len(Action)))


class RandomWaypoints(WaypointPolicy):
    """Baseline that follows random waypoints: a new one every 25 steps, uniform in the window around the robot."""

    follow, arrival = FOLLOW_STEPS, 0.0

    def choose(self, map: MapState) -> np.ndarray:
        """Sample a cell of the window, which is shifted to stay inside the map."""
        size = len(map.explored)
        half = min(_WINDOW, size) // 2
        centre = np.clip((map.pose[:2, 3] - map.origin) // map.cell, half, size - half)
        return cell_to_world(centre[::-1] + self._rng.uniform(-half, half, 2), map.origin, map.cell)
