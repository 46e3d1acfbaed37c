"""``AutoNeRF/Explore-v0``: the three actions, images and the map."""

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from autonerf_lab.classes import NUM_CLASSES
from autonerf_lab.geometry import Intrinsics, world_to_cell
from autonerf_lab.mapping import empty_map, update
from autonerf_lab.rewards import Reward, make_reward
from autonerf_lab.scenes import Scene, load_scene
from autonerf_lab.simulator import Noise, Simulator
from autonerf_lab.types import Action, MapState, Observation, Transition

MAX_DEPTH = 100.0  # metres; farther surfaces read this
WINDOW_METRES = 12.0
_CACHED_SCENES = 4


class ExploreEnv(gymnasium.Env[dict[str, np.ndarray], np.int64]):
    """Explore an apartment; the reward is what one step adds to the map.

    Observation, a dict: ``rgb`` (S, S, 3) uint8, ``depth`` (S, S) float32 metres, ``semantics`` (S, S) uint8, ``pose``
    (4, 4) float64 by odometry, ``map`` (5, W, W) uint8: the part of the map around the robot, north up in rows of
    growing y: occupied, explored, the robot's cell, visited, class (0 = none). ``info`` holds
    ``explored_m2``, ``collided`` and the name of the ``scene``; the whole map is ``env.unwrapped.map``.

    The episode never terminates; it is truncated after ``max_steps``.

    Args:
        scene: a name, a scene, or several of them: one is drawn at every reset.
        reward: a name of :data:`autonerf_lab.rewards.REWARDS` or a reward.
        max_steps: actions an episode.
        size: S, pixels a side.
        rgb: False leaves ``rgb`` black, which is several times faster.
        supersample: samples a pixel side of ``rgb``.
        map_size: cells a side of the whole map, 24 m wide: 480 are 5 cm each.
        noise: of motion and odometry.
        render_mode: None or ``"rgb_array"``, the robot's view.

    Raises:
        UnknownNameError: no such scene or reward.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012 - gymnasium's own attribute

    def __init__(
        self,
        scene: str | Scene | Sequence[str | Scene] = "train-00",
        reward: str | Reward = "cov",
        max_steps: int = 1500,
        size: int = 64,
        rgb: bool = True,
        supersample: int = 1,
        map_size: int = 480,
        noise: Noise | None = None,
        render_mode: str | None = None,
    ) -> None:
        self._scenes: list[str | Scene] = [scene] if isinstance(scene, str | Scene) else list(scene)
        if not self._scenes:
            raise ValueError("at least one scene is needed")
        self._reward = make_reward(reward)
        self._max_steps = max_steps
        self._intrinsics = Intrinsics.from_fov(size, size)
        self._rgb, self._supersample, self._noise = rgb, supersample, noise
        self._map_size, self._cell = map_size, 2 * WINDOW_METRES / map_size
        self._window = map_size // 2
        self._simulators: dict[int, Simulator] = {}
        self._map: MapState | None = None
        self._observation: Observation | None = None
        self._sim = self._simulator(0)  # a wrong name fails here, not at the first reset
        self.render_mode = render_mode
        image = (size, size)
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

    @property
    def map(self) -> MapState:
        """Everything seen in this episode."""
        assert self._map is not None, "reset the environment first"
        return self._map

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Start an episode: in a drawn scene, at a drawn pose."""
        super().reset(seed=seed)
        self._sim = self._simulator(int(self.np_random.integers(len(self._scenes))))
        self._observation = self._sim.reset(seed=int(self.np_random.integers(2**31)))
        start = empty_map(self._observation.pose, self._map_size, self._cell)
        self._map = update(start, self._observation, self._intrinsics)
        forget = getattr(self._reward, "reset", None)
        if forget is not None:
            forget(self.np_random)
        return self._seen(), self._info()

    def step(self, action: np.int64) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """One action."""
        before = self.map
        self._observation = self._sim.step(int(action))
        self._map = update(before, self._observation, self._intrinsics)
        reward = self._reward(Transition(before, self._map, self._observation, int(action)))
        return self._seen(), reward, False, self._observation.step >= self._max_steps, self._info()

    def render(self) -> np.ndarray | None:  # type: ignore[override]
        """The robot's view, (S, S, 3) uint8, in the mode ``rgb_array``."""
        if self.render_mode != "rgb_array" or self._observation is None:
            return None
        return self._observation.rgb if self._rgb else self._sim.render(self._sim.pose).rgb

    def _simulator(self, index: int) -> Simulator:
        if index not in self._simulators:
            if len(self._simulators) >= _CACHED_SCENES:
                self._simulators.pop(next(iter(self._simulators)))
            scene = self._scenes[index]
            loaded = load_scene(scene) if isinstance(scene, str) else scene
            self._simulators[index] = Simulator(loaded, self._intrinsics, self._supersample, self._rgb, self._noise)
        return self._simulators[index]

    def _seen(self) -> dict[str, np.ndarray]:
        assert self._observation is not None
        return {
            "rgb": self._observation.rgb,
            "depth": np.minimum(self._observation.depth, np.float32(MAX_DEPTH)),
            "semantics": self._observation.semantics,
            "pose": self._observation.pose,
            "map": local_window(self.map, self._window),
        }

    def _info(self) -> dict[str, Any]:
        assert self._observation is not None
        return {
            "explored_m2": float(np.count_nonzero(self.map.explored)) * self._cell**2,
            "collided": self._observation.collided,
            "scene": self._sim.scene.name,
        }


def local_window(map: MapState, window: int) -> np.ndarray:
    """The map around the robot; near the border of the map the window stops and the robot leaves its middle.

    Returns:
        (5, window, window) uint8: occupied, explored, the robot's cell, visited, class (the highest one in the cell).
    """
    size = len(map.explored)
    robot = np.clip(world_to_cell(map.pose[:2, 3], map.origin, map.cell), 0, size - 1)
    top, left = (int(i) for i in np.clip(robot - window // 2, 0, size - window))
    view = (slice(top, top + window), slice(left, left + window))
    out = np.zeros((5, window, window), np.uint8)
    out[0], out[1], out[3] = map.occupied[view], map.explored[view], map.visited[view]
    out[2, robot[0] - top, robot[1] - left] = 1
    for k, mask in enumerate(map.semantics):
        out[4][mask[view]] = k + 1
    return out
