"""``AutoNeRF/Waypoint-v0``: environment of the modular global policy (section 3.1). An action is a waypoint."""

from typing import Any

import numpy as np

from autonerf_lab.envs.base import MappingEnv, ObsDict
from autonerf_lab.geometry import planar_from_pose
from autonerf_lab.planning import LocalPolicy
from autonerf_lab.policies.interfaces import WINDOW_METRES, PaperInterface, PolicyInterface, waypoint_finished
from autonerf_lab.types import Action


class WaypointEnv(MappingEnv[Any]):
    """Exploration by waypoints, which the local policy follows by fast marching.

    Action space and observation space: those of the policy interface. With the default, the interface of the paper:
    actions ``Box(-1, 1, (2,))``, a point of the 12 m window around the robot; observations ``Dict`` of ``map``
    (24, 240, 240) uint8 and ``heading``, one of 72 bins.

    Rewards: the sum of the rewards of all robot actions towards the waypoint.

    Starting state: a random scene and a random navigable pose, after the initial turns of the interface.

    Episode end: truncated after ``decisions`` waypoints or ``max_steps`` robot actions; never terminated. A waypoint
    ends after ``interface.follow`` actions (25 in the paper), or within ``interface.arrival`` metres of it.

    Info: as in :class:`~autonerf_lab.envs.explore.ExploreEnv`, with ``collisions``, ``waypoint`` (world x, y) and
    ``steps``, the number of robot actions, of this decision.

    Version: v0.

    Args:
        interface: policy interface; its cell is the cell of the map. None for the interface of the paper.
        rgb: render color images, which this environment does not need.
        decisions: maximum number of waypoints per episode; None: only ``max_steps`` limits an episode.
        options: arguments of :class:`~autonerf_lab.envs.base.MappingEnv` and its base class.
    """

    def __init__(
        self,
        interface: PolicyInterface | None = None,
        rgb: bool = False,
        decisions: int | None = None,
        **options: Any,
    ) -> None:
        self._interface = interface or PaperInterface()
        super().__init__(rgb=rgb, window=round(WINDOW_METRES / self._interface.cell), **options)
        self._local = LocalPolicy()
        self._decisions, self._decided = decisions, 0
        self.action_space = self._interface.action_space
        self.observation_space = self._interface.observation_space  # type: ignore[assignment]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[ObsDict, dict[str, Any]]:
        """Start an episode in a random scene at a random pose, and make the initial turns of the interface."""
        self._begin(seed)
        for _ in range(self._interface.initial_turns):
            self._advance(Action.TURN_LEFT)
        self._local.reset()
        self._interface.reset()
        self._decided = 0
        x, y, _ = planar_from_pose(self.map.pose)
        return self._interface.observe(self.map), self._info() | {
            "collisions": 0,
            "waypoint": np.array([x, y]),
            "steps": 0,
        }

    def step(self, action: Any) -> tuple[ObsDict, float, bool, bool, dict[str, Any]]:
        """Follow one waypoint until it is finished or the episode ends."""
        waypoint = self._interface.to_waypoint(action, self.map)
        reward, collisions, steps = 0.0, 0, 0
        while steps == 0 or not (self._over or waypoint_finished(self._interface, waypoint, self.map, steps)):
            reward += self._advance(int(self._local.act(self.map, waypoint)))
            collisions += self.observation.collided
            steps += 1
        self._decided += 1
        info = self._info() | {"collisions": collisions, "waypoint": waypoint, "steps": steps}
        over = self._over or self._decided == self._decisions
        return self._interface.observe(self.map), reward, False, over, info
