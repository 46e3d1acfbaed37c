"""Modular policy of section 3.1: a learned global policy chooses waypoints, a local policy follows them."""

import numpy as np
import torch

from autonerf_lab.policies.interfaces import PolicyInterface
from autonerf_lab.policies.networks import batched, sample_action
from autonerf_lab.policies.waypoints import WaypointPolicy
from autonerf_lab.types import MapState


class Modular(WaypointPolicy):
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
        >>> from autonerf_lab.types import Observation
        >>> observation = Observation(np.zeros((1, 1, 3)), np.zeros((1, 1)), np.zeros((1, 1)), pose)
        >>> policy.act(empty_map(pose), observation) in (0, 1, 2)
        True
    """

    def __init__(self, interface: PolicyInterface, network: torch.nn.Module) -> None:
        self.interface, self.network = interface, network.eval()
        self.follow, self.arrival = interface.follow, interface.arrival
        self.initial_turns = interface.initial_turns
        self.reset(np.random.default_rng(0))

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode."""
        super().reset(rng)
        self.interface.reset()

    def choose(self, map: MapState) -> np.ndarray:
        """Sample a waypoint from the network."""
        with torch.inference_mode():
            action = sample_action(self.network(batched([self.interface.observe(map)]))[0], self._rng)
        return self.interface.to_waypoint(action, map)
