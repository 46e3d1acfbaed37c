"""End-to-end policies: a recurrent network from images and egocentric maps to actions."""

import numpy as np
import torch

from autonerf_lab.policies.egocentric import EgocentricInterface
from autonerf_lab.policies.networks import EgocentricNetwork, batched, sample_action
from autonerf_lab.types import MapState, Observation


class EndToEnd:
    """Policy that samples every action from the distribution of a recurrent network.

    Args:
        interface: encodes the observations of the network.
        network: network for this interface.

    Example:
        >>> from autonerf_lab.geometry import planar_pose
        >>> from autonerf_lab.mapping import empty_map
        >>> pose = planar_pose(0, 0, 0)
        >>> policy = EndToEnd(EgocentricInterface(), EgocentricNetwork())
        >>> policy.reset(np.random.default_rng(0))
        >>> observation = Observation(np.zeros((84, 84, 3), np.uint8), np.zeros((84, 84)), np.zeros((84, 84)), pose)
        >>> policy.act(empty_map(pose), observation) in (0, 1, 2)
        True
    """

    waypoint: np.ndarray | None = None

    def __init__(self, interface: EgocentricInterface, network: EgocentricNetwork) -> None:
        self.interface, self.network = interface, network.eval()
        self.reset(np.random.default_rng(0))

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode."""
        self._rng = rng
        self._last: int | None = None
        self._memory = self.network.initial_state(1)

    def act(self, map: MapState, observation: Observation) -> int:
        """Return the next action."""
        obs = self.interface.observe(map, observation, self._last)
        with torch.inference_mode():
            distribution, _, self._memory = self.network(batched([obs]), self._memory, torch.zeros(1))
        self._last = int(sample_action(distribution, self._rng))
        return self._last
