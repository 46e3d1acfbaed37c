"""Base classes of the environments: a scene sampled at every reset, a robot in it, and its map."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, Generic, TypeVar

import gymnasium
import numpy as np

from autonerf_lab.geometry import Intrinsics
from autonerf_lab.mapping import Mapper, empty_map
from autonerf_lab.policies.interfaces import MAP_WINDOWS, WINDOW_METRES
from autonerf_lab.rewards import PrivilegedReward, Reward, evaluate, make_reward, name_of, reset_reward
from autonerf_lab.scenes import Scene, load_scene, scene_names
from autonerf_lab.segmentation import TRUE, Segmenter
from autonerf_lab.simulator import MotionNoise, Simulator
from autonerf_lab.types import MapState, Observation, Transition, read_only

ObsDict = dict[str, Any]  # observation of an environment
ActType = TypeVar("ActType")


@lru_cache(maxsize=32)
def _shared(name: str) -> Scene:
    """Load a library scene once per process, because baking its texture takes longer than an episode."""
    return load_scene(name)


class SceneEnv(gymnasium.Env[ObsDict, ActType], Generic[ActType]):
    """Environment of a robot in a scene that is sampled at every reset.

    Args:
        scene: name of a scene, a scene, or a sequence of both; None for the 25 training scenes.
        size: S, pixels a side of the robot's images.
        rgb: False leaves the color images black, which is several times faster.
        supersample: samples per pixel side of the color images.
        noise: noise of actuation and odometry, or the name of its model, such as ``"ans"``; None for no noise.
        depth_noise: noise of the depth images, ``"redwood"``; None for no noise.
        semantics: source of the classes that robot, map and reward see: ``"true"``, ``"predicted"``, ``"noisy"``, or
            another segmenter. A segmenter needs colours, so that ``rgb`` has no effect.
        render_mode: None, or ``"rgb_array"`` for the robot's color image.

    Raises:
        UnknownNameError: unknown scene, noise or segmenter.
        ValueError: no scene, or an unknown render mode.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012 - gymnasium's own attribute

    def __init__(
        self,
        scene: str | Scene | Sequence[str | Scene] | None = None,
        size: int = 64,
        rgb: bool = True,
        supersample: int = 1,
        noise: MotionNoise | str | None = None,
        render_mode: str | None = None,
        depth_noise: str | None = None,
        semantics: str | Segmenter = TRUE,
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(f"render_mode must be None or 'rgb_array', not {render_mode!r}")
        chosen = scene_names("train") if scene is None else scene
        self._scenes: list[str | Scene] = [chosen] if isinstance(chosen, str | Scene) else list(chosen)
        if not self._scenes:
            raise ValueError("scene must name at least one scene, not an empty sequence")
        self._intrinsics = Intrinsics.from_fov(size, size)
        self._rgb, self._supersample, self._noise, self._depth_noise = rgb, supersample, noise, depth_noise
        self._semantics = semantics
        self._simulators: dict[int, Simulator] = {}
        for name in {s for s in self._scenes if isinstance(s, str)} - set(scene_names()):
            load_scene(name)  # an unknown name fails here and not at a later reset
        self._sim = self._simulator(0)
        self._observation: Observation | None = None
        self.render_mode = render_mode

    @property
    def sim(self) -> Simulator:
        """Simulator of the current scene."""
        return self._sim

    @property
    def observation(self) -> Observation:
        """Last observation of the robot."""
        assert self._observation is not None, "reset the environment first"
        return self._observation

    def _begin(self, seed: int | None) -> Observation:
        """Sample a scene and a start pose."""
        super().reset(seed=seed)
        self._sim = self._simulator(int(self.np_random.integers(len(self._scenes))))
        self._observation = self._sim.reset(seed=int(self.np_random.integers(2**31)))
        return self._observation

    def render(self) -> np.ndarray | None:  # type: ignore[override]
        """Return the robot's color image, (S, S, 3) uint8; None without render mode or before the first reset."""
        if self.render_mode != "rgb_array" or self._observation is None:
            return None
        return self.observation.rgb if self._rgb else self._sim.render(self._sim.pose).rgb

    def _simulator(self, index: int) -> Simulator:
        if index not in self._simulators:
            scene = self._scenes[index]
            if isinstance(scene, str):
                scene = _shared(scene) if scene in scene_names() else load_scene(scene)
            self._simulators[index] = Simulator(
                scene, self._intrinsics, self._supersample, self._rgb, self._noise, depth_noise=self._depth_noise,
                semantics=self._semantics,
            )  # fmt: skip
        return self._simulators[index]


class MappingEnv(SceneEnv[ActType]):
    """Environment of a robot that builds a map and gets a reward for each step.

    Args:
        reward: a name of :func:`autonerf_lab.rewards.available`, a weighted sum (``"cov+0.1*nov"``), or a reward.
        max_steps: number of robot actions after which the episode is truncated; it never terminates.
        window: W, cells a side of the window of the map around the robot, which is 12 m wide; 240 gives cells of 5 cm.
        options: arguments of :class:`SceneEnv`.

    Raises:
        UnknownNameError: unknown scene or reward.
        RewardError: during an episode, a reward raised or is not a finite number; names reward, value and step. At a
            reset, its ``reset`` raised.
    """

    def __init__(self, reward: str | Reward = "cov", max_steps: int = 1500, window: int = 240, **options: Any) -> None:
        super().__init__(**options)
        self.reward, self._reward_name = make_reward(reward), name_of(reward)
        self._terms: dict[str, float] = {}  # terms of a weighted sum, accumulated since the last ``info``
        self._max_steps, self._window = max_steps, window
        self._mapper: Mapper | None = None
        self._path = 0.0

    @property
    def map(self) -> MapState:
        """Map of this episode, read-only. Buffers are reused after two steps; copy to keep."""
        assert self._mapper is not None, "reset the environment first"
        return self._mapper.map

    def _begin(self, seed: int | None) -> Observation:
        observation = super()._begin(seed)
        start = empty_map(observation.pose, MAP_WINDOWS * self._window, WINDOW_METRES / self._window)
        self._mapper = Mapper(start, self._intrinsics)
        self._mapper.add(observation)
        self._path = 0.0
        reset_reward(self.reward, self.np_random, self._reward_name)
        if isinstance(self.reward, PrivilegedReward):
            self.reward.set_references([self._reference() for _ in range(self.reward.references)])
        self._terms = {}
        self._count_terms()
        return observation

    def _reference(self) -> Observation:
        """Render the scene at a random navigable pose: ground truth for a privileged reward, never for a policy."""
        pose = self._sim.sample_pose(self.np_random)
        frame = self._sim.render(pose, self._rgb)
        return read_only(Observation(frame.rgb, frame.depth, frame.semantics, pose))

    def _count_terms(self) -> None:
        for name, value in getattr(self.reward, "terms", dict)().items():
            self._terms[name] = self._terms.get(name, 0.0) + value

    def _advance(self, action: int) -> float:
        """Apply one action, update the map and return the reward."""
        assert self._mapper is not None, "reset the environment first"
        before_move = self._sim.pose[:2, 3]
        self._observation = observation = self._sim.step(action)
        self._path += float(np.linalg.norm(self._sim.pose[:2, 3] - before_move))
        before, after = self._mapper.add(observation)
        transition = Transition(before, after, read_only(observation), action)
        reward = evaluate(self.reward, transition, self._reward_name)
        self._count_terms()
        return reward

    @property
    def _over(self) -> bool:
        return self.observation.step >= self._max_steps

    def _info(self) -> dict[str, Any]:
        info = {
            "explored_m2": float(np.count_nonzero(self.map.explored)) * self.map.cell**2,
            "collided": self.observation.collided,
            "path_m": self._path,
            "scene": self._sim.scene.name,
        }
        terms, self._terms = self._terms, {}
        return info | {"reward_terms": terms} if terms else info
