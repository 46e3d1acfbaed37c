"""``AutoNeRF/Waypoint-v0``: the world of the modular global policy (section 3.1). One action is one waypoint."""

from typing import Any

import numpy as np

from autonerf_lab.envs.base import MappingEnv, Seen
from autonerf_lab.geometry import planar_from_pose
from autonerf_lab.planning import LocalPolicy
from autonerf_lab.policies.interfaces import WINDOW_METRES, PaperView, View, done
from autonerf_lab.types import Action


class WaypointEnv(MappingEnv[Any]):
    """Choose where to go; fast marching leads the robot there for as many steps as the view says, in the paper 25, or
    until it arrives where the view wants that, and their rewards are added up.

    Observations and actions are those of a view: the paper's stacked maps and a point in the window without one.
    ``info`` holds ``explored_m2``, ``collisions`` on the way, ``path_m``, ``waypoint`` (its world x, y), ``steps`` (how
    many it was followed for) and the name of the ``scene``; the whole map is ``env.unwrapped.map``.

    Args:
        view: what the policy sees and how it names a waypoint; its cells are those of the map.
        decisions: waypoints an episode; without it, as many as fit into ``max_steps``.
        options: of :class:`~autonerf_lab.envs.base.MappingEnv`. Colours are off unless asked for.
    """

    def __init__(
        self, view: View | None = None, rgb: bool = False, decisions: int | None = None, **options: Any
    ) -> None:
        self._view = view or PaperView()
        super().__init__(rgb=rgb, window=round(WINDOW_METRES / self._view.cell), **options)
        self._local = LocalPolicy()
        self._decisions, self._decided = decisions, 0
        self.action_space = self._view.action_space
        self.observation_space = self._view.observation_space  # type: ignore[assignment]

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Seen, dict[str, Any]]:
        """Start an episode: in a drawn scene, at a drawn pose, after a look around where the view asks for it."""
        self._begin(seed)
        for _ in range(self._view.opening):
            self._advance(Action.TURN_LEFT)
        self._local.reset()
        self._view.reset()
        self._decided = 0
        x, y, _ = planar_from_pose(self.map.pose)
        return self._view.see(self.map), self._info() | {"collisions": 0, "waypoint": np.array([x, y]), "steps": 0}

    def step(self, action: Any) -> tuple[Seen, float, bool, bool, dict[str, Any]]:
        """Follow one waypoint, for as long as the view says or to the end of the episode."""
        waypoint = self._view.waypoint(action, self.map)
        reward, collisions, steps = 0.0, 0, 0
        while steps == 0 or not (self._over or done(self._view, waypoint, self.map, steps)):
            reward += self._advance(int(self._local.act(self.map, waypoint)))
            collisions += self.observation.collided
            steps += 1
        self._decided += 1
        info = self._info() | {"collisions": collisions, "waypoint": waypoint, "steps": steps}
        over = self._over or self._decided == self._decisions
        return self._view.see(self.map), reward, False, over, info
