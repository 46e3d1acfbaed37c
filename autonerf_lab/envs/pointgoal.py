"""``AutoNeRF/PointGoal-v0``: go to a place that is given relative to the robot, by depth alone."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from autonerf_lab.envs.base import SceneEnv, Seen
from autonerf_lab.geometry import FORWARD_STEP, TURN_ANGLE, planar_from_pose, world_to_cell
from autonerf_lab.planning import travel_distance, weighted_success
from autonerf_lab.policies.pointgoal import STOP, GoalView
from autonerf_lab.types import Action

SUCCESS_RADIUS = 0.36  # metres, twice the robot's radius
NEAREST_GOAL = 1.0  # metres on the shortest way
GOAL_DRAWS = 20
SUCCESS_REWARD, STEP_COST = 2.5, 0.01  # in metres of progress
ARRIVED = 0.25  # metres from the goal at which a robot that knows the way stops
TURN_COST = 0.02  # metres that a turn by one action is worth to it: to turn round costs less than a step gains
HALF_TURN = round(np.pi / TURN_ANGLE)  # actions


class PointGoalEnv(SceneEnv[np.int64]):
    """Reach a goal and say so. Actions: forward 25 cm, turn left, turn right (30 degrees), stop.

    Observations are those of :class:`~autonerf_lab.policies.pointgoal.GoalView`: depth, and the goal by odometry. The
    episode terminates at *stop* and is truncated after ``max_steps``. It succeeds if the robot stops within 0.36 m of
    the goal, on its side of the walls.

    Reward: metres gained on the shortest way to the goal, 2.5 for success, -0.01 a step. ``info`` holds
    ``distance_to_goal`` (shortest way, metres), ``success``, ``spl`` and the name of the ``scene``.

    Args:
        max_steps: actions an episode.
        options: of :class:`~autonerf_lab.envs.base.SceneEnv`. Colours are off unless asked for.
    """

    def __init__(self, max_steps: int = 500, rgb: bool = False, **options: Any) -> None:
        super().__init__(rgb=rgb, **options)
        self._max_steps = max_steps
        self._goal = np.zeros(2)
        self._distance = np.zeros((1, 1))
        self._shortest = self._left = self._path = 0.0
        self._view = GoalView(self._intrinsics.width)
        self.action_space = self._view.action_space
        self.observation_space = self._view.observation_space  # type: ignore[assignment]

    @property
    def goal(self) -> np.ndarray:
        """(2,) world x, y."""
        return self._goal

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Seen, dict[str, Any]]:
        """Start an episode: a drawn scene, start and goal, at least 1 m apart where the scene has room for that."""
        self._begin(seed)
        ground = self._sim.navigation
        start = world_to_cell(self._sim.pose[:2, 3], ground.origin, ground.cell)
        # Where a grid cell is free only in part, the robot may stand outside of the region of cells.
        free = ground.navigable.copy()
        free[tuple(start)] = True
        places = np.argwhere(free)
        for _ in range(GOAL_DRAWS):
            goal = places[self.np_random.integers(len(places))]
            self._distance = travel_distance(free, goal[None], ground.cell)
            if NEAREST_GOAL <= self._distance[tuple(start)] < np.inf:
                break
        else:  # there is hardly room: the farthest place
            reach = travel_distance(free, start[None], ground.cell)
            goal = np.argwhere(reach == reach[np.isfinite(reach)].max())[0]
            self._distance = travel_distance(free, goal[None], ground.cell)
        self._goal = ground.origin + (goal[::-1] + 0.5) * ground.cell
        self._shortest = self._left = self._distance_left(self._sim.pose[:2, 3])
        self._path = 0.0
        return self._seen(), self._info(False)

    def step(self, action: np.int64) -> tuple[Seen, float, bool, bool, dict[str, Any]]:
        """One action; any after *stop* needs a reset first."""
        if int(action) == STOP:
            success = self._left <= SUCCESS_RADIUS
            return self._seen(), SUCCESS_REWARD * success - STEP_COST, True, False, self._info(success)
        place, before = self._sim.pose[:2, 3], self._left
        self._observation = self._sim.step(int(action))
        self._path += float(np.linalg.norm(self._sim.pose[:2, 3] - place))
        self._left = self._distance_left(self._sim.pose[:2, 3])
        truncated = self.observation.step >= self._max_steps
        return self._seen(), before - self._left - STEP_COST, False, truncated, self._info(False)

    def shortest_way(self) -> int:
        """What a robot that knew the apartment would do now: one to learn from."""
        if self._left <= ARRIVED:
            return STOP
        x, y, heading = planar_from_pose(self._sim.pose)
        ends = {}
        for turns in range(1 - HALF_TURN, HALF_TURN + 1):  # to the left
            angle = heading + turns * TURN_ANGLE
            end = self._sim.navigation.move(x, y, FORWARD_STEP * np.cos(angle), FORWARD_STEP * np.sin(angle))
            ends[turns] = self._distance_left(end) + TURN_COST * abs(turns)
        best = min(ends, key=ends.__getitem__)
        return int(Action.FORWARD if best == 0 else Action.TURN_LEFT if best > 0 else Action.TURN_RIGHT)

    def _distance_left(self, place: Sequence[float] | np.ndarray) -> float:
        """Shortest way from a place; from the nearest cell that has one, if its own has none."""
        ground = self._sim.navigation
        row, col = world_to_cell(np.asarray(place), ground.origin, ground.cell)
        here = float(self._distance[row, col])
        if np.isfinite(here):
            return here
        for reach in range(1, 4):
            near = self._distance[max(0, row - reach) : row + reach + 1, max(0, col - reach) : col + reach + 1]
            if np.isfinite(near).any():
                return float(near[np.isfinite(near)].min()) + reach * ground.cell
        return self._left

    def _seen(self) -> Seen:
        return self._view.see(self.observation, self._goal)

    def _info(self, success: bool) -> dict[str, Any]:
        return {
            "distance_to_goal": self._left,
            "success": success,
            "spl": weighted_success(success, self._path, self._shortest),
            "scene": self._sim.scene.name,
        }
