"""``AutoNeRF/Explore-v0``: the three actions, images and the map."""

from typing import Any

import numpy as np
from gymnasium import spaces

from autonerf_lab.classes import NUM_CLASSES
from autonerf_lab.envs.base import MappingEnv, Seen
from autonerf_lab.policies.interfaces import place_of, window_of
from autonerf_lab.types import Action, MapState

MAX_DEPTH = 100.0  # metres; farther surfaces read this


class ExploreEnv(MappingEnv[np.int64]):
    """Explore an apartment; the reward is what one step adds to the map.

    Observation, a dict: ``rgb`` (S, S, 3) uint8, ``depth`` (S, S) float32 metres, ``semantics`` (S, S) uint8, ``pose``
    (4, 4) float64 by odometry, ``map`` (5, W, W) uint8: the part of the map around the robot, north up in rows of
    growing y: occupied, explored, the robot's cell, visited, class (0 = none). ``info`` holds ``explored_m2``,
    ``collided``, ``path_m`` and the name of the ``scene``; the whole map is ``env.unwrapped.map``.

    Args:
        options: of :class:`~autonerf_lab.envs.base.MappingEnv`: scene, reward, max_steps, window, size, rgb, ...
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        image = (self._intrinsics.height, self._intrinsics.width)
        self.action_space = spaces.Discrete(len(Action))
        self.observation_space: spaces.Dict = spaces.Dict(  # type: ignore[assignment]
            {
                "rgb": spaces.Box(0, 255, (*image, 3), np.uint8),
                "depth": spaces.Box(0, MAX_DEPTH, image, np.float32),
                "semantics": spaces.Box(0, NUM_CLASSES - 1, image, np.uint8),
                "pose": spaces.Box(-1e6, 1e6, (4, 4), np.float64),
                "map": spaces.Box(0, NUM_CLASSES - 1, (5, self._window, self._window), np.uint8),
            }
        )

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Seen, dict[str, Any]]:
        """Start an episode: in a drawn scene, at a drawn pose."""
        self._begin(seed)
        return self._seen(), self._info()

    def step(self, action: np.int64) -> tuple[Seen, float, bool, bool, dict[str, Any]]:
        """One action."""
        reward = self._advance(int(action))
        return self._seen(), reward, False, self._over, self._info()

    def _seen(self) -> Seen:
        return {
            "rgb": self.observation.rgb,
            "depth": np.minimum(self.observation.depth, np.float32(MAX_DEPTH)),
            "semantics": self.observation.semantics,
            "pose": self.observation.pose,
            "map": local_window(self.map, self._window),
        }


def local_window(map: MapState, window: int) -> np.ndarray:
    """The map around the robot.

    Returns:
        (5, window, window) uint8: occupied, explored, the robot's cell, visited, class (the highest one in the cell).
    """
    view = window_of(map, window)
    out = np.zeros((5, window, window), np.uint8)
    out[0], out[1], out[2], out[3] = map.occupied[view], map.explored[view], place_of(map)[view], map.visited[view]
    for k, mask in enumerate(map.semantics):
        out[4][mask[view]] = k + 1
    return out
