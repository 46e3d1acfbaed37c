"""Noise of motion, odometry and depth: published moments, values by hand, and what noise leaves unchanged."""

import numpy as np
import pytest
from toy_scene import two_rooms

from autonerf_lab.errors import DataError, UnknownNameError
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.simulator import MotionNoise, Simulator
from autonerf_lab.simulator.depth_noise import redwood
from autonerf_lab.types import Action

# Chaplot et al. 2020: weight, mean and standard deviation of forward, right (mm) and clockwise angle (degrees). A turn
# of 30 degrees is three measured ones of 10.
PUBLISHED = {
    ("motion", Action.FORWARD): (
        (0.580, (245.0, 2.2, 0.0125), (3.7, 2.6, 0.0057)),
        (0.420, (246.5, 1.8, 0.0047), (3.3, 2.6, 0.0062)),
    ),
    ("motion", Action.TURN_LEFT): (
        (0.569, (-1.5, -20.1, -11.52), (0, 0, 0.32)),
        (0.431, (-1.6, -19.0, -10.93), (0, 0, 0.26)),
    ),
    ("motion", Action.TURN_RIGHT): ((1.0, (-0.8, 19.5, 11.09), (0, 0, 0.48)),),
    ("odometry_error", Action.FORWARD): (
        (0.845, (1.0, -1.1, 0), (2.5, 2.3, 0.0022)),
        (0.155, (3.8, 0, -0.0006), (2.9, 2.2, 0.0024)),
    ),
    ("odometry_error", Action.TURN_LEFT): ((1.0, (2.0, 19.6, 0.198), (1.4, 1.6, 0.084)),),
    ("odometry_error", Action.TURN_RIGHT): (
        (0.561, (1.7, -19.3, -0.039), (0, 0, 0.067)),
        (0.439, (2.3, -19.5, 0.068), (0, 0, 0.061)),
    ),
}


@pytest.mark.parametrize(("kind", "action"), PUBLISHED)
def test_ans_noise_has_the_published_moments(kind, action):
    weight, mean, sigma = (np.array(part) for part in zip(*PUBLISHED[kind, action], strict=True))
    times = 1 if action == Action.FORWARD else 3
    expected = times * weight @ mean
    variance = weight @ (times * sigma**2 + (times * mean - expected) ** 2)
    noise, rng = MotionNoise(), np.random.default_rng(0)
    samples = np.array([getattr(noise, kind)(action, rng) for _ in range(10_000)])
    found = samples * [1000, -1000, -np.degrees(1)]
    np.testing.assert_allclose(found.mean(axis=0), expected, atol=1e-9 + 4 * np.sqrt(variance.max() / 10_000))
    np.testing.assert_allclose(found.mean(axis=0)[2], expected[2], atol=4 * np.sqrt(variance[2] / 10_000))
    np.testing.assert_allclose(found.std(axis=0), np.sqrt(variance), rtol=0.03, atol=1e-9)
    if kind == "odometry_error":  # the calibration of the robot
        calibrated, covariance = noise.odometry_moments(action)
        np.testing.assert_allclose(samples.mean(axis=0), calibrated, atol=1e-12 + 4 * np.sqrt(covariance.max() / 1e4))
        spread = np.sqrt(np.diag(covariance))
        np.testing.assert_allclose(
            np.cov(samples.T) / np.outer(spread, spread), covariance / np.outer(spread, spread), atol=0.05
        )


def test_unknown_models_and_scales_are_refused():
    with pytest.raises(UnknownNameError, match="valid names: ans, locobot"):
        MotionNoise(model="perfect")
    with pytest.raises(DataError, match="scale of motion noise"):
        MotionNoise(scale=-1.0)


