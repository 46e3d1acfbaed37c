"""``AutoNeRF/Egocentric-v0``: the world of the end-to-end policies (Ramakrishnan et al. 2021, section 4)."""

from typing import Any

import numpy as np

from autonerf_lab.envs.base import MappingEnv, Seen
from autonerf_lab.policies.egocentric import EgocentricView
from autonerf_lab.policies.interfaces import WINDOW_METRES


class EgocentricEnv(MappingEnv[np.int64]):
    """The three actions, the image, and the map as it lies around the robot.

    Observations are those of :class:`~autonerf_lab.policies.egocentric.EgocentricView`. ``info`` holds ``explored_m2``,
    ``collided``, ``path_m`` and the name of the ``scene``; the whole map is ``env.unwrapped.map``.

    Args:
        options: of :class:`~autonerf_lab.envs.base.MappingEnv`.
    """

    def __init__(self, **options: Any) -> None:
        self._view = EgocentricView()
        super().__init__(**{"size": self._view.IMAGE, "window": round(WINDOW_METRES / self._view.cell), **options})
        self.action_space = self._view.action_space
        self.observation_space = self._view.observation_space  # type: ignore[assignment]

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Seen, dict[str, Any]]:
        """Start an episode: in a drawn scene, at a drawn pose."""
        observation = self._begin(seed)
        return self._view.see(self.map, observation, None), self._info()

    def step(self, action: np.int64) -> tuple[Seen, float, bool, bool, dict[str, Any]]:
        """One action."""
        reward = self._advance(int(action))
        return self._view.see(self.map, self.observation, int(action)), reward, False, self._over, self._info()
