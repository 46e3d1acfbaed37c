"""``AutoNeRF/PointGoal-v0``: go to a position given relative to the robot, from depth images."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from autonerf_lab.envs.base import ObsDict, SceneEnv
from autonerf_lab.geometry import FORWARD_STEP, TURN_ANGLE, planar_from_pose, world_to_cell
from autonerf_lab.planning import travel_distance, weighted_success
from autonerf_lab.policies.pointgoal import STOP, GoalInterface
from autonerf_lab.types import Action

SUCCESS_RADIUS = 0.36  # metres, twice the robot's radius
NEAREST_GOAL = 1.0  # metres, minimum length of the shortest path
GOAL_SAMPLES = 20  # attempts to find such a goal
SUCCESS_REWARD, STEP_COST = 2.5, 0.01  # metres of progress
ARRIVED = 0.25  # metres from the goal at which the expert stops
TURN_COST = 0.02  # metres, cost of one turn for the expert: a half turn costs less than one step forward gains
HALF_TURN = round(np.pi / TURN_ANGLE)  # actions


class PointGoalEnv(SceneEnv[np.int64]):
    """PointGoal navigation (Anderson et al. 2018).

    Action space: ``Discrete(4)``: 0 forward 25 cm, 1 turn left, 2 turn right by 30 degrees, 3 stop.

    Observation space: ``Dict``, see :class:`~autonerf_lab.policies.pointgoal.GoalInterface`: ``depth`` (S, S) float32
    and ``goal`` (3,) float32, by odometry.

    Rewards: decrease of the shortest path length to the goal in metres, 2.5 for success, -0.01 per step.

    Starting state: a random scene, a random navigable pose and a random goal with a shortest path of at least 1 m, if
    the scene has one.

    Episode end: terminated by *stop*, truncated after ``max_steps`` actions. Success is a stop with at most 0.36 m of
    shortest path to the goal.

    Info: ``distance_to_goal``, shortest path length in metres; ``success``; ``spl``, success weighted by path length;
    ``scene``, its name.

    Version: v0.

    Args:
        max_steps: maximum number of actions per episode.
        rgb: render color images, which this environment does not need.
        options: arguments of :class:`~autonerf_lab.envs.base.SceneEnv`.
    """

    def __init__(self, max_steps: int = 500, rgb: bool = False, **options: Any) -> None:
        super().__init__(rgb=rgb, **options)
        self._max_steps = max_steps
        self._goal = np.zeros(2)
        self._distance = np.zeros((1, 1))
        self._shortest = self._left = self._path = 0.0
        self._interface = GoalInterface(self._intrinsics.width)
        self.action_space = self._interface.action_space
        self.observation_space = self._interface.observation_space  # type: ignore[assignment]

    @property
    def goal(self) -> np.ndarray:
        """Goal, (2,) world x, y in metres."""
        return self._goal

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[ObsDict, dict[str, Any]]:
        """Start an episode in a random scene with a random start pose and goal."""
        self._begin(seed)
        ground = self._sim.navigation
        start = world_to_cell(self._sim.pose[:2, 3], ground.origin, ground.cell)
        # The cell of the start may be free only in part and therefore not be navigable.
        free = ground.navigable.copy()
        free[tuple(start)] = True
        candidates = np.argwhere(free)
        for _ in range(GOAL_SAMPLES):
            goal = candidates[self.np_random.integers(len(candidates))]
            self._distance = travel_distance(free, goal[None], ground.cell)
            if NEAREST_GOAL <= self._distance[tuple(start)] < np.inf:
                break
        else:  # a very small scene: take the farthest position
            reach = travel_distance(free, start[None], ground.cell)
            goal = np.argwhere(reach == reach[np.isfinite(reach)].max())[0]
            self._distance = travel_distance(free, goal[None], ground.cell)
        self._goal = ground.origin + (goal[::-1] + 0.5) * ground.cell
        self._shortest = self._left = self._distance_left(self._sim.pose[:2, 3])
        self._path = 0.0
        return self._encode(), self._info(False)

    def step(self, action: np.int64) -> tuple[ObsDict, float, bool, bool, dict[str, Any]]:
        """Apply one action; *stop* ends the episode."""
        if int(action) == STOP:
            success = self._left <= SUCCESS_RADIUS
            return self._encode(), SUCCESS_REWARD * success - STEP_COST, True, False, self._info(success)
        start, before = self._sim.pose[:2, 3], self._left
        self._observation = self._sim.step(int(action))
        self._path += float(np.linalg.norm(self._sim.pose[:2, 3] - start))
        self._left = self._distance_left(self._sim.pose[:2, 3])
        truncated = self.observation.step >= self._max_steps
        return self._encode(), before - self._left - STEP_COST, False, truncated, self._info(False)

    def expert_action(self) -> int:
        """Return the action that follows the shortest path, computed from ground truth: for imitation only."""
        if self._left <= ARRIVED:
            return STOP
        x, y, heading = planar_from_pose(self._sim.pose)
        ends = {}
        for turns in range(1 - HALF_TURN, HALF_TURN + 1):  # positive: to the left
            angle = heading + turns * TURN_ANGLE
            end = self._sim.navigation.move(x, y, FORWARD_STEP * np.cos(angle), FORWARD_STEP * np.sin(angle))
            ends[turns] = self._distance_left(end) + TURN_COST * abs(turns)
        best = min(ends, key=ends.__getitem__)
        return int(Action.FORWARD if best == 0 else Action.TURN_LEFT if best > 0 else Action.TURN_RIGHT)

    def _distance_left(self, position: Sequence[float] | np.ndarray) -> float:
        """Return the shortest path length to the goal; from the nearest reachable cell if this cell is blocked."""
        ground = self._sim.navigation
        row, col = world_to_cell(np.asarray(position), ground.origin, ground.cell)
        here = float(self._distance[row, col])
        if np.isfinite(here):
            return here
        for reach in range(1, 4):
            near = self._distance[max(0, row - reach) : row + reach + 1, max(0, col - reach) : col + reach + 1]
            if np.isfinite(near).any():
                return float(near[np.isfinite(near)].min()) + reach * ground.cell
        return self._left

    def _encode(self) -> ObsDict:
        return self._interface.observe(self.observation, self._goal)

    def _info(self, success: bool) -> dict[str, Any]:
        return {
            "distance_to_goal": self._left,
            "success": success,
            "spl": weighted_success(success, self._path, self._shortest),
            "scene": self._sim.scene.name,
        }
