"""Policy interface of the PointGoal policy: the depth image and the goal relative to the robot."""

from typing import Any

import numpy as np
from gymnasium import spaces

from autonerf_lab.geometry import planar_from_pose, wrap_angle
from autonerf_lab.types import Action, Observation

STOP = len(Action)  # fourth action, which ends the episode


class GoalInterface:
    """Interface with a depth image and the goal in polar coordinates of the robot, by odometry.

    Observation: ``depth`` (S, S) float32, 0 to 1 for 0 to 5 m; ``goal`` (3,) float32, distance in metres, cosine and
    sine of the direction, counter-clockwise from the heading.

    Args:
        size: S, pixels a side.

    Example:
        >>> from autonerf_lab.geometry import planar_pose
        >>> pose = planar_pose(0, 0, 0)
        >>> observation = Observation(np.zeros((2, 2, 3), np.uint8), np.full((2, 2), 2.5), np.zeros((2, 2)), pose)
        >>> obs = GoalInterface(2).observe(observation, np.array([0.0, 3.0]))
        >>> float(obs["depth"][0, 0]), obs["goal"].round(3).tolist()
        (0.5, [3.0, 0.0, 1.0])
    """

    follow = 1  # actions per decision
    initial_turns = 0
    SIZE = 64  # pixels a side of the depth image
    MAX_DEPTH = 5.0  # metres, range of the sensor

    action_space = spaces.Discrete(STOP + 1)

    def __init__(self, size: int = SIZE) -> None:
        self.observation_space = spaces.Dict(
            {
                "depth": spaces.Box(0, 1, (size, size), np.float32),
                "goal": spaces.Box(np.array([0, -1, -1], np.float32), np.array([1e3, 1, 1], np.float32)),
            }
        )

    def observe(self, observation: Observation, goal: np.ndarray) -> dict[str, Any]:
        """Encode an observation and the goal, (2,) world x, y in metres."""
        x, y, heading = planar_from_pose(observation.pose)
        offset = goal - np.array([x, y])
        angle = wrap_angle(np.arctan2(offset[1], offset[0]) - heading)
        polar = np.array([np.hypot(*offset), np.cos(angle), np.sin(angle)], np.float32)
        return {
            "depth": np.clip(observation.depth / np.float32(self.MAX_DEPTH), 0, 1).astype(np.float32),
            "goal": polar,
        }
