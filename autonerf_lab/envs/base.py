"""What the environments share: scenes drawn at every reset, the robot in them, and the map it makes."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, Generic, TypeVar

import gymnasium
import numpy as np

from autonerf_lab.geometry import Intrinsics
from autonerf_lab.mapping import Mapper, empty_map
from autonerf_lab.policies.interfaces import MAP_WINDOWS, WINDOW_METRES
from autonerf_lab.rewards import PrivilegedReward, Reward, evaluate, make_reward, name_of
from autonerf_lab.scenes import Scene, load_scene, scene_names
from autonerf_lab.simulator import Noise, Simulator
from autonerf_lab.types import MapState, Observation, Transition

Seen = dict[str, Any]  # an observation
ActType = TypeVar("ActType")


@lru_cache(maxsize=32)
def _shared(name: str) -> Scene:
    """A frozen scene, once for all environments of this process: baking its texture takes longer than an episode."""
    return load_scene(name)


class SceneEnv(gymnasium.Env[Seen, ActType], Generic[ActType]):
    """A robot in a scene that is drawn at every reset.

    Args:
        scene: a name, a scene, or several of them; without it, the 25 training scenes.
        size: S, pixels a side of the robot's images.
        rgb: False leaves colours black, which is several times faster.
        supersample: samples a pixel side of the colours.
        noise: of motion and odometry.
        render_mode: None or ``"rgb_array"``, the robot's view.

    Raises:
        UnknownNameError: no such scene.
        ValueError: no scene at all, or a render mode that does not exist.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012 - gymnasium's own attribute

    def __init__(
        self,
        scene: str | Scene | Sequence[str | Scene] | None = None,
        size: int = 64,
        rgb: bool = True,
        supersample: int = 1,
        noise: Noise | None = None,
        render_mode: str | None = None,
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(f"render_mode must be None or 'rgb_array', not {render_mode!r}")
        chosen = scene_names("train") if scene is None else scene
        self._scenes: list[str | Scene] = [chosen] if isinstance(chosen, str | Scene) else list(chosen)
        if not self._scenes:
            raise ValueError("at least one scene is needed")
        self._intrinsics = Intrinsics.from_fov(size, size)
        self._rgb, self._supersample, self._noise = rgb, supersample, noise
        self._simulators: dict[int, Simulator] = {}
        for name in {s for s in self._scenes if isinstance(s, str)} - set(scene_names()):
            load_scene(name)  # a wrong name fails here, not at some later reset
        self._sim = self._simulator(0)
        self._observation: Observation | None = None
        self.render_mode = render_mode

    @property
    def sim(self) -> Simulator:
        """The simulator of this episode's scene."""
        return self._sim

    @property
    def observation(self) -> Observation:
        """What the robot saw last."""
        assert self._observation is not None, "reset the environment first"
        return self._observation

    def _begin(self, seed: int | None) -> Observation:
        """Draw a scene and a start."""
        super().reset(seed=seed)
        self._sim = self._simulator(int(self.np_random.integers(len(self._scenes))))
        self._observation = self._sim.reset(seed=int(self.np_random.integers(2**31)))
        return self._observation

    def render(self) -> np.ndarray | None:  # type: ignore[override]
        """The robot's view, (S, S, 3) uint8, in the mode ``rgb_array``."""
        if self.render_mode != "rgb_array" or self._observation is None:
            return None
        return self.observation.rgb if self._rgb else self._sim.render(self._sim.pose).rgb

    def _simulator(self, index: int) -> Simulator:
        if index not in self._simulators:
            scene = self._scenes[index]
            if isinstance(scene, str):
                scene = _shared(scene) if scene in scene_names() else load_scene(scene)
            self._simulators[index] = Simulator(scene, self._intrinsics, self._supersample, self._rgb, self._noise)
        return self._simulators[index]


class MappingEnv(SceneEnv[ActType]):
    """A robot that maps what it sees and is rewarded for it. The episode never terminates; it is truncated.

    Args:
        reward: a name of :func:`autonerf_lab.rewards.available`, a weighted sum (``"cov+0.1*nov"``), or a reward.
        max_steps: the robot's actions an episode.
        window: W, cells a side of the part of the map around the robot, 12 m wide: 240 are 5 cm each.
        options: of :class:`SceneEnv`.

    Raises:
        UnknownNameError: no such scene or reward.
        RewardError: in an episode, a reward failed or is not a finite float; names reward, value and step.
    """

    def __init__(self, reward: str | Reward = "cov", max_steps: int = 1500, window: int = 240, **options: Any) -> None:
        super().__init__(**options)
        self.reward, self._reward_name = make_reward(reward), name_of(reward)
        self._terms: dict[str, float] = {}  # of a sum of rewards, since ``info`` was last made
        self._max_steps, self._window = max_steps, window
        self._mapper: Mapper | None = None
        self._path = 0.0

    @property
    def map(self) -> MapState:
        """Everything seen in this episode; its arrays are those of the next step but one."""
        assert self._mapper is not None, "reset the environment first"
        return self._mapper.map

    def _begin(self, seed: int | None) -> Observation:
        observation = super()._begin(seed)
        start = empty_map(observation.pose, MAP_WINDOWS * self._window, WINDOW_METRES / self._window)
        self._mapper = Mapper(start, self._intrinsics)
        self._mapper.add(observation)
        self._path = 0.0
        forget = getattr(self.reward, "reset", None)
        if forget is not None:
            forget(self.np_random)
        if isinstance(self.reward, PrivilegedReward):
            self.reward.show([self._reference() for _ in range(self.reward.references)])
        self._terms = {}
        self._count_terms()
        return observation

    def _reference(self) -> Observation:
        """What is seen from anywhere in the scene: for a reward, and never for a policy."""
        pose = self._sim.sample_pose(self.np_random)
        frame = self._sim.render(pose, self._rgb)
        return Observation(frame.rgb, frame.depth, frame.semantics, pose)

    def _count_terms(self) -> None:
        for name, value in getattr(self.reward, "terms", dict)().items():
            self._terms[name] = self._terms.get(name, 0.0) + value

    def _advance(self, action: int) -> float:
        """One action of the robot: look, map, reward."""
        assert self._mapper is not None, "reset the environment first"
        place = self._sim.pose[:2, 3]
        self._observation = observation = self._sim.step(action)
        self._path += float(np.linalg.norm(self._sim.pose[:2, 3] - place))
        before, after = self._mapper.add(observation)
        reward = evaluate(self.reward, Transition(before, after, observation, action), self._reward_name)
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
