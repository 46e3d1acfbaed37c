"""Base class of the policies that choose waypoints, which the local policy follows."""

from abc import ABC, abstractmethod

import numpy as np

from autonerf_lab.planning.local_policy import LocalPolicy
from autonerf_lab.policies.interfaces import FOLLOW_STEPS, waypoint_finished
from autonerf_lab.types import Action, MapState, Observation


class WaypointPolicy(ABC):
    """Policy that chooses a waypoint every few actions and follows it by fast marching.

    A subclass defines :meth:`choose`. The policy first turns left ``initial_turns`` times. It chooses the next waypoint
    within ``arrival`` metres of the last one, or after ``follow`` actions.
    """

    follow: int = FOLLOW_STEPS  # maximum number of actions per waypoint
    arrival: float = 0.35  # metres; 0: only ``follow`` ends a waypoint
    initial_turns = 0
    waypoint: np.ndarray | None = None

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode."""
        self._rng = rng
        self._local = LocalPolicy()
        self._age, self._turns = 0, self.initial_turns
        self.waypoint = None

    def act(self, map: MapState, observation: Observation) -> int:
        """Return the next action towards the waypoint."""
        if self._turns:
            self._turns -= 1
            return Action.TURN_LEFT
        if self.waypoint is None or waypoint_finished(self, self.waypoint, map, self._age):
            self.waypoint = self.choose(map)
            self._age = 0
        self._age += 1
        return self._local.act(map, self.waypoint)

    @abstractmethod
    def choose(self, map: MapState) -> np.ndarray:
        """Return the next waypoint, (2,) world x, y in metres."""
