"""What a PointGoal policy sees: depth, and where the goal lies by odometry."""

from typing import Any

import numpy as np
from gymnasium import spaces

from autonerf_lab.geometry import planar_from_pose, wrap_angle
from autonerf_lab.types import Action, Observation

STOP = len(Action)  # the fourth action


class GoalView:
    """``depth`` (S, S) float32, 0 to 1 for 0 to 5 m; ``goal`` (3,) float32: metres to it, cosine and sine of its
    direction, counter-clockwise from the heading.

    Args:
        size: S, pixels a side.

    Example:
        >>> from autonerf_lab.geometry import planar_pose
        >>> pose = planar_pose(0, 0, 0)
        >>> observation = Observation(np.zeros((2, 2, 3), np.uint8), np.full((2, 2), 2.5), np.zeros((2, 2)), pose)
        >>> seen = GoalView(2).see(observation, np.array([0.0, 3.0]))
        >>> float(seen["depth"][0, 0]), seen["goal"].round(3).tolist()
        (0.5, [3.0, 0.0, 1.0])
    """

    follow = 1  # actions a decision
    SIZE = 64  # pixels a side of what the network looks at
    MAX_DEPTH = 5.0  # metres, range of the sensor

    action_space = spaces.Discrete(STOP + 1)

    def __init__(self, size: int = SIZE) -> None:
        self.observation_space = spaces.Dict(
            {
                "depth": spaces.Box(0, 1, (size, size), np.float32),
                "goal": spaces.Box(np.array([0, -1, -1], np.float32), np.array([1e3, 1, 1], np.float32)),
            }
        )

    def see(self, observation: Observation, goal: np.ndarray) -> dict[str, Any]:
        """The observation, of a robot that wants to be at ``goal``, (2,) world x, y."""
        x, y, heading = planar_from_pose(observation.pose)
        away = goal - np.array([x, y])
        angle = wrap_angle(np.arctan2(away[1], away[0]) - heading)
        polar = np.array([np.hypot(*away), np.cos(angle), np.sin(angle)], np.float32)
        return {
            "depth": np.clip(observation.depth / np.float32(self.MAX_DEPTH), 0, 1).astype(np.float32),
            "goal": polar,
        }