@pytest.mark.parametrize(
    ("model", "forward", "turn"),
    [
        ("locobot", ((0.014, 0.009, 0.008), (0.006, 0.005, 0.004)), ((0.003, 0.003, 0.023), (0.002, 0.003, 0.012))),
        (
            "locobot-proportional",
            ((0.017, 0.042, 0.031), (0.007, 0.023, 0.026)),
            ((0.001, 0.005, 0.043), (0.001, 0.004, 0.017)),
        ),
        (
            "locobot-movebase",
            ((0.074, 0.036, 0.189), (0.019, 0.033, 0.038)),
            ((0.002, 0.003, 0.219), (0.0, 0.002, 0.019)),
        ),
    ],
)
@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_controller_noise_has_the_published_moments(model, forward, turn, scale):
    """A normal distribution that is cut at three standard deviations keeps 97.33 % of its variance."""
    noise, rng = MotionNoise(model=model, scale=scale), np.random.default_rng(0)
    commands = {
        Action.FORWARD: (0.25, 0, 0),
        Action.TURN_LEFT: (0, 0, np.pi / 6),
        Action.TURN_RIGHT: (0, 0, -np.pi / 6),
    }
    for action, command in commands.items():
        mean, variance = np.array(forward if action == Action.FORWARD else turn)
        mean[2] *= -1 if action == Action.TURN_RIGHT else 1  # the angle has the sign of the command
        errors = np.array([noise.motion(action, rng) for _ in range(10_000)]) - command
        sigma = scale * np.sqrt(0.9733 * variance)
        cut = model == "locobot-movebase" and action == Action.FORWARD and scale == 1  # -95 % of the command is reached
        if cut:
            assert errors[:, 0].min() == pytest.approx(-0.95 * 0.25)
        first = int(cut)  # the commanded component has another mean and deviation then
        np.testing.assert_allclose(errors.mean(axis=0)[first:], scale * mean[first:], atol=0.008 * scale)
        np.testing.assert_allclose(errors.std(axis=0)[first:], sigma[first:], rtol=0.03, atol=1e-9)
        beyond = np.abs(errors - scale * mean)[:, first:] > 3.001 * scale * np.sqrt(variance[first:]) + 1e-9
        assert not beyond.any()


def test_the_scale_of_noise_multiplies_deviations():
    action = Action.TURN_LEFT
    one, three = (MotionNoise(scale=scale) for scale in (1.0, 3.0))
    a, b = (np.array(noise.motion(action, np.random.default_rng(1))) - (0, 0, np.pi / 6) for noise in (one, three))
    np.testing.assert_allclose(b, 3 * a)
    a, b = (np.array(noise.odometry_error(action, np.random.default_rng(1))) for noise in (one, three))
    np.testing.assert_allclose(b, 3 * a)
    assert MotionNoise(scale=0.0).motion(Action.FORWARD, np.random.default_rng(0)) == (0.25, 0, 0)


def test_depth_noise_by_hand():
    """At 4 m, 8 * 35.13 / 4 = 70.26 steps of disparity with noise of 0.22: 86 % round to 70, 4.015 m, others to 71."""
    flat = np.full((64, 64), 4.0, np.float32)
    noisy = redwood(flat, np.random.default_rng(0))
    values, counts = np.unique(noisy.round(3), return_counts=True)
    assert values.tolist() == pytest.approx([3.958, 4.015], abs=1e-3)
    assert counts[1] / noisy.size == pytest.approx(0.86, abs=0.02)
    # Over many depths around 0.5 m, the variances of the noise and of the rounding to steps of 0.9 mm add up.
    rng, depths = np.random.default_rng(0), np.linspace(0.49, 0.51, 200)
    errors = np.stack([redwood(np.full((8, 8), d, np.float32), rng) - np.float32(d) for d in depths])
    assert errors.std() == pytest.approx(np.hypot(0.5**2 * 0.027778 / 35.13, 0.5**2 / 281.04 / np.sqrt(12)), rel=0.05)
    flat[:, 32:], flat[:8] = 12.0, 0.0  # too far, and not measured
    lost = redwood(flat, np.random.default_rng(0)) == 0
    assert lost[:, 40:].all() and lost[:4].all() and not lost[12:, :28].any()


def test_depth_noise_changes_observations_only():
    options = {"scene": two_rooms(), "intrinsics": Intrinsics.from_fov(16, 16), "rgb": False, "noise": MotionNoise()}
    exact, noisy = Simulator(**options), Simulator(**options, depth_noise="redwood")
    for sim in (exact, noisy):
        sim.reset(seed=3)
    first, second = exact.step(0), noisy.step(0)
    np.testing.assert_array_equal(first.pose, second.pose)  # the same random motion
    assert (first.depth != second.depth).any()
    np.testing.assert_array_equal(noisy.render(noisy.pose).depth, first.depth)
    with pytest.raises(UnknownNameError, match="unknown depth noise 'kinect'; valid names: redwood"):
        Simulator(**options, depth_noise="kinect")
