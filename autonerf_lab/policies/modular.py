"""The modular policy of section 3.1: a learned global policy chooses waypoints, fast marching leads there."""

import numpy as np
import torch

from autonerf_lab.planning.local_policy import LocalPolicy
from autonerf_lab.policies.interfaces import View, done
from autonerf_lab.policies.networks import batched, draw
from autonerf_lab.types import Action, MapState, Observation


class Modular:
    """A waypoint every few steps, in the paper 25, drawn from what the global policy says; before the first, where the
    view asks for it, a look around.

    Args:
        view: what the network sees.
        network: of the view.

    Example:
        >>> from autonerf_lab.geometry import planar_pose
        >>> from autonerf_lab.mapping import empty_map
        >>> from autonerf_lab.policies.networks import CompactNetwork
        >>> from autonerf_lab.policies.interfaces import CompactView
        >>> pose = planar_pose(0, 0, 0)
        >>> policy = Modular(CompactView(), CompactNetwork())
        >>> policy.reset(np.random.default_rng(0))
        >>> seen = Observation(np.zeros((1, 1, 3)), np.zeros((1, 1)), np.zeros((1, 1)), pose)
        >>> policy.act(empty_map(pose), seen) in (0, 1, 2)
        True
    """

    def __init__(self, view: View, network: torch.nn.Module) -> None:
        self.view, self.network = view, network.eval()
        self.reset(np.random.default_rng(0))

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode."""
        self._rng = rng
        self.view.reset()
        self._local = LocalPolicy()
        self._age, self._turns = 0, self.view.opening
        self.waypoint: np.ndarray | None = None

    def act(self, map: MapState, observation: Observation) -> int:
        """Towards the waypoint."""
        if self._turns:
            self._turns -= 1
            return Action.TURN_LEFT
        if self.waypoint is None or done(self.view, self.waypoint, map, self._age):
            self.waypoint = self._choose(map)
            self._age = 0
        self._age += 1
        return self._local.act(map, self.waypoint)

    def _choose(self, map: MapState) -> np.ndarray:
        with torch.inference_mode():
            action = draw(self.network(batched([self.view.see(map)]))[0], self._rng)
        return self.view.waypoint(action, map)
