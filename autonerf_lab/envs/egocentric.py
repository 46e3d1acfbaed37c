"""``AutoNeRF/Egocentric-v0``: environment of the end-to-end policies (Ramakrishnan et al. 2021, section 4)."""

from typing import Any

import numpy as np

from autonerf_lab.envs.base import MappingEnv, ObsDict
from autonerf_lab.policies.egocentric import EgocentricInterface
from autonerf_lab.policies.interfaces import WINDOW_METRES


class EgocentricEnv(MappingEnv[np.int64]):
    """Exploration from images and egocentric maps.

    Action space: ``Discrete(3)``: 0 forward 25 cm, 1 turn left, 2 turn right by 30 degrees.

    Observation space: ``Dict``, see :class:`~autonerf_lab.policies.egocentric.EgocentricInterface`: ``rgb``
    (3, 84, 84) uint8, ``near`` and ``far`` (2, 32, 32) uint8, ``felt`` (4,) float32.

    Rewards: the chosen reward of every step; ``cov`` is the newly explored area in m².

    Starting state: a random scene and a random navigable pose.

    Episode end: truncated after ``max_steps`` actions; never terminated.

    Info: ``explored_m2``, ``collided``, ``path_m`` and ``scene``, as in
    :class:`~autonerf_lab.envs.explore.ExploreEnv`.

    Version: v0.

    Args:
        options: arguments of :class:`~autonerf_lab.envs.base.MappingEnv` and its base class. Default ``size`` 84, cells
            of 10 cm.
    """

    def __init__(self, **options: Any) -> None:
        self._interface = EgocentricInterface()
        super().__init__(
            **{"size": self._interface.IMAGE, "window": round(WINDOW_METRES / self._interface.cell), **options}
        )
        self.action_space = self._interface.action_space
        self.observation_space = self._interface.observation_space  # type: ignore[assignment]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[ObsDict, dict[str, Any]]:
        """Start an episode in a random scene at a random pose."""
        observation = self._begin(seed)
        return self._interface.observe(self.map, observation, None), self._info()

    def step(self, action: np.int64) -> tuple[ObsDict, float, bool, bool, dict[str, Any]]:
        """Apply one action."""
        reward = self._advance(int(action))
        return self._interface.observe(self.map, self.observation, int(action)), reward, False, self._over, self._info()
