"""Pose graph and odometry: minima by hand, a loop, an outlier, covariances against samples."""

import numpy as np
import pytest

from autonerf_lab.localization.odometry import OdometryModel
from autonerf_lab.localization.pose_graph import PoseGraph
from autonerf_lab.localization.se2 import between, compose, moved_covariance, to_matrices, to_planar
from autonerf_lab.simulator.motion_noise import MotionNoise
from autonerf_lab.types import Action


def test_compose_and_between_are_inverse():
    rng = np.random.default_rng(0)
    a, b = rng.uniform(-1.5, 1.5, (2, 50, 3))
    np.testing.assert_allclose(compose(a, between(a, b)), b, atol=1e-12)
    np.testing.assert_allclose(to_planar(to_matrices(a)), a, atol=1e-12)


def test_a_closed_square_is_found_from_drifting_motions():
    side = np.array([1.0, 0.0, np.pi / 2])
    graph = PoseGraph(np.zeros(3))
    for i in range(4):
        measured = side + np.array([0.05, 0.0, 0.02])
        graph.add_edge(i, graph.add_pose(compose(graph.poses[i], measured)), measured, np.eye(3))
    graph.add_edge(4, 0, np.array([0.0, 0.0, 0.0]), 1e6 * np.eye(3))
    graph.optimize(10)
    end = between(graph.poses[0], graph.poses[4])
    np.testing.assert_allclose(end, 0, atol=1e-4)
    # The error is shared by all sides alike.
    sides = np.linalg.norm(np.diff(graph.poses[:, :2], axis=0), axis=1)
    np.testing.assert_allclose(sides, sides.mean(), atol=1e-2)


def test_a_gradient_moves_the_minimum_of_an_edge():
    """1/2 * 4 d**2 - 2 d is smallest at d = 0.5."""
    graph = PoseGraph(np.zeros(3))
    node = graph.add_pose(np.array([1.0, 0.0, 0.0]))
    graph.add_edge(0, node, np.array([1.0, 0.0, 0.0]), np.diag([4.0, 4.0, 4.0]), np.array([-2.0, 0.0, 0.0]))
    covariance = graph.optimize(5)
    np.testing.assert_allclose(graph.poses[node], [1.5, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(covariance, np.eye(3) / 4, atol=1e-6)


def test_a_wrong_loop_closure_loses_its_weight():
    graph = PoseGraph(np.zeros(3))
    for i in range(10):
        graph.add_edge(i, graph.add_pose(np.array([i + 1.0, 0, 0])), np.array([1.0, 0, 0]), 1e4 * np.eye(3))
    graph.add_edge(0, 10, np.array([5.0, 0.0, 0.0]), 1e4 * np.eye(3))
    graph.optimize(5)
    assert abs(graph.poses[10, 0] - 10) < 0.05


@pytest.mark.parametrize("action", Action)
def test_moments_of_odometry_are_those_of_its_samples(action):
    noise, rng = MotionNoise(scale=2.0), np.random.default_rng(0)
    samples = np.array([noise.odometry_error(action, rng) for _ in range(4000)])
    mean, covariance = noise.odometry_moments(action)
    np.testing.assert_allclose(samples.mean(axis=0), mean, atol=4 * np.sqrt(np.diag(covariance).max() / 4000))
    np.testing.assert_allclose(np.cov(samples.T), covariance, atol=0.1 * np.diag(covariance).max())


def test_calibration_removes_the_bias_and_knows_what_remains():
    model, noise, ends = OdometryModel.from_noise(MotionNoise()), MotionNoise(), []
    actions = [Action.FORWARD, Action.TURN_LEFT] * 12
    for seed in range(60):
        rng, true = np.random.default_rng(seed), np.zeros(3)
        pose, covariance = np.zeros(3), np.zeros((3, 3))
        for action in actions:
            motion = np.array(noise.motion(action, rng))
            true = compose(true, motion)
            step = model.corrected(motion + noise.odometry_error(action, rng), action)
            covariance = moved_covariance(pose, covariance, step, model.covariances[action])
            pose = compose(pose, step)
        ends.append(pose - true)
    error = np.array(ends)
    spread = np.sqrt(np.diag(covariance))
    assert (np.abs(error.mean(axis=0)) < 3 * spread / np.sqrt(60)).all()
    np.testing.assert_allclose(error.std(axis=0), spread, rtol=0.4)
