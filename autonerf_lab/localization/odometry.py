"""Calibration of odometry: the known mean of the error of each motion is removed, and its covariance is propagated."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from autonerf_lab.simulator.motion_noise import MotionNoise
from autonerf_lab.types import Action

# Standard deviation of a motion of which nothing more is known: 1 mm and 0.02 degrees
_SMALLEST = np.diag(np.square([1e-3, 1e-3, 3.5e-4]))


@dataclass(frozen=True)
class OdometryModel:
    """Mean and covariance of the error of odometry for each action, in the frame of the robot, metres and radians."""

    means: Mapping[Action, np.ndarray]  # (3,) forward, left, counter-clockwise
    covariances: Mapping[Action, np.ndarray]  # (3, 3)

    @classmethod
    def from_noise(cls, noise: MotionNoise) -> "OdometryModel":
        """Return the calibration of a robot with a known noise.

        Example:
            >>> model = OdometryModel.from_noise(MotionNoise())
            >>> float(np.degrees(model.means[Action.TURN_LEFT][2]).round(3))
            -0.594
        """
        moments = {action: noise.odometry_moments(action) for action in Action}
        return cls({a: mean for a, (mean, _) in moments.items()}, {a: c + _SMALLEST for a, (_, c) in moments.items()})

    def corrected(self, motion: np.ndarray, action: int) -> np.ndarray:
        """Return a measured motion (3,) without the mean error of its action."""
        return motion - self.means[Action(action)]
