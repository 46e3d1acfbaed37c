"""``AutoNeRF/Explore-v0``: exploration with single actions."""

from typing import Any

import numpy as np
from gymnasium import spaces

from autonerf_lab.classes import NUM_CLASSES
from autonerf_lab.envs.base import MappingEnv, ObsDict
from autonerf_lab.policies.interfaces import robot_mask, window_slices
from autonerf_lab.types import Action, MapState

MAX_DEPTH = 100.0  # metres; larger depths are clipped


class ExploreEnv(MappingEnv[np.int64]):
    """Exploration of an apartment, one action per step.

    Action space: ``Discrete(3)``: 0 forward 25 cm, 1 turn left, 2 turn right by 30 degrees.

    Observation space: ``Dict``: ``rgb`` (S, S, 3) uint8; ``depth`` (S, S) float32, metres; ``semantics`` (S, S) uint8,
    class index; ``pose`` (4, 4) float64, camera-to-world by odometry; ``map`` (5, W, W) uint8, the window around the
    robot, rows of growing y: occupied, explored, the robot's cell, visited, class index (0 = none).

    Rewards: the chosen reward of every step; ``cov`` is the newly explored area in m².

    Starting state: a random scene and a random navigable pose.

    Episode end: truncated after ``max_steps`` actions; never terminated.

    Info: ``explored_m2``, explored area; ``collided`` in this step; ``path_m``, distance travelled; ``scene``, its
    name; ``reward_terms`` for a weighted sum. The whole map is ``env.unwrapped.map``.

    Version: v0.

    Args:
        options: arguments of :class:`~autonerf_lab.envs.base.MappingEnv` and its base class: scene, reward, max_steps,
            window, size, rgb, supersample, noise, render_mode.
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

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[ObsDict, dict[str, Any]]:
        """Start an episode in a random scene at a random pose."""
        self._begin(seed)
        return self._encode(), self._info()

    def step(self, action: np.int64) -> tuple[ObsDict, float, bool, bool, dict[str, Any]]:
        """Apply one action."""
        reward = self._advance(int(action))
        return self._encode(), reward, False, self._over, self._info()

    def _encode(self) -> ObsDict:
        return {
            "rgb": self.observation.rgb,
            "depth": np.minimum(self.observation.depth, np.float32(MAX_DEPTH)),
            "semantics": self.observation.semantics,
            "pose": self.observation.pose,
            "map": local_window(self.map, self._window),
        }


def local_window(map: MapState, window: int) -> np.ndarray:
    """Extract the window of a map around the robot.

    Returns:
        (5, window, window) uint8: occupied, explored, the robot's cell, visited, class (highest index of a cell).
    """
    view = window_slices(map, window)
    out = np.zeros((5, window, window), np.uint8)
    out[0], out[1], out[2], out[3] = map.occupied[view], map.explored[view], robot_mask(map)[view], map.visited[view]
    for k, mask in enumerate(map.semantics):
        out[4][mask[view]] = k + 1
    return out
