"""Noise of actuation and odometry, measured on real robots.

``ans``: Gaussian mixtures that Chaplot et al. (Active Neural SLAM, 2020) fitted to a LoCoBot, for a forward step of
25 cm and rotations of 10 degrees. Their robot frame has y to the right and clockwise angles; here y points left and
angles are counter-clockwise, so both change sign. A rotation by another angle is treated as several rotations of
10 degrees: means grow with the angle, standard deviations with its square root.

``locobot``, ``locobot-proportional`` and ``locobot-movebase``: the noisier actuation models of PyRobot for three
controllers (ILQR, proportional and movebase; Murali et al. 2019, as in habitat-sim), added to the commanded motion
independently of its length. Samples are truncated at three standard deviations, and a motion keeps at least 5 % of its
command.
"""

from dataclasses import dataclass

import numpy as np

from autonerf_lab.errors import DataError, UnknownNameError
from autonerf_lab.geometry import FORWARD_STEP, TURN_ANGLE
from autonerf_lab.types import Action

Motion = tuple[float, float, float]  # metres forward, metres to the left, radians counter-clockwise
_COMMANDS: dict[Action, Motion] = {
    Action.FORWARD: (FORWARD_STEP, 0.0, 0.0),
    Action.TURN_LEFT: (0.0, 0.0, TURN_ANGLE),
    Action.TURN_RIGHT: (0.0, 0.0, -TURN_ANGLE),
}
_MEASURED_FORWARD = 0.25  # metres, command to which the mixtures were fitted
_MEASURED_TURN = float(np.radians(10))  # radians


@dataclass(frozen=True)
class Gaussian:
    """Component of a Gaussian mixture over motions, in the frame of the publication."""

    weight: float  # in [0, 1]
    mean: Motion  # mm, mm, degrees
    sigma: Motion  # standard deviation; mm, mm, degrees


_ACTUATION = {
    Action.FORWARD: (
        Gaussian(0.580, (245.0, 2.2, 0.0125), (3.7, 2.6, 0.0057)),
        Gaussian(0.420, (246.5, 1.8, 0.0047), (3.3, 2.6, 0.0062)),
    ),
    Action.TURN_LEFT: (
        Gaussian(0.569, (-1.5, -20.1, -11.52), (0.0, 0.0, 0.32)),
        Gaussian(0.431, (-1.6, -19.0, -10.93), (0.0, 0.0, 0.26)),
    ),
    Action.TURN_RIGHT: (Gaussian(1.0, (-0.8, 19.5, 11.09), (0.0, 0.0, 0.48)),),
}
_ODOMETRY = {
    Action.FORWARD: (
        Gaussian(0.845, (1.0, -1.1, 0.0), (2.5, 2.3, 0.0022)),
        Gaussian(0.155, (3.8, 0.0, -0.0006), (2.9, 2.2, 0.0024)),
    ),
    Action.TURN_LEFT: (Gaussian(1.0, (2.0, 19.6, 0.198), (1.4, 1.6, 0.084)),),
    Action.TURN_RIGHT: (
        Gaussian(0.561, (1.7, -19.3, -0.039), (0.0, 0.0, 0.067)),
        Gaussian(0.439, (2.3, -19.5, 0.068), (0.0, 0.0, 0.061)),
    ),
}


@dataclass(frozen=True)
class ControllerNoise:
    """Independent Gaussian noise of a controller: metres forward, metres to the left, radians."""

    forward_mean: Motion
    forward_variance: Motion
    turn_mean: Motion  # the angle has the sign of the commanded rotation
    turn_variance: Motion


_CONTROLLERS = {
    "locobot": ControllerNoise(
        (0.014, 0.009, 0.008), (0.006, 0.005, 0.004), (0.003, 0.003, 0.023), (0.002, 0.003, 0.012)
    ),
    "locobot-proportional": ControllerNoise(
        (0.017, 0.042, 0.031), (0.007, 0.023, 0.026), (0.001, 0.005, 0.043), (0.001, 0.004, 0.017)
    ),
    "locobot-movebase": ControllerNoise(
        (0.074, 0.036, 0.189), (0.019, 0.033, 0.038), (0.002, 0.003, 0.219), (0.0, 0.002, 0.019)
    ),
}
_TRUNCATION = 3.0  # standard deviations
_LARGEST_LOSS = 0.95  # share of the commanded motion
MODELS = ("ans", *_CONTROLLERS)


