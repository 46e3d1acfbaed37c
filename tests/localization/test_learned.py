"""Learned odometry: residuals against numpy, corrections by hand, its weights, and what they are worth."""

import json
import shutil

import numpy as np
import pytest
import torch
import toy_scene

from autonerf_lab.errors import DataError
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.localization import OdometryModel
from autonerf_lab.localization.learned import WEIGHTS, LearnedOdometry, inputs_sha256, save_network
from autonerf_lab.localization.motion_network import MotionNetwork
from autonerf_lab.localization.residual_image import LARGEST, residual_image
from autonerf_lab.localization.scan import INVERSE_DEPTH_SIGMA, make_scan
from autonerf_lab.localization.se2 import between, to_matrices, to_planar
from autonerf_lab.simulator import Simulator
from autonerf_lab.simulator.depth_noise import redwood
from autonerf_lab.simulator.motion_noise import MotionNoise
from autonerf_lab.types import Action

CAMERA = Intrinsics.from_fov(128, 128)
NOISE = MotionNoise()
MODEL = OdometryModel.from_noise(NOISE)


@pytest.fixture(scope="module")
def sim():
    return Simulator(toy_scene.two_rooms(), CAMERA, rgb=False, noise=MotionNoise(odometry=False), depth_noise="redwood")


@pytest.fixture(scope="module")
def steps(sim):
    """Scans before and after 24 steps, true motions and actions."""
    actions, observation, found = [0, 1, 0, 2, 1, 1] * 4, sim.reset(seed=0), []
    for action in actions:
        before, observation = observation, sim.step(action)
        motion = between(to_planar(before.pose), to_planar(observation.pose))
        found.append((make_scan(before.depth, CAMERA), make_scan(observation.depth, CAMERA), motion, Action(action)))
    return found


def squared_errors(learned: LearnedOdometry | None, steps) -> float:
    """Return the mean squared error of motions in units of the odometry's standard deviations."""
    rng, errors = np.random.default_rng(0), []
    for before, after, true, action in steps:
        covariance = MODEL.covariances[action]
        motion = MODEL.corrected(true + NOISE.odometry_error(action, rng), action)
        if learned is not None:
            motion, _ = learned.correct(after, before, motion, covariance)
        errors.append((motion - true) @ np.linalg.solve(covariance, motion - true) / 3)
    return float(np.mean(errors))


def test_residuals_are_those_of_numpy(sim):
    before, after = (
        make_scan(sim.render(to_matrices(np.array([pose]))[0], rgb=False).depth, CAMERA)
        for pose in ((2.0, 1.5, 0.3), (2.2, 1.45, 0.1))
    )
    x, y, heading = motion = np.array([0.18, -0.1, -0.17])
    image = residual_image(after, before, motion)

    def residuals(x, y, heading):
        c, s = np.cos(heading), np.sin(heading)
        return after.points @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T + [x, y, 0]

    moved = residuals(x, y, heading)
    f_x, f_y, c_x, c_y = before.camera
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.rint(np.nan_to_num(c_x - f_x * moved[..., 1] / moved[..., 0], nan=-1)).astype(int)
        v = np.rint(np.nan_to_num(c_y - f_y * moved[..., 2] / moved[..., 0], nan=-1)).astype(int)
    inside = (after.points[..., 0] > 0) & (moved[..., 0] >= 0.1) & (u >= 0) & (v >= 0) & (u < 64) & (v < 64)
    plane = before.planes[v.clip(0, 63), u.clip(0, 63)]
    depth = np.where(inside, moved[..., 0], 1)
    expected = ((plane * moved).sum(axis=2) - 1) / depth
    known = inside & plane[..., :2].any(axis=2) & (np.abs(expected) <= LARGEST)
    assert known.sum() > 300 and (image[4] == known).all()
    np.testing.assert_allclose(image[0][known] * INVERSE_DEPTH_SIGMA, expected[known], atol=1e-6)
    for channel, step in enumerate(np.eye(3)[:, :, None] * 1e-6, start=1):
        nearby = residuals(*(motion + step[:, 0]))
        slope = ((plane * (nearby - moved)).sum(axis=2) / 1e-6 / depth)[known]
        np.testing.assert_allclose(image[channel][known], slope, rtol=1e-4, atol=1e-4)


