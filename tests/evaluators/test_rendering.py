"""Rendering and pose refinement: metrics compared with other libraries, gradients with finite differences."""

import numpy as np
import pytest
import torch
import toy_scene
from skimage.metrics import peak_signal_noise_ratio as skimage_psnr
from torchmetrics.functional.classification import (
    multiclass_accuracy,
    multiclass_confusion_matrix,
    multiclass_jaccard_index,
)
from torchmetrics.functional.image import peak_signal_noise_ratio, structural_similarity_index_measure

from autonerf_lab.classes import NUM_CLASSES
from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.evaluators import NearestView, TrueField
from autonerf_lab.evaluators.pose_refinement import (
    Refinement,
    evaluate_pose_refinement,
    interest_regions,
    move,
    perturb,
    pose_errors,
    pose_gradients,
    refine,
)
from autonerf_lab.evaluators.rendering import (
    class_scores,
    confusion_matrix,
    evaluate_rendering,
    flip,
    psnr,
    sample_test_poses,
    simulated_views,
    ssim,
)
from autonerf_lab.geometry import Intrinsics, planar_pose, so3_exp
from autonerf_lab.simulator import Simulator


@pytest.fixture(scope="module")
def sim():
    return Simulator(toy_scene.two_rooms(), Intrinsics.from_fov(48, 48), supersample=2)


@pytest.fixture(scope="module")
def field(sim):
    return TrueField(sim.scene, sim, views=1)


@pytest.fixture(scope="module")
def pair():
    rng = np.random.default_rng(0)
    target = rng.random((64, 48, 3)).astype(np.float32)
    target = (target + np.roll(target, 1, axis=0) + np.roll(target, 1, axis=1)) / 3
    return np.clip(target + rng.normal(0, 0.08, target.shape), 0, 1).astype(np.float32), target


def _torch(image):
    return torch.from_numpy(image).permute(2, 0, 1)[None]


def test_psnr_and_ssim_agree_with_torchmetrics_and_scikit_image(pair):
    image, target = pair
    oracle = peak_signal_noise_ratio(_torch(image), _torch(target), data_range=1.0)
    assert psnr(image, target) == pytest.approx(float(oracle), abs=1e-4)
    assert psnr(image, target) == pytest.approx(skimage_psnr(target, image, data_range=1.0), abs=1e-6)
    # The oracle leaves out a border of half a window on each side, as this one does
    oracle = structural_similarity_index_measure(_torch(image), _torch(target), sigma=1.5, data_range=1.0)
    assert ssim(image, target) == pytest.approx(float(oracle), abs=2e-3)


def test_flip_is_zero_for_equal_images_and_grows(pair):
    image, target = pair
    assert flip(target, target)[0] == pytest.approx(0, abs=1e-6)
    mean, error = flip(image, target)
    assert error.shape == target.shape[:2] and mean == pytest.approx(float(error.mean()), abs=1e-4)
    assert 0 < mean < flip(1 - target, target)[0]


def test_class_scores_leave_out_absent_classes():
    target, predicted = np.array([0, 0, 0, 3]), np.array([0, 0, 5, 3])
    scores = class_scores(confusion_matrix(predicted, target))
    assert scores["per_class_accuracy"] == pytest.approx(100 * (2 / 3 + 1) / 2)
    assert scores["miou"] == pytest.approx(100 * (2 / 3 + 1) / 2)
    assert scores["miou_objects"] == 100.0
    assert class_scores(np.zeros((16, 16), int))["miou"] is None


def test_classes_agree_with_torchmetrics():
    """Some classes absent from the truth, one of them predicted; one present and never found."""
    rng = np.random.default_rng(4)
    target = rng.choice([0, 1, 4, 9, 15], size=5000, p=[0.6, 0.2, 0.1, 0.05, 0.05])
    predicted = np.where(rng.random(5000) < 0.7, target, rng.choice([0, 1, 4, 15, 6], size=5000))
    predicted[target == 9] = 6
    found, wanted = torch.from_numpy(predicted), torch.from_numpy(target)
    confusion = confusion_matrix(predicted, target)
    np.testing.assert_array_equal(confusion, multiclass_confusion_matrix(found, wanted, NUM_CLASSES).numpy())
    iou = multiclass_jaccard_index(found, wanted, NUM_CLASSES, average="none").numpy()
    recall = multiclass_accuracy(found, wanted, NUM_CLASSES, average="none").numpy()
    present = np.unique(target)
    scores = class_scores(confusion)
    assert scores["miou"] == pytest.approx(100 * iou[present].mean(), abs=1e-4)
    assert scores["miou_objects"] == pytest.approx(100 * iou[present[1:]].mean(), abs=1e-4)
    assert scores["per_class_accuracy"] == pytest.approx(100 * recall[present].mean(), abs=1e-4)


