"""Online pose estimation in a toy scene: loops, a blind robot, a kidnapped one, and a policy that sees the estimate."""

from dataclasses import replace

import numpy as np
import pytest
import toy_scene

from autonerf_lab.data.trajectory import load_trajectory
from autonerf_lab.errors import DataError, UnknownNameError
from autonerf_lab.exploration import explore
from autonerf_lab.exploration.rollout import POSES
from autonerf_lab.geometry import Intrinsics, planar_pose
from autonerf_lab.localization import ESTIMATORS, OdometryModel, PoseEstimator, estimate_poses
from autonerf_lab.localization.alignment import trajectory_errors
from autonerf_lab.localization.se2 import between, to_planar
from autonerf_lab.policies.base import Policy
from autonerf_lab.simulator import Simulator
from autonerf_lab.simulator.motion_noise import MotionNoise

CAMERA = Intrinsics.from_fov(64, 64)
SQUARE = [0, 0, 0, 0, 1, 1, 1] * 8  # there and back along a side, with quarter turns


class Square(Policy):
    """Drive in a square, and record the poses and maps that the policy sees."""

    def reset(self, rng):
        self.seen, self.maps = [], []

    def act(self, map, observation):
        self.seen.append(observation.pose)
        self.maps.append(map)
        return SQUARE[observation.step]


@pytest.fixture(scope="module")
def sim():
    return Simulator(toy_scene.two_rooms(), CAMERA, rgb=False, noise=MotionNoise(), depth_noise="redwood")


@pytest.fixture(scope="module")
def recorded(sim):
    return explore(sim, Square(), len(SQUARE), progress=False, pose=planar_pose(2.4, 0.6, 0.0))


def errors(trajectory):
    return trajectory_errors(to_planar(trajectory.poses), to_planar(trajectory.pose_sources["true"]))


def test_each_step_of_the_ladder_is_better(recorded):
    odometry = errors(recorded)
    found = {name: errors(estimate_poses(recorded, name)) for name in ESTIMATORS}
    calibrated, learned, graph = (found[name] for name in ("calibrated", "learned", "pose-graph"))
    assert calibrated.heading_error_deg < 0.3 * odometry.heading_error_deg
    assert learned.heading_error_deg < calibrated.heading_error_deg and learned.ate_m < calibrated.ate_m
    assert graph.ate_m < 0.02 < odometry.ate_m and graph.heading_error_deg < 0.5


def test_the_policy_sees_the_estimate_and_its_map(sim, recorded, tmp_path):
    policy = Square()
    trajectory = explore(sim, policy, len(SQUARE), progress=False, pose=planar_pose(2.4, 0.6, 0.0), poses="estimated")
    assert list(trajectory.pose_sources) == ["true", "odometry", "estimated"]
    seen, true = to_planar(np.array(policy.seen)), to_planar(trajectory.other_poses["true"])
    assert 0 < np.abs(seen - true)[:, :2].max() < 0.05
    np.testing.assert_array_equal(policy.maps[-1].pose, policy.seen[-1])
    np.testing.assert_array_equal(trajectory.other_poses["odometry"], recorded.poses)
    np.testing.assert_allclose(trajectory.poses, estimate_poses(recorded).poses)  # the same on a recording
    assert np.array(trajectory.meta["pose_std"]).shape == (len(SQUARE), 3)
    trajectory.save(tmp_path)
    np.testing.assert_array_equal(load_trajectory(tmp_path).with_poses("odometry").poses, recorded.poses)


def test_true_poses_can_be_used(sim, recorded):
    policy = Square()
    trajectory = explore(sim, policy, 12, progress=False, pose=planar_pose(2.4, 0.6, 0.0), poses="true")
    np.testing.assert_array_equal(np.array(policy.seen), trajectory.poses)
    np.testing.assert_array_equal(trajectory.poses, recorded.other_poses["true"][:12])
    exact = explore(Simulator(sim.scene, CAMERA, rgb=False), Square(), 3, progress=False, poses="true")
    assert (exact.pose_source, exact.other_poses) == ("true", {})


def follow(recorded, depth):
    """Run the estimator with other depth images; return it, and pose, deviations and covariance of each step."""
    estimator = PoseEstimator(CAMERA, OdometryModel.from_noise(MotionNoise()))
    observations = [
        replace(observation, depth=image) for observation, image in zip(_observations(recorded), depth, strict=True)
    ]
    estimator.start(observations[0])
    steps = []
    for observation, action in zip(observations[1:], SQUARE, strict=False):
        estimator.update(observation, action)
        steps.append((estimator.pose, np.sqrt(np.diag(estimator.covariance)), estimator.covariance))
    return estimator, steps


def _observations(recorded):
    from autonerf_lab.types import Observation

    blank = np.zeros((64, 64), np.uint8)
    return [Observation(blank, d, blank, pose) for d, pose in zip(recorded.depth, recorded.poses, strict=True)]


def test_a_blind_robot_is_calibrated_odometry_and_grows_uncertain(recorded):
    estimator, steps = follow(recorded, np.zeros_like(recorded.depth))
    expected = estimate_poses(recorded, "calibrated").poses
    np.testing.assert_allclose(estimator.trajectory, expected, atol=1e-6)
    spread = np.array([deviations for _, deviations, _ in steps])
    assert (np.diff(spread[:, 2]) > 0).all() and spread[-1, 2] > 0.01


def test_a_kidnapped_robot_says_that_it_is_lost(recorded):
    depth = recorded.depth.copy()
    depth[20:] = depth[:36][::-1]  # images of elsewhere
    _, steps = follow(recorded, depth)
    spread = np.array([np.hypot(*deviations[:2]) for _, deviations, _ in steps])
    assert spread[:18].max() < 0.05 and spread[20:].max() > 0.3


def test_the_covariance_is_as_large_as_the_errors(recorded):
    """The mean of the normalised squared errors is the number of components, 3, for covariances that are right."""
    _, steps = follow(recorded, recorded.depth)
    true = to_planar(recorded.other_poses["true"][1:])
    error = between(true, np.array([pose for pose, _, _ in steps]))
    c, s = np.cos(true[:, 2]), np.sin(true[:, 2])
    error[:, 0], error[:, 1] = c * error[:, 0] - s * error[:, 1], s * error[:, 0] + c * error[:, 1]
    covariances = np.array([covariance for _, _, covariance in steps])
    assert 0.1 < np.einsum("ti,tij,tj->t", error, np.linalg.inv(covariances), error).mean() / 3 < 2.5


def test_what_cannot_be_estimated_is_refused(sim, recorded):
    with pytest.raises(UnknownNameError, match="pose estimator 'slam'"):
        estimate_poses(recorded, "slam")
    with pytest.raises(DataError, match="without depth"):
        estimate_poses(replace(recorded, depth=None))
    with pytest.raises(DataError, match="'actions' or 'noise' is missing"):
        estimate_poses(replace(recorded, meta={}))
    with pytest.raises(DataError, match="there are no 'odometry' poses, only true"):
        estimate_poses(replace(recorded, pose_source="true", other_poses={}))
    with pytest.raises(DataError, match="there are no 'refined' poses"):
        explore(sim, "random", 2, poses="refined")
    with pytest.raises(UnknownNameError, match="pose source 'gps'"):
        explore(sim, "random", 2, poses="gps")
    assert "refined" not in POSES