@dataclass(frozen=True)
class MotionNoise:
    """Noise settings of a simulator.

    Raises:
        UnknownNameError: There is no noise model of that name.
        DataError: The scale is negative or not finite.

    Example:
        >>> forward, left, turn = MotionNoise().motion(Action.FORWARD, np.random.default_rng(0))
        >>> 0.2 < forward < 0.3
        True
        >>> MotionNoise(actuation=False).motion(Action.FORWARD, np.random.default_rng(0))
        (0.25, 0.0, 0.0)
    """

    actuation: bool = True  # the motion differs from the command
    odometry: bool = True  # the measured motion differs from the true one: ``Observation.pose`` drifts
    model: str = "ans"  # actuation model, one of :data:`MODELS`; the odometry model is always ``ans``
    scale: float = 1.0  # factor of all deviations from the command and from the true motion

    def __post_init__(self) -> None:
        if self.model not in MODELS:
            raise UnknownNameError("noise model", self.model, MODELS)
        if not 0 <= self.scale < np.inf:
            raise DataError(f"the scale of motion noise must be 0 or more and finite, not {self.scale}")

    def motion(self, action: Action, rng: np.random.Generator) -> Motion:
        """Sample the motion that an action causes without obstacles, in the robot's frame."""
        command = _COMMANDS[action]
        if not self.actuation:
            return command
        if self.model == "ans":
            x, y, turn = _sample(_ACTUATION[action], _scale(action), rng)
            if self.scale != 1:
                deviation = self.scale * (np.array([x, y, turn]) - command)
                x, y, turn = (float(value) for value in command + deviation)
            return x, y, turn
        noise = _CONTROLLERS[self.model]
        forward = action == Action.FORWARD
        mean, variance = (
            (noise.forward_mean, noise.forward_variance) if forward else (noise.turn_mean, noise.turn_variance)
        )
        error = self.scale * _truncated_normal(np.array(mean), np.sqrt(variance), rng)
        # The commanded component grows or shrinks by its error.
        main = 0 if forward else 2
        error[main] = np.sign(command[main]) * max(error[main], -_LARGEST_LOSS * abs(command[main]))
        x, y, turn = (float(value) for value in command + error)
        return x, y, turn

    def odometry_error(self, action: Action, rng: np.random.Generator) -> Motion:
        """Sample the error that odometry adds to the true motion, in the robot's frame."""
        if not self.odometry:
            return 0.0, 0.0, 0.0
        x, y, turn = _sample(_ODOMETRY[action], _scale(action), rng)
        return self.scale * x, self.scale * y, self.scale * turn

    def odometry_moments(self, action: Action) -> tuple[np.ndarray, np.ndarray]:
        """Return the mean (3,) and covariance (3, 3) of :meth:`odometry_error`: the calibration of the robot.

        Example:
            >>> mean, covariance = MotionNoise().odometry_moments(Action.TURN_LEFT)
            >>> float(np.degrees(mean[2]).round(3)), float(np.degrees(np.sqrt(covariance[2, 2])).round(3))
            (-0.594, 0.145)
        """
        if not self.odometry:
            return np.zeros(3), np.zeros((3, 3))
        factor, units = _scale(action), self.scale * np.array([1e-3, -1e-3, -np.pi / 180])
        mixture = _ODOMETRY[action]
        weights = np.array([g.weight for g in mixture])
        means = np.array([g.mean for g in mixture]) * factor
        mean = weights @ means
        apart = means - mean
        variance = np.diag(weights @ np.square([g.sigma for g in mixture]) * factor)
        return units * mean, np.outer(units, units) * (variance + (weights[:, None] * apart).T @ apart)


def motion_noise(model: str | None, scale: float | None = None) -> MotionNoise | None:
    """Return the noise of a model by name, for actuation and odometry; None for none.

    Raises:
        UnknownNameError: There is no noise model of that name.
        DataError: The scale is negative or not finite.
    """
    return None if model is None else MotionNoise(model=model, scale=1.0 if scale is None else scale)


def compose(x: float, y: float, heading: float, motion: Motion) -> tuple[float, float, float]:
    """Return the planar pose after a motion.

    Args:
        x: World x, metres.
        y: World y, metres.
        heading: Angle from the world x axis, radians, counter-clockwise.
        motion: Metres forward, metres left and radians counter-clockwise, in the robot's frame.

    Returns:
        World x, y and heading after the motion.

    Example:
        >>> [round(v, 6) for v in compose(1.0, 1.0, np.pi / 2, (0.25, 0.0, 0.1))]
        [1.0, 1.25, 1.670796]
    """
    c, s = np.cos(heading), np.sin(heading)
    forward, left, turn = motion
    return float(x + c * forward - s * left), float(y + s * forward + c * left), float(heading + turn)


def _scale(action: Action) -> float:
    """Return the ratio of the commanded to the measured motion."""
    return FORWARD_STEP / _MEASURED_FORWARD if action == Action.FORWARD else TURN_ANGLE / _MEASURED_TURN


def _sample(mixture: tuple[Gaussian, ...], scale: float, rng: np.random.Generator) -> Motion:
    """Sample a motion from a mixture, converted to metres and radians in the frame of this package."""
    component = mixture[rng.choice(len(mixture), p=[g.weight for g in mixture])]
    x, y, turn = rng.normal(np.array(component.mean) * scale, np.array(component.sigma) * np.sqrt(scale))
    return float(x) / 1000, -float(y) / 1000, -float(np.radians(turn))


def _truncated_normal(mean: np.ndarray, sigma: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Sample independent normal values again until they lie within the truncation."""
    error = rng.normal(size=mean.shape)
    while (outside := np.abs(error) > _TRUNCATION).any():
        error[outside] = rng.normal(size=int(outside.sum()))
    return mean + sigma * error
