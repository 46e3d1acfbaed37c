"""The end-to-end policies: images and egocentric maps to actions, by a recurrent network."""

import numpy as np
import torch

from autonerf_lab.policies.egocentric import EgocentricView
from autonerf_lab.policies.networks import EgocentricNetwork, batched, draw
from autonerf_lab.types import MapState, Observation


class EndToEnd:
    """An action every step, drawn from what the network says.

    Args:
        view: what the network sees.
        network: of the view.

    Example:
        >>> from autonerf_lab.geometry import planar_pose
        >>> from autonerf_lab.mapping import empty_map
        >>> pose = planar_pose(0, 0, 0)
        >>> policy = EndToEnd(EgocentricView(), EgocentricNetwork())
        >>> policy.reset(np.random.default_rng(0))
        >>> seen = Observation(np.zeros((84, 84, 3), np.uint8), np.zeros((84, 84)), np.zeros((84, 84)), pose)
        >>> policy.act(empty_map(pose), seen) in (0, 1, 2)
        True
    """

    waypoint: np.ndarray | None = None

    def __init__(self, view: EgocentricView, network: EgocentricNetwork) -> None:
        self.view, self.network = view, network.eval()
        self.reset(np.random.default_rng(0))

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode."""
        self._rng = rng
        self._last: int | None = None
        self._memory = self.network.nothing(1)

    def act(self, map: MapState, observation: Observation) -> int:
        """The next action."""
        seen = self.view.see(map, observation, self._last)
        with torch.inference_mode():
            chances, _, self._memory = self.network(batched([seen]), self._memory, torch.zeros(1))
        self._last = int(draw(chances, self._rng))
        return self._last
