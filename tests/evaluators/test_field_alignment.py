"""Fields of estimated poses: alignment with the scene, the task ``trajectory``, and frames that cannot be aligned."""

from dataclasses import replace

import numpy as np
import pytest
import toy_scene

from autonerf_lab.data.dataset import Dataset
from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.errors import DataError
from autonerf_lab.evaluators import TrueField, evaluate
from autonerf_lab.evaluators.field_alignment import AlignedField, aligned_data, aligned_field
from autonerf_lab.evaluators.tasks import default_tasks
from autonerf_lab.geometry import Intrinsics, planar_pose
from autonerf_lab.localization.se2 import compose, to_matrices, to_planar
from autonerf_lab.nerf import fit
from autonerf_lab.viz import figures

MOTION = np.array([0.4, -0.3, 0.5])
CAMERA = Intrinsics.from_fov(24, 24)


class Waves:
    """Field with a known colour error of rays: its gradients can be checked with finite differences."""

    poses, intrinsics, meta, classes, frame = to_matrices(np.zeros((2, 3))), CAMERA, {}, 0, None

    def ray_gradients(self, rays_o, rays_d, target):
        error = np.sin(rays_o).sum(axis=1) + np.cos(2 * rays_d).sum(axis=1)
        return error, np.cos(rays_o), -2 * np.sin(2 * rays_d)


@pytest.fixture(scope="module")
def scene():
    return toy_scene.two_rooms()


@pytest.fixture(scope="module")
def truth(scene):
    return TrueField(scene, views=6)


@pytest.fixture(scope="module")
def drifted(truth):
    """The true field in another frame, with the metadata of a field that was trained there."""
    field = AlignedField(truth, MOTION)
    rows = to_planar(truth.poses).tolist()
    field.meta = {**truth.meta, "pose_source": "estimated", "true_poses": rows}
    return field


def test_an_aligned_field_answers_in_the_frame_of_the_scene(truth, drifted):
    field = aligned_field(drifted)
    np.testing.assert_allclose(field.poses, truth.poses, atol=1e-9)
    points = np.random.default_rng(0).uniform([0, 0, 0], [8, 3, 2.5], (200, 3))
    for name in ("density", "semantics", "seen"):
        same = (getattr(field, name)(points) == getattr(truth, name)(points)).reshape(200, -1).all(axis=1)
        assert same.mean() > 0.98, name  # points on a border fall to either side
    views = [made.render(truth.poses[2], CAMERA) for made in (field, truth)]
    assert np.mean(views[0].depth - views[1].depth < 1e-4) > 0.98
    assert np.mean(views[0].semantics == views[1].semantics) > 0.98


def test_gradients_turn_with_the_field():
    field, rng = AlignedField(Waves(), MOTION), np.random.default_rng(0)
    rays = rng.normal(size=(2, 4, 3))
    _, *gradients = field.ray_gradients(*rays, np.zeros((4, 3)))
    for part in range(2):
        for axis in range(3):
            ends = []
            for step in (1e-6, -1e-6):
                moved = rays.copy()
                moved[part, :, axis] += step
                ends.append(field.ray_gradients(*moved, np.zeros((4, 3)))[0])
            np.testing.assert_allclose((ends[0] - ends[1]) / 2e-6, gradients[part][:, axis], atol=1e-6)


def test_a_rigid_motion_of_all_poses_costs_no_score(scene, truth, drifted):
    """Without alignment, the moved field would score like noise."""
    scores, expected = (evaluate(f, scene, "smoke", tasks=["rendering"], progress=False) for f in (drifted, truth))
    assert scores["rendering", "per_class_accuracy"] > 0.97 * expected["rendering", "per_class_accuracy"]


def test_trajectory_task_by_hand(scene, truth, drifted):
    scores = evaluate(drifted, scene, "smoke", tasks=["trajectory"], progress=False)
    assert scores["trajectory", "ate_m"] == pytest.approx(0, abs=1e-9)
    assert scores["trajectory", "heading_error_deg"] == pytest.approx(0, abs=1e-6)
    true, moved = to_planar(truth.poses), compose(MOTION, to_planar(truth.poses))
    expected = np.sqrt(np.square(moved - true)[:, :2].sum(axis=1).mean())
    assert scores["trajectory", "ate_unaligned_m"] == pytest.approx(expected)
    details = scores.details["trajectory"]
    back = np.array([details["alignment"][key] for key in ("x_m", "y_m", "heading_rad")])
    np.testing.assert_allclose(compose(back, moved), true, atol=1e-5)
    assert details["pose_source"] == "estimated"
    assert len(figures.trajectory_drift(scores.artifacts["trajectory"]).axes) == 3
    plain = evaluate(truth, scene, "smoke", tasks=["trajectory"], progress=False)
    assert {row.status for row in plain} == {"the training poses are the true ones"}


def test_frames_that_cannot_be_aligned_are_refused(scene, drifted):
    for meta, message in (
        ({"pose_source": "refined"}, "in the frame of its refined poses, which cannot be aligned"),
        ({"pose_source": "refined", "true_poses": [[0, 0]]}, "'true_poses' of this field must be 6 rows"),
        ({"pose_source": "refined", "true_poses": [["x"] * 3] * 6}, "'true_poses' of this field must be 6 rows"),
    ):
        field = AlignedField(drifted, MOTION)
        field.meta = meta
        with pytest.raises(DataError, match=message):
            evaluate(field, scene, "smoke", progress=False)


def test_fields_and_baselines_know_their_pose_source():
    true = np.stack([planar_pose(0.1 * t, 0.0, 0.0) for t in range(4)])
    images = np.random.default_rng(0).integers(0, 255, (4, 24, 24, 3), dtype=np.uint8)
    exact = Trajectory(true, images, None, None, CAMERA, {"scene": "toy"})
    measured = exact.with_poses("odometry", to_matrices(compose(MOTION, to_planar(true))))
    field = fit(measured, steps=2, preset="smoke", progress=False)
    assert field.meta["pose_source"] == "odometry" and default_tasks(field.meta)[-1] == "trajectory"
    np.testing.assert_allclose(field.meta["true_poses"], to_planar(true))
    np.testing.assert_allclose(aligned_field(field).poses, true, atol=1e-9)
    for data in (measured, Dataset.from_trajectory(measured)):
        np.testing.assert_allclose(aligned_data(data).poses, true, atol=1e-9)
    assert aligned_data(exact) is exact
    unknown = replace(measured, other_poses={})
    assert aligned_data(unknown) is unknown
    assert not {"pose_source", "true_poses"} & fit(exact, steps=2, preset="smoke", progress=False).meta.keys()
