"""``AutoNeRF/PointGoal-v0``: go to a place that is given relative to the robot, by depth alone."""

from typing import Any

import numpy as np
from gymnasium import spaces

from autonerf_lab.envs.base import SceneEnv, Seen
from autonerf_lab.geometry import planar_from_pose, world_to_cell, wrap_angle
from autonerf_lab.planning import travel_distance
from autonerf_lab.types import Action

STOP = len(Action)  # the fourth action
SUCCESS_RADIUS = 0.36  # metres, twice the robot's radius
NEAREST_GOAL = 1.0  # metres on the shortest way
MAX_DEPTH = 5.0  # metres, range of the sensor
SUCCESS_REWARD, STEP_COST = 2.5, 0.01  # in metres of progress


class PointGoalEnv(SceneEnv[np.int64]):
    """Reach a goal and say so. Actions: forward 25 cm, turn left, turn right (30 degrees), stop.

    Observation, a dict: ``depth`` (S, S) float32, 0 to 1 for 0 to 5 m; ``goal`` (3,) float32: distance in metres,
    cosine and sine of its direction, counter-clockwise from the heading, by odometry. The episode terminates at *stop*
    and is truncated after ``max_steps``. It succeeds if the robot stops within 0.36 m of the goal, on its side of the
    walls.

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
        image = (self._intrinsics.height, self._intrinsics.width)
        self.action_space = spaces.Discrete(STOP + 1)
        self.observation_space: spaces.Dict = spaces.Dict(  # type: ignore[assignment]
            {
                "depth": spaces.Box(0, 1, image, np.float32),
                "goal": spaces.Box(np.array([0, -1, -1], np.float32), np.array([1e3, 1, 1], np.float32)),
            }
        )

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
        reach = travel_distance(free, start[None], ground.cell)
        far = np.isfinite(reach) & (reach >= min(NEAREST_GOAL, float(reach[np.isfinite(reach)].max())))
        goals = np.argwhere(far)
        goal = goals[self.np_random.integers(len(goals))]
        self._goal = ground.origin + (goal[::-1] + 0.5) * ground.cell
        self._distance = travel_distance(free, goal[None], ground.cell)
        self._shortest = self._left = self._distance_left()
        self._path = 0.0
        return self._seen(), self._info(False)

    def step(self, action: np.int64) -> tuple[Seen, float, bool, bool, dict[str, Any]]:
        """One action; any after *stop* needs a reset first."""
        assert self._observation is not None
        if int(action) == STOP:
            success = self._left <= SUCCESS_RADIUS
            return self._seen(), SUCCESS_REWARD * success - STEP_COST, True, False, self._info(success)
        place, before = self._sim.pose[:2, 3], self._left
        self._observation = self._sim.step(int(action))
        self._path += float(np.linalg.norm(self._sim.pose[:2, 3] - place))
        self._left = self._distance_left()
        truncated = self._observation.step >= self._max_steps
        return self._seen(), before - self._left - STEP_COST, False, truncated, self._info(False)

    def _distance_left(self) -> float:
        """Shortest way from where the robot is; from the nearest cell that has one, if its own has none."""
        ground = self._sim.navigation
        row, col = world_to_cell(self._sim.pose[:2, 3], ground.origin, ground.cell)
        for reach in range(1, 4):
            near = self._distance[max(0, row - reach) : row + reach + 1, max(0, col - reach) : col + reach + 1]
            here = self._distance[row, col]
            if np.isfinite(here):
                return float(here)
            if np.isfinite(near).any():
                return float(near[np.isfinite(near)].min()) + reach * ground.cell
        return self._left

    def _seen(self) -> Seen:
        assert self._observation is not None
        x, y, heading = planar_from_pose(self._observation.pose)
        away = self._goal - np.array([x, y])
        angle = wrap_angle(np.arctan2(away[1], away[0]) - heading)
        goal = np.array([np.hypot(*away), np.cos(angle), np.sin(angle)], np.float32)
        return {"depth": np.clip(self._observation.depth / np.float32(MAX_DEPTH), 0, 1), "goal": goal}

    def _info(self, success: bool) -> dict[str, Any]:
        spl = self._shortest / max(self._path, self._shortest, 1e-9) if success else 0.0
        return {
            "distance_to_goal": self._left,
            "success": success,
            "spl": float(spl),
            "scene": self._sim.scene.name,
        }
