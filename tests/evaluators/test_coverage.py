"""Coverage of a walk against what there is to see."""

from dataclasses import replace

import numpy as np
import pytest
import toy_scene

from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.evaluators.coverage import QUANTITIES, area_under, coverage, visible_map
from autonerf_lab.geometry import Intrinsics, planar_pose
from autonerf_lab.simulator import Simulator

POSES = 40


@pytest.fixture(scope="module")
def sim() -> Simulator:
    return Simulator(toy_scene.two_rooms(), Intrinsics.from_fov(32, 32), rgb=False)


@pytest.fixture(scope="module")
def visible(sim):
    return visible_map(sim, POSES, seed=0)


def walk_of(sim: Simulator, poses: list[np.ndarray], **meta) -> Trajectory:
    images = np.zeros((len(poses), 32, 32, 3), np.uint8)
    return Trajectory(np.stack(poses), images, None, None, sim.intrinsics, meta)


def seeded_poses(sim: Simulator) -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    return [sim.sample_pose(rng) for _ in range(POSES)]


def test_who_has_been_everywhere_has_seen_everything(sim, visible):
    shares = coverage(sim, walk_of(sim, seeded_poses(sim)), visible)
    assert set(shares) == set(QUANTITIES.values())
    for curve in shares.values():
        assert curve.shape == (POSES,) and curve[-1] == 100 and (np.diff(curve) >= 0).all() and curve[0] < 50


def test_one_room_is_not_the_other(sim, visible):
    """Turning on the spot in room A, back to the doorway or not, never shows the refrigerator of room B."""
    turning = [planar_pose(2.0, 2.6 - 1.8, heading) for heading in np.linspace(np.pi / 2, 3 * np.pi / 2, 7)]
    shares = coverage(sim, walk_of(sim, turning), visible)
    assert 20 < shares["area"][-1] < 60 and shares["semantics"][-1] < 60


def test_noise_does_not_move_what_was_seen(sim, visible):
    """Odometry may err: the robot saw from where it was, not from where it believed to be."""
    poses = seeded_poses(sim)[:5]
    true = [[pose[0, 3], pose[1, 3], np.arctan2(-pose[1, 2], -pose[0, 2])] for pose in poses]
    lost = walk_of(sim, [planar_pose(0.5, 0.5, 0.0)] * 5, true_poses=true)
    for name, curve in coverage(sim, lost, visible).items():
        assert np.allclose(curve, coverage(sim, walk_of(sim, poses), visible)[name])


def test_a_scene_without_semantics_misses_none(sim, visible):
    nothing = replace(visible, semantics=np.zeros_like(visible.semantics))
    assert (coverage(sim, walk_of(sim, seeded_poses(sim)[:2]), nothing)["semantics"] == 100).all()


def test_area_under_a_curve_by_hand():
    assert area_under(np.array([0.0, 50.0, 100.0, 100.0])) == 62.5
