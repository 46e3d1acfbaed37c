"""Modular policy of section 3.1: a learned global policy chooses waypoints, a local policy follows them."""

import numpy as np
import torch

from autonerf_lab.planning.local_policy import LocalPolicy
from autonerf_lab.policies.interfaces import PolicyInterface, waypoint_finished
from autonerf_lab.policies.networks import batched, sample_action
from autonerf_lab.types import Action, MapState, Observation


class Modular:
    """Policy that samples a waypoint from a network every few steps (25 in the paper) and follows it by fast marching.

    Before the first waypoint it makes the initial turns of the interface.

    Args:
        interface: encodes the observations and decodes the actions of the network.
        network: network for this interface.

    Example:
        >>> from autonerf_lab.geometry import planar_pose
        >>> from autonerf_lab.mapping import empty_map
        >>> from autonerf_lab.policies.networks import CompactNetwork
        >>> from autonerf_lab.policies.interfaces import CompactInterface
        >>> pose = planar_pose(0, 0, 0)
        >>> policy = Modular(CompactInterface(), CompactNetwork())
        >>> policy.reset(np.random.default_rng(0))
        >>> observation = Observation(np.zeros((1, 1, 3)), np.zeros((1, 1)), np.zeros((1, 1)), pose)
        >>> policy.act(empty_map(pose), observation) in (0, 1, 2)
        True
    """

    def __init__(self, interface: PolicyInterface, network: torch.nn.Module) -> None:
        self.interface, self.network = interface, network.eval()
        self.reset(np.random.default_rng(0))

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode."""
        self._rng = rng
        self.interface.reset()
        self._local = LocalPolicy()
        self._age, self._turns = 0, self.interface.initial_turns
        self.waypoint: np.ndarray | None = None

    def act(self, map: MapState, observation: Observation) -> int:
        """Return the next action towards the waypoint."""
        if self._turns:
            self._turns -= 1
            return Action.TURN_LEFT
        if self.waypoint is None or waypoint_finished(self.interface, self.waypoint, map, self._age):
            self.waypoint = self._choose(map)
            self._age = 0
        self._age += 1
        return self._local.act(map, self.waypoint)

    def _choose(self, map: MapState) -> np.ndarray:
        with torch.inference_mode():
            action = sample_action(self.network(batched([self.interface.observe(map)]))[0], self._rng)
        return self.interface.to_waypoint(action, map)