def test_equal_weights_are_least_squares():
    """A wall at 2 m, at 1.9 m after a motion that was measured as 8 cm: nothing is known sideways and of the angle."""
    wall, nearer = (make_scan(np.full((128, 128), depth), CAMERA) for depth in (2.0, 1.9))
    network = MotionNetwork().eval()
    with torch.no_grad():
        network.layers[-1].weight.zero_()
        network.layers[-1].bias.copy_(torch.tensor([0.0, 3.0]))
        image = residual_image(nearer, wall, np.array([0.08, 0.01, 0.0]))
        correction, information = network(torch.from_numpy(image)[None], 1e4 * torch.eye(3)[None])
    np.testing.assert_allclose(correction[0].numpy(), [0.02, 0, 0], atol=1e-3)
    assert information[0, 0, 0] > 5e5 and information[0, 1, 1] == pytest.approx(1e4)


def test_the_shipped_weights_reduce_the_errors_and_noise_in_their_place_does_not(steps, tmp_path):
    calibrated, learned = squared_errors(None, steps), squared_errors(LearnedOdometry(), steps)
    torch.manual_seed(0)
    network = MotionNetwork()
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.copy_(torch.randn_like(parameter))
    save_network(tmp_path / "noise", network, {})
    assert learned < 0.5 * calibrated
    assert squared_errors(LearnedOdometry(tmp_path / "noise"), steps) > 1.5 * learned


def test_the_covariance_is_as_large_as_the_errors(steps):
    learned, rng, distances = LearnedOdometry(), np.random.default_rng(1), []
    for before, after, true, action in steps:
        measured = MODEL.corrected(true + NOISE.odometry_error(action, rng), action)
        motion, covariance = learned.correct(after, before, measured, MODEL.covariances[action])
        distances.append((motion - true) @ np.linalg.solve(covariance, motion - true) / 3)
    assert 0.3 < np.mean(distances) < 2.5


def test_without_depth_it_is_calibrated_odometry():
    blind = make_scan(np.zeros((128, 128), np.float32), CAMERA)
    motion, covariance = np.array([0.25, 0.01, 0.0]), MODEL.covariances[Action.FORWARD]
    found, spread = LearnedOdometry().correct(blind, blind, motion, covariance)
    np.testing.assert_allclose(found, motion, atol=1e-9)
    np.testing.assert_allclose(spread, covariance, rtol=1e-4, atol=1e-12)


def test_an_image_of_elsewhere_raises_nothing(steps):
    learned, covariance = LearnedOdometry(), MODEL.covariances[Action.TURN_LEFT]
    other = make_scan(redwood(np.full((128, 128), 0.7, np.float32), np.random.default_rng(0)), CAMERA)
    motion, spread = learned.correct(other, steps[0][0], np.array([0.0, 0.0, 0.52]), covariance)
    assert np.isfinite(motion).all() and (np.linalg.eigvalsh(spread) > 0).all()
    assert np.abs(motion - [0, 0, 0.52]).max() < 0.05


def test_damaged_weights_are_named(tmp_path):
    with pytest.raises(DataError, match=r"missing.json"):
        LearnedOdometry(tmp_path / "missing")
    for suffix in (".json", ".safetensors"):
        shutil.copy(WEIGHTS.with_suffix(suffix), tmp_path / f"copy{suffix}")
    (tmp_path / "copy.safetensors").write_bytes(b"no tensors")
    with pytest.raises(DataError, match=r"copy.safetensors"):
        LearnedOdometry(tmp_path / "copy")
    (tmp_path / "copy.json").write_text('{"version": 99}')
    with pytest.raises(DataError, match="needs version 1; train the weights again"):
        LearnedOdometry(tmp_path / "copy")
    save_network(tmp_path / "other", torch.nn.Linear(2, 2), {})
    with pytest.raises(DataError, match="belongs to another network"):
        LearnedOdometry(tmp_path / "other")
    network = MotionNetwork()
    with torch.no_grad():
        network.layers[0].bias[0] = torch.nan
    save_network(tmp_path / "nan", network, {})
    with pytest.raises(DataError, match="not finite"):
        LearnedOdometry(tmp_path / "nan")


def test_the_weights_name_their_command_and_belong_to_this_code():
    meta = json.loads(WEIGHTS.with_suffix(".json").read_text())
    assert meta["command"] == "autonerf-lab train-odometry --seed 0"
    assert meta["inputs_sha256"] == inputs_sha256(), "the inputs of the network changed: train the weights again"
    assert WEIGHTS.with_suffix(".safetensors").stat().st_size < 1e6
