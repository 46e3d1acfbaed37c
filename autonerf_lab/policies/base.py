"""What every policy can do."""

from typing import Protocol

import numpy as np

from autonerf_lab.types import MapState, Observation


class Policy(Protocol):
    """Chooses actions from what the robot has seen; knows nothing else of the scene."""

    @property
    def waypoint(self) -> np.ndarray | None:
        """(2,) world x, y the robot is heading for; None for a policy without waypoints."""

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode; all randomness comes from ``rng``."""

    def act(self, map: MapState, observation: Observation) -> int:
        """The next :class:`~autonerf_lab.types.Action`; ``map`` already holds ``observation``."""