def test_shuffled_labels_drop_to_chance():
    rng = np.random.default_rng(0)
    target = rng.integers(NUM_CLASSES, size=200_000)
    scores = class_scores(confusion_matrix(rng.permutation(target), target))
    # n equal classes at random: accuracy 1/n, IoU (1/n) / (2 - 1/n)
    assert scores["per_class_accuracy"] == pytest.approx(100 / 16, abs=0.3)
    assert scores["miou"] == pytest.approx(100 / 31, abs=0.2)


def test_the_true_field_renders_perfectly(sim, field):
    poses = sample_test_poses(sim, 4, seed=3)
    np.testing.assert_array_equal(poses[:2], sample_test_poses(sim, 2, seed=3))
    result = evaluate_rendering(field, simulated_views(sim, poses))
    assert result.values["psnr"] > 58 and result.values["ssim"] == pytest.approx(1)
    assert result.values["miou"] == 100 and result.values["depth_median_error_m"] == 0
    assert result.values["lpips"] is None and result.status["lpips"] == "weights_missing"
    assert result.artifact["confusion"].sum() == 4 * 48 * 48


def test_nearest_view_shows_the_nearest_training_image(sim):
    poses = np.stack([planar_pose(1, 1, 0.0), planar_pose(1, 1, np.pi / 2), planar_pose(3, 1, 0.0)])
    frames = [sim.render(c2w) for c2w in poses]
    trajectory = Trajectory(
        poses,
        np.stack([f.rgb for f in frames]),
        np.stack([f.depth for f in frames]),
        np.stack([f.semantics for f in frames]),
        sim.intrinsics,
    )
    view = NearestView(trajectory)
    assert [view.nearest(planar_pose(1.2, 1.1, a)) for a in (0.2, 1.4, -0.2)] == [0, 1, 0]
    assert view.nearest(planar_pose(2.9, 1, 2 * np.pi)) == 2, "headings wrap"
    image = view.render(poses[1], sim.intrinsics)
    np.testing.assert_array_equal(np.round(image.rgb * 255), frames[1].rgb)
    np.testing.assert_array_equal(image.depth, frames[1].depth)


class Pattern:
    """A field whose rays have a smooth colour of origin and direction, with exact gradients."""

    def __init__(self):
        rng = np.random.default_rng(5)
        self.a, self.b = rng.normal(size=(2, 3, 3))

    def colors(self, rays_o, rays_d):
        return 0.5 + 0.4 * np.sin(rays_o @ self.a + rays_d @ self.b)

    def ray_gradients(self, rays_o, rays_d, target):
        rays_o, rays_d = rays_o.astype(np.float64), rays_d.astype(np.float64)
        error = self.colors(rays_o, rays_d) - target
        slope = 2 / 3 * error * 0.4 * np.cos(rays_o @ self.a + rays_d @ self.b)
        return (error**2).mean(axis=1), slope @ self.a.T, slope @ self.b.T

    def render(self, c2w, intrinsics):
        from autonerf_lab.evaluators import Rendering
        from autonerf_lab.geometry import camera_rays

        rgb = self.colors(*camera_rays(intrinsics, c2w))
        nothing = np.zeros(rgb.shape[:2])
        return Rendering(rgb, nothing, nothing, nothing)


def test_pose_gradients_match_finite_differences():
    rng = np.random.default_rng(1)
    pattern, directions = Pattern(), rng.normal(size=(2, 40, 3))
    poses = np.stack([np.eye(4), np.eye(4)])
    poses[:, :3, :3] = [so3_exp(v) for v in rng.normal(size=(2, 3))]
    poses[:, :3, 3] = rng.normal(size=(2, 3))
    target = rng.random((2, 40, 3))

    def loss(poses):
        rays_d = directions @ poses[:, :3, :3].transpose(0, 2, 1)
        rays_o = np.broadcast_to(poses[:, None, :3, 3], rays_d.shape)
        flat = (a.reshape(-1, 3) for a in (rays_o, rays_d, target))
        return [a.reshape(2, 40, -1) for a in pattern.ray_gradients(*flat)]

    _, grad_o, grad_d = loss(poses)
    gradient = pose_gradients(directions, poses[:, :3, :3], grad_o, grad_d)
    for axis in range(6):
        step = np.zeros((2, 6))
        step[:, axis] = 1e-5
        difference = (loss(move(poses, step))[0].sum(axis=(1, 2)) - loss(move(poses, -step))[0].sum(axis=(1, 2))) / 2e-5
        np.testing.assert_allclose(gradient[:, axis], difference, rtol=1e-5, atol=1e-7)


