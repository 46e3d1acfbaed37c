"""Noise of motion, odometry and depth: published moments, values by hand, and what noise leaves unchanged."""

import numpy as np
import pytest
from toy_scene import two_rooms

from autonerf_lab.errors import DataError, UnknownNameError
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.simulator import MotionNoise, Simulator
from autonerf_lab.simulator.depth_noise import redwood
from autonerf_lab.types import Action


def test_actuation_noise_has_the_published_moments():
    rng = np.random.default_rng(0)
    noise = MotionNoise()
    forward = np.array([noise.motion(Action.FORWARD, rng) for _ in range(4000)])
    np.testing.assert_allclose(forward.mean(axis=0)[0], 0.580 * 0.2450 + 0.420 * 0.2465, atol=2e-4)
    left = np.array([noise.motion(Action.TURN_LEFT, rng) for _ in range(4000)])
    mean = 3 * (0.569 * 11.52 + 0.431 * 10.93)  # a rotation of 30 degrees is three of 10
    assert np.degrees(left[:, 2].mean()) == pytest.approx(mean, abs=0.1)
    right = np.array([noise.motion(Action.TURN_RIGHT, rng) for _ in range(4000)])
    assert np.degrees(right[:, 2].mean()) == pytest.approx(-3 * 11.09, abs=0.1)
    assert np.degrees(right[:, 2].std()) == pytest.approx(np.sqrt(3) * 0.48, rel=0.05)
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
