"""Coverage of a trajectory, compared with everything that is visible."""

import inspect
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import toy_scene

from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.evaluators.coverage import QUANTITIES, area_under, coverage
from autonerf_lab.exploration import visible_map
from autonerf_lab.geometry import Intrinsics, planar_pose
from autonerf_lab.mapping import update
from autonerf_lab.simulator import Simulator
from autonerf_lab.types import Observation

POSES = 40


@pytest.fixture(scope="module")
def sim() -> Simulator:
    return Simulator(toy_scene.two_rooms(), Intrinsics.from_fov(32, 32), rgb=False)


@pytest.fixture(scope="module")
def visible(sim):
    return visible_map(sim, POSES, seed=0)


def test_the_map_extends_one_metre_beyond_the_scene():
    """A scene of 6 x 4 m around (5, 3): 8 m in cells of 5 cm, so the corner is at (1, -1)."""
    scene = SimpleNamespace(bounds=np.array([[2.0, 1.0, 0.0], [8.0, 5.0, 2.5]]))
    blank = visible_map(SimpleNamespace(scene=scene, intrinsics=Intrinsics.from_fov(8, 8)), poses=0)
    assert blank.explored.shape == (160, 160) and not blank.explored.any()
    np.testing.assert_allclose(blank.origin, [1, -1], atol=1e-9)


def test_the_visible_map_of_the_protocol_has_2000_poses_of_seed_0():
    parameters = inspect.signature(visible_map).parameters
    assert (parameters["poses"].default, parameters["seed"].default) == (2000, 0)


def trajectory_of(sim: Simulator, poses: list[np.ndarray]) -> Trajectory:
    return Trajectory(np.stack(poses), np.zeros((len(poses), 32, 32, 3), np.uint8), None, None, sim.intrinsics)


def seeded_poses(sim: Simulator) -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    return [sim.sample_pose(rng) for _ in range(POSES)]


def test_full_coverage_from_the_poses_of_the_visible_map(sim, visible):
    shares = coverage(sim, trajectory_of(sim, seeded_poses(sim)), visible)
    assert set(shares) == set(QUANTITIES.values())
    for curve in shares.values():
        assert curve.shape == (POSES,) and curve[-1] == 100 and (np.diff(curve) >= 0).all() and curve[0] < 50


def test_one_room_does_not_cover_the_other(sim, visible):
    """Images from one position in room A do not show the refrigerator of room B."""
    rotating = [planar_pose(2.0, 2.6 - 1.8, heading) for heading in np.linspace(np.pi / 2, 3 * np.pi / 2, 7)]
    shares = coverage(sim, trajectory_of(sim, rotating), visible)
    assert 20 < shares["area"][-1] < 60 and shares["semantics"][-1] < 60


def test_cells_that_are_not_in_the_visible_map_do_not_count(sim, visible):
    """A robot in room A, with its back to the doorway, maps none of the cells of room B."""
    room_b = visible.origin[0] + (np.arange(len(visible.explored)) + 0.5) * visible.cell > 4.2
    part = {name: getattr(visible, name) & room_b for name in QUANTITIES}
    shares = coverage(sim, trajectory_of(sim, [planar_pose(2.0, 1.5, np.pi)] * 2), replace(visible, **part))
    assert all(getattr(visible, name)[..., ~room_b].any() and part[name].any() for name in QUANTITIES)
    for curve in shares.values():
        assert curve.tolist() == [0, 0]


def test_coverage_is_the_percentage_of_the_visible_cells(sim, visible):
    """Compared with a map that is updated and counted here."""
    poses = [planar_pose(2.0, 1.5, heading) for heading in (np.pi, 0.0)]
    known = replace(visible, **{name: np.zeros_like(getattr(visible, name)) for name in (*QUANTITIES, "visited")})
    curves = coverage(sim, trajectory_of(sim, poses), visible)
    for t, pose in enumerate(poses):
        frame = sim.render(pose)
        known = update(known, Observation(frame.rgb, frame.depth, frame.semantics, pose), sim.intrinsics)
        for name, curve in QUANTITIES.items():
            total, seen = getattr(visible, name), getattr(known, name)
            assert curves[curve][t] == pytest.approx(100 * (total & seen).sum() / total.sum())


def test_coverage_uses_the_true_poses(sim, visible):
    """The camera is at the true pose, not at the pose of the odometry."""
    poses = seeded_poses(sim)[:5]
    drifted = trajectory_of(sim, poses).with_poses("odometry", np.stack([planar_pose(0.5, 0.5, 0.0)] * 5))
    for name, curve in coverage(sim, drifted, visible).items():
        assert np.allclose(curve, coverage(sim, trajectory_of(sim, poses), visible)[name])


def test_a_scene_without_semantics_has_full_semantic_coverage(sim, visible):
    without = replace(visible, semantics=np.zeros_like(visible.semantics))
    assert (coverage(sim, trajectory_of(sim, seeded_poses(sim)[:2]), without)["semantics"] == 100).all()


def test_area_under_a_curve_by_hand():
    assert area_under(np.array([0.0, 50.0, 100.0, 100.0])) == 62.5
