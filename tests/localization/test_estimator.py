"""Online pose estimation in a toy scene: loops, a blind robot, a kidnapped one, and a policy that sees the estimate."""

from dataclasses import replace

import numpy as np
import pytest
import toy_scene

from autonerf_lab.data.trajectory import load_trajectory
from autonerf_lab.errors import DataError, UnknownNameError
from autonerf_lab.exploration import explore, rollout
from autonerf_lab.exploration.rollout import POSES
from autonerf_lab.geometry import Intrinsics, planar_pose
from autonerf_lab.localization import ESTIMATORS, OdometryModel, PoseEstimator, estimate_poses
from autonerf_lab.localization.se2 import between, to_planar
from autonerf_lab.localization.trajectory_alignment import trajectory_errors
from autonerf_lab.mapping.semantic_map import Mapper, empty_map
from autonerf_lab.policies.base import Policy
from autonerf_lab.simulator import Simulator
from autonerf_lab.simulator.motion_noise import MotionNoise
from autonerf_lab.types import Observation

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


def follow(recorded, depth, name="pose-graph"):
    """Run an estimator with other depth images; return it, and pose, deviations and covariance of each step."""
    estimator = ESTIMATORS[name](CAMERA, OdometryModel.from_noise(MotionNoise()))
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
    blank = np.zeros((64, 64), np.uint8)
    return [Observation(blank, d, blank, pose) for d, pose in zip(recorded.depth, recorded.poses, strict=True)]


@pytest.mark.parametrize("name", ESTIMATORS)
def test_a_blind_robot_is_calibrated_odometry_and_grows_uncertain(recorded, name):
    estimator, steps = follow(recorded, np.zeros_like(recorded.depth), name)
    estimator.finish()
    expected = estimate_poses(recorded, "calibrated").poses
    np.testing.assert_allclose(estimator.trajectory, expected, atol=1e-6)
    spread = np.array([deviations for _, deviations, _ in steps])
    assert (np.diff(spread[:, 2]) > 0).all() and spread[-1, 2] > 0.01


@pytest.mark.parametrize("name", ESTIMATORS)
def test_a_kidnapped_robot_says_that_it_is_lost_and_stays_so_when_it_is_blind(recorded, name):
    depth = recorded.depth.copy()
    depth[20:], depth[45:] = depth[:36][::-1], 0  # images of elsewhere, then none
    estimator, steps = follow(recorded, depth, name)
    estimator.finish()
    true = to_planar(recorded.other_poses["true"])
    true[20:] = true[:36][::-1]
    error = np.linalg.norm([pose[:2] for pose, _, _ in steps] - true[1:, :2], axis=1)
    spread = np.array([np.hypot(*deviations[:2]) for _, deviations, _ in steps])
    assert spread[:18].max() < 0.05 and error[19:].max() > 1 and np.isfinite(estimator.trajectory).all()
    if name == "calibrated":  # sees no images, and cannot notice
        assert spread.max() < 0.05
    else:
        assert spread[19:].min() > 0.5 and (error < 3 * spread).all()


def test_no_false_alarm_without_kidnapping(recorded):
    for name in ESTIMATORS:
        _, steps = follow(recorded, recorded.depth, name)
        assert max(np.hypot(*deviations[:2]) for _, deviations, _ in steps) < 0.05


def test_maps_are_drawn_again_when_earlier_poses_are_corrected(sim, monkeypatch):
    """A toy estimator finds at the fifth step that all poses were a metre off."""

    class Late(PoseEstimator):
        def start(self, observation):
            self.found, self.revision = [observation.pose], 0

        def update(self, observation, action):
            shift = np.array([1.0, 0, 0]) if self.revision else np.zeros(3)
            self.found.append(observation.pose + np.pad(shift[:, None], ((0, 1), (3, 0))))
            if len(self.found) == 6:
                self.revision = 1
                for pose in self.found:
                    pose[0, 3] += 1.0

        def finish(self):
            pass

        standard_deviations = (0.0, 0.0, 0.0)

        @property
        def c2w(self):
            return self.found[-1]

        @property
        def trajectory(self):
            return np.array(self.found)

    monkeypatch.setattr(rollout, "PoseEstimator", Late)
    policy = Square()
    trajectory = explore(sim, policy, 9, progress=False, pose=planar_pose(2.4, 0.6, 0.0), poses="estimated")
    mapper = Mapper(empty_map(trajectory.poses[0], rollout.MAP_SIZE), CAMERA, grows=True)
    for pose, depth, labels in zip(trajectory.poses, trajectory.depth, trajectory.semantics, strict=True):
        _, expected = mapper.add(Observation(labels, depth, labels, pose))
    for name in ("explored", "occupied", "semantics", "visited"):
        np.testing.assert_array_equal(getattr(policy.maps[-1], name), getattr(expected, name))
    np.testing.assert_allclose(expected.origin - policy.maps[4].origin, [1, 0], atol=0.05)


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
    with pytest.raises(DataError, match=r"noise of the trajectory has other keys.*'wind'"):
        estimate_poses(replace(recorded, meta=recorded.meta | {"noise": {"wind": 1}}))
    with pytest.raises(DataError, match="there are no 'odometry' poses, only true"):
        estimate_poses(replace(recorded, pose_source="true", other_poses={}))
    with pytest.raises(DataError, match="there are no 'refined' poses"):
        explore(sim, "random", 2, poses="refined")
    with pytest.raises(UnknownNameError, match="pose source 'gps'"):
        explore(sim, "random", 2, poses="gps")
    assert "refined" not in POSES
