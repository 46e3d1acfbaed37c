"""Interface of every exploration policy."""

from typing import Protocol, runtime_checkable

import numpy as np

from autonerf_lab.types import MapState, Observation


@runtime_checkable
class Policy(Protocol):
    """Policy that chooses actions from the robot's map and its observation; it gets no other data of the scene.

    A policy of your own needs only these three members; see ``examples/policy_plugin``.
    """

    @property
    def waypoint(self) -> np.ndarray | None:
        """Current waypoint, (2,) world x, y in metres; None for a policy without waypoints."""

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode. All random numbers of the episode come from ``rng``."""

    def act(self, map: MapState, observation: Observation) -> int:
        """Return the next :class:`~autonerf_lab.types.Action`.

        Args:
            map: map of the episode, which already contains ``observation``. Read-only; its arrays are reused after two
                steps: copy to keep.
            observation: last observation. Read-only.
        """


@runtime_checkable
class PrivilegedPolicy(Policy, Protocol):
    """Policy that also gets ground truth, the complete map of the scene: an upper bound, not a competitor."""

    def set_visible_map(self, map: MapState) -> None:
        """Receive the map of all that is visible from navigable positions; called after ``reset``."""
