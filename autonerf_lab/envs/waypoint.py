"""``AutoNeRF/Waypoint-v0``: the world of the modular global policy (section 3.1). One action is one waypoint."""

from typing import Any

import numpy as np
from gymnasium import spaces

from autonerf_lab.classes import NUM_CLASSES
from autonerf_lab.envs.base import MAP_WINDOWS, MappingEnv, Seen, place_of, window_of
from autonerf_lab.geometry import planar_from_pose
from autonerf_lab.mapping.semantic_map import VIEWPOINT_BINS
from autonerf_lab.planning import LocalPolicy
from autonerf_lab.types import MapState

FOLLOW_STEPS = 25  # actions of the local policy a waypoint
HEADINGS = 72


class WaypointEnv(MappingEnv[np.ndarray]):
    """Choose where to go; fast marching leads the robot there for 25 steps, and their rewards are added up.

    Action: (2,) float32 in [-1, 1], x and y across the window of the map around the robot; 0 is its middle.

    Observation, a dict: ``map`` (C, W, W) uint8 of 0 and 1, see :func:`global_input`; ``heading``, one of 72 bins,
    counter-clockwise from +x. ``info`` holds ``explored_m2``, ``collisions`` on the way, ``path_m``, ``waypoint`` (its
    world x, y) and the name of the ``scene``; the whole map is ``env.unwrapped.map``.

    Args:
        viewpoints: add the viewpoint channels, which only the reward ``view`` needs.
        options: of :class:`~autonerf_lab.envs.base.MappingEnv`. Colours are off unless asked for.
    """

    def __init__(self, viewpoints: bool = False, rgb: bool = False, **options: Any) -> None:
        super().__init__(rgb=rgb, **options)
        self._viewpoints = viewpoints
        self._local = LocalPolicy()
        channels = 8 + NUM_CLASSES + 2 * VIEWPOINT_BINS * viewpoints
        self.action_space = spaces.Box(-1, 1, (2,), np.float32)
        self.observation_space: spaces.Dict = spaces.Dict(  # type: ignore[assignment]
            {
                "map": spaces.Box(0, 1, (channels, self._window, self._window), np.uint8),
                "heading": spaces.Discrete(HEADINGS),
            }
        )

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Seen, dict[str, Any]]:
        """Start an episode: in a drawn scene, at a drawn pose."""
        self._begin(seed)
        self._local.reset()
        x, y, _ = planar_from_pose(self.map.pose)
        return self._seen(), self._info() | {"collisions": 0, "waypoint": np.array([x, y])}

    def step(self, action: np.ndarray) -> tuple[Seen, float, bool, bool, dict[str, Any]]:
        """Follow one waypoint, for 25 steps or to the end of the episode."""
        waypoint = self._waypoint(np.asarray(action, dtype=np.float64))
        reward, collisions = 0.0, 0
        for _ in range(FOLLOW_STEPS):
            reward += self._advance(int(self._local.act(self.map, waypoint)))
            assert self._observation is not None
            collisions += self._observation.collided
            if self._over:
                break
        info = self._info() | {"collisions": collisions, "waypoint": waypoint}
        return self._seen(), reward, False, self._over, info

    def _waypoint(self, action: np.ndarray) -> np.ndarray:
        rows, cols = window_of(self.map, self._window)
        cell = (np.clip(action, -1, 1) + 1) / 2 * self._window + np.array([cols.start, rows.start])
        return self.map.origin + cell * self.map.cell

    def _seen(self) -> Seen:
        heading = planar_from_pose(self.map.pose)[2] % (2 * np.pi)
        return {
            "map": global_input(self.map, self._window, self._viewpoints),
            "heading": np.int64(int(heading / (2 * np.pi) * HEADINGS) % HEADINGS),
        }


def global_input(map: MapState, window: int, viewpoints: bool = False) -> np.ndarray:
    """What the global policy sees (section 3.1 and the released code).

    Returns:
        (24, window, window) uint8: occupied, explored, the robot's cell and where it has been, around the robot; the
        same four of the whole map, the maximum of 3x3 cells each; then 15 classes and what is occupied without a class,
        around the robot. With ``viewpoints`` 12 directions around the robot and 12 of the whole map follow.
    """
    view = window_of(map, window)
    state = np.stack([map.occupied, map.explored, place_of(map).astype(bool), map.visited])
    nameless = map.occupied[view] & ~map.semantics[(slice(None), *view)].any(axis=0)
    parts = [state[(slice(None), *view)], _pooled(state), map.semantics[(slice(None), *view)], nameless[None]]
    if viewpoints:
        parts += [map.viewpoints[(slice(None), *view)], _pooled(map.viewpoints)]
    return np.concatenate(parts).view(np.uint8)


def _pooled(channels: np.ndarray) -> np.ndarray:
    size = channels.shape[1] // MAP_WINDOWS
    blocks = channels.reshape(len(channels), size, MAP_WINDOWS, size, MAP_WINDOWS)
    return np.asarray(blocks.any(axis=(2, 4)))