def test_perturbation_is_about_the_camera_itself():
    rng = np.random.default_rng(0)
    far = planar_pose(80, -60, 1.0)
    rotation, translation = pose_errors(np.stack([perturb(far, rng) for _ in range(5)]), np.stack([far] * 5))
    np.testing.assert_allclose(rotation, 5, atol=1e-6)
    np.testing.assert_allclose(translation, 0.05, atol=1e-9)


def test_cameras_converge_in_a_smooth_field():
    pattern, intrinsics = Pattern(), Intrinsics.from_fov(16, 16)
    truth = np.stack([planar_pose(0.1 * k, 0.2, k) for k in range(4)])
    targets = np.round(255 * np.stack([pattern.render(c2w, intrinsics).rgb for c2w in truth])).astype(np.uint8)
    result = evaluate_pose_refinement(pattern, truth, targets, intrinsics, Refinement(150, 128))
    assert result.values["rotation_convergence_rate"] == 100.0
    assert result.artifact["losses"][-20:].mean() < 0.1 * result.artifact["losses"][:3].mean()


def test_the_true_geometry_converges(sim, field):
    poses = sample_test_poses(sim, 4, seed=0)
    targets = np.stack([sim.render(c2w).rgb for c2w in poses])
    result = evaluate_pose_refinement(field, poses, targets, sim.intrinsics, Refinement(150, 512))
    assert result.values["convergence_rate"] >= 75
    assert result.values["rotation_error_deg"] < 0.5 and result.values["translation_error_m"] < 0.015


def test_pixels_are_drawn_from_interest_regions(sim):
    """Rays are sampled around edges only."""
    targets_seen = []

    class Listening(Grey):
        def ray_gradients(self, rays_o, rays_d, target):
            targets_seen.append(target)
            return super().ray_gradients(rays_o, rays_d, target)

    picture = np.zeros((2, 16, 16, 3), np.uint8)
    picture[0, 4:7, 9:12] = 255
    camera, start = Intrinsics.from_fov(16, 16), np.stack([np.eye(4)] * 2)
    for interest in (True, False):
        refine(Listening(), start, picture, camera, Refinement(1, 2000, interest=interest))
    white = [target.reshape(2, -1, 3).mean(axis=(1, 2)) for target in targets_seen]
    region = interest_regions(picture[0])
    assert region[3:8, 8:13].all() and not region[:, :5].any() and not region[11:].any()
    assert white[0][0] == pytest.approx(9 / region.sum(), abs=0.03) and white[1][0] == pytest.approx(9 / 256, abs=0.02)
    assert interest_regions(picture[1]).all() and white[0][1] == 0


class Grey(Pattern):
    def ray_gradients(self, rays_o, rays_d, target):
        return np.full(len(rays_o), 0.1), np.zeros_like(rays_o), np.zeros_like(rays_d)


def test_an_empty_field_moves_no_camera(sim):
    poses = sample_test_poses(sim, 2, seed=0)
    targets = np.stack([sim.render(c2w).rgb for c2w in poses])
    result = evaluate_pose_refinement(Grey(), poses, targets, sim.intrinsics, Refinement(5, 16))
    assert result.values["convergence_rate"] == 0.0
    assert result.values["rotation_error_deg"] is None and result.status["rotation_error_deg"] == "none converged"


def test_a_nan_gradient_stops_only_its_pose():
    class Broken(Pattern):
        def ray_gradients(self, rays_o, rays_d, target):
            loss, grad_o, grad_d = super().ray_gradients(rays_o, rays_d, target)
            grad_d[: len(grad_d) // 2] = np.nan
            return loss, grad_o, grad_d

    starts = np.stack([np.eye(4), np.eye(4)])
    trace, _ = refine(Broken(), starts, np.zeros((2, 8, 8, 3), np.uint8), Intrinsics.from_fov(8, 8), Refinement(5, 16))
    np.testing.assert_array_equal(trace[-1, 0], np.eye(4))
    assert not np.allclose(trace[-1, 1], np.eye(4))


def test_a_gradient_that_becomes_nan_stops_its_pose():
    """The moments of Adam must not move the pose."""

    class Breaking(Pattern):
        calls = 0

        def ray_gradients(self, rays_o, rays_d, target):
            loss, grad_o, grad_d = super().ray_gradients(rays_o, rays_d, target)
            self.calls += 1
            if self.calls > 3:
                grad_o[:16] = np.nan
            return loss, grad_o, grad_d

    starts, camera = np.stack([np.eye(4), np.eye(4)]), Intrinsics.from_fov(8, 8)
    trace, _ = refine(Breaking(), starts, np.zeros((2, 8, 8, 3), np.uint8), camera, Refinement(8, 16))
    assert not np.allclose(trace[3, 0], np.eye(4)) and not np.allclose(trace[3, 1], trace[-1, 1])
    np.testing.assert_array_equal(trace[3:, 0], np.stack([trace[3, 0]] * 6))
