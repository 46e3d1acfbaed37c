"""Refinement of rough poses: drift of a small trajectory, photographs, uncertainty, and data that cannot be refined."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import toy_photos
from numpy.testing import assert_allclose

from autonerf_lab import cli
from autonerf_lab.bundle_adjustment import describe_refinement, pose_deviations, refine_poses
from autonerf_lab.bundle_adjustment.adjustment import SPATIAL, moved
from autonerf_lab.bundle_adjustment.refine import with_mean
from autonerf_lab.data.dataset import Dataset
from autonerf_lab.data.trajectory import Trajectory, load_trajectory
from autonerf_lab.errors import DataError
from autonerf_lab.exploration import explore
from autonerf_lab.geometry import Intrinsics, is_planar, planar_from_pose, planar_pose, rotation_angle
from autonerf_lab.localization.se2 import to_planar
from autonerf_lab.localization.trajectory_alignment import trajectory_errors
from autonerf_lab.scenes import load_scene
from autonerf_lab.simulator import Simulator
from autonerf_lab.simulator.motion_noise import MotionNoise

CAMERA = Intrinsics.from_fov(128, 128)
FRAMES = 60


def drift(poses: np.ndarray, size: float = 0.08, turn: float = 0.02) -> np.ndarray:
    """Return planar poses with a smooth drift of about ``size`` metres and ``turn`` radians, and 3 mm of noise."""
    t = np.linspace(0, 2 * np.pi, len(poses))
    waves = np.stack([np.sin(t), 1 - np.cos(0.7 * t), np.sin(0.6 * t)], axis=1) * [size, size, turn]
    waves[1:] += np.random.default_rng(0).normal(0, [0.003, 0.003, 0.001], (len(poses) - 1, 3))
    return np.stack([planar_pose(*(planar_from_pose(p) + w)) for p, w in zip(poses, waves, strict=True)])


@pytest.fixture(scope="module")
def trajectory() -> Trajectory:
    sim = Simulator(load_scene("train-00"), CAMERA, 1, noise=MotionNoise(odometry=False), depth_noise="redwood")
    exact = explore(sim, "frontier", steps=FRAMES, seed=1, progress=False)
    return replace(exact, pose_source="true", other_poses={}).with_poses("estimated", drift(exact.poses))


@pytest.fixture(scope="module")
def refined(trajectory: Trajectory) -> Trajectory:
    return refine_poses(trajectory, progress=False)


def errors(views: Trajectory | Dataset, true: np.ndarray) -> tuple[float, float]:
    """Return the root mean squares of the position errors, metres, and of the rotation errors, radians."""
    distance = np.linalg.norm(views.poses[:, :3, 3] - true[:, :3, 3], axis=1)
    return float(np.sqrt((distance**2).mean())), float(np.sqrt((rotation_angle(views.poses, true) ** 2).mean()))


def test_the_drift_of_a_robot_shrinks_to_millimetres(trajectory: Trajectory, refined: Trajectory) -> None:
    true = trajectory.pose_sources["true"]
    before, after = errors(trajectory, true), errors(refined, true)
    assert before[0] > 0.1 and before[1] > 0.01
    assert after[0] < 0.015 and after[1] < 0.003
    assert is_planar(refined.poses)
    assert_allclose(refined.poses[0], trajectory.poses[0], atol=1e-6)
    assert list(refined.pose_sources) == ["true", "estimated", "refined"] and refined.pose_source == "refined"
    text = describe_refinement(trajectory, refined)
    assert "corrections: " in text and "standard deviation: " in text


def test_refinement_repeats_bit_for_bit_and_leaves_the_input_alone(trajectory: Trajectory, refined: Trajectory) -> None:
    before = trajectory.poses.copy()
    again = refine_poses(trajectory, progress=False)
    assert (again.poses == refined.poses).all() and (trajectory.poses == before).all()
    assert "refined_covariance" not in trajectory.meta


def test_uncertainty_grows_with_blind_frames(trajectory: Trajectory, refined: Trajectory) -> None:
    """Ten frames without depth and with black images: odometry alone carries their poses."""
    assert trajectory.depth is not None
    depth, rgb = trajectory.depth.copy(), trajectory.rgb.copy()
    depth[20:30], rgb[20:30] = 0, 0
    blind = refine_poses(replace(trajectory, depth=depth, rgb=rgb), progress=False)
    position, rotation = pose_deviations(blind)
    seen, _ = pose_deviations(refined)
    assert (position > 0).all() and (rotation > 0).all() and seen.max() < 0.01
    assert position[20:30].min() > 1.4 * seen[20:30].max()
    assert position[24] > 1.3 * max(position[20], position[29])
    assert (
        errors(blind, trajectory.pose_sources["true"])[0] < 0.5 * errors(trajectory, trajectory.pose_sources["true"])[0]
    )


def test_the_covariance_is_as_large_as_the_errors(trajectory: Trajectory, refined: Trajectory) -> None:
    """The mean of the normalised squared errors is the number of components, 3, for covariances that are right."""
    found = trajectory_errors(to_planar(refined.poses), to_planar(trajectory.pose_sources["true"]))
    error = found.aligned - to_planar(trajectory.pose_sources["true"])
    error[:, 2] = np.radians(found.headings)
    covariances = np.array(refined.meta["refined_covariance"])
    assert 0.1 < np.einsum("ti,tij,tj->t", error, np.linalg.inv(covariances), error).mean() / 3 < 2


def test_photographs_with_depth_in_any_order_and_scale(trajectory: Trajectory) -> None:
    """Independent noise of 3 cm and 1 degree in all six directions; units of 10 cm and another origin."""
    rng, true = np.random.default_rng(1), trajectory.pose_sources["true"]
    order = rng.permutation(FRAMES)
    noise = rng.normal(0, [0.03] * 3 + [0.017] * 3, (FRAMES, 6))
    poses = moved(true, noise, SPATIAL)[order]
    assert trajectory.depth is not None
    views = Dataset.from_trajectory(replace(trajectory, poses=poses, rgb=trajectory.rgb[order]))
    depths = [10 * trajectory.depth[t] for t in order]
    poses[:, :3, 3] = 10 * poses[:, :3, 3] + 50
    found = refine_poses(replace(views, poses=poses, depths=depths, metric=False), progress=False)
    assert found.pose_source == "refined" and not is_planar(found.poses)
    wanted = true[order]
    wanted[:, :3, 3] = 10 * wanted[:, :3, 3] + 50
    before = errors(replace(views, poses=poses), wanted)
    after = errors(replace(found, poses=with_mean(found.poses, wanted)), wanted)
    assert after[0] < 0.4 * before[0] and after[1] < 0.4 * before[1]
    assert pose_deviations(found)[0].shape == (FRAMES,)


def test_too_few_overlapping_views_are_one_clear_error(trajectory: Trajectory) -> None:
    with pytest.raises(DataError, match="0 of 60 views overlap with another one at their rough poses"):
        refine_poses(replace(trajectory, depth=np.zeros_like(trajectory.depth)), progress=False)
    one = Dataset.from_trajectory(trajectory)._take([0])
    with pytest.raises(DataError, match="1 view: poses are refined against other views; two or more"):
        refine_poses(one, progress=False)
    with pytest.raises(DataError, match="no covariance: they were not refined"):
        pose_deviations(trajectory)


def test_command_line_saves_rough_and_refined_poses(trajectory: Trajectory, tmp_path: Path, capsys) -> None:
    trajectory.save(tmp_path / "rough")
    assert cli.main(["refine-poses", str(tmp_path / "rough"), "--out", str(tmp_path / "refined")]) == 0
    assert "least certain: frame" in capsys.readouterr().out
    saved = load_trajectory(tmp_path / "refined")
    assert list(saved.pose_sources) == ["true", "estimated", "refined"] and saved.pose_source == "refined"
    true = trajectory.pose_sources["true"]
    assert errors(saved, true)[0] < 0.2 * errors(trajectory, true)[0]
    assert pose_deviations(saved)[0].max() < 0.05


def test_colour_alone_improves_photographs_and_tells_which_are_black() -> None:
    """Balls before a sky, noise of 0.2 units and 1.5 degrees; the last photograph is black."""
    data = toy_photos.photographs(toy_photos.orbit(28))
    rough = moved(data.poses, np.random.default_rng(2).normal(0, [0.1] * 3 + [0.02] * 3, (len(data), 6)), SPATIAL)
    images = [*data.images[:-1], np.zeros_like(data.images[-1])]
    found = refine_poses(replace(data, poses=rough, images=images), preset="smoke", steps=300, progress=False)
    assert found.pose_source == "refined" and found.poses.shape == rough.shape
    true = data.poses[:-1]
    seen = replace(data, poses=with_mean(found.poses[:-1], true))
    before = errors(replace(data, poses=with_mean(rough[:-1], true)), true)
    assert errors(seen, true)[0] < 0.9 * before[0]
    position, _ = pose_deviations(found)
    assert position[-1] > 3 * np.median(position[:-1])


@pytest.mark.parametrize(("planar", "level"), [(None, True), (True, True), (False, False)])
def test_colour_alone_moves_cameras_in_the_plane_or_in_space(planar: bool | None, level: bool) -> None:
    poses = np.stack([planar_pose(0.2 * k, -2.5, 1.2 + 0.05 * k) for k in range(6)])
    found = refine_poses(toy_photos.photographs(poses), planar=planar, preset="smoke", steps=20, progress=False)
    assert not np.allclose(found.poses, poses, atol=1e-5)
    assert np.allclose(found.poses[:, 2, 3], poses[:, 2, 3], atol=1e-6) == level


def test_black_photographs_leave_the_poses_unknown_and_raise_nothing() -> None:
    data = toy_photos.photographs(toy_photos.orbit(6))
    black = replace(data, images=[np.zeros_like(image) for image in data.images])
    found = refine_poses(black, preset="smoke", steps=10, progress=False)
    assert np.isfinite(found.poses).all()
    assert pose_deviations(found)[0].min() > 1000 * np.ptp(data.poses[:, :3, 3])
