"""Rendering: metrics computed by hand and compared with other libraries."""

import flip_evaluator
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
from autonerf_lab.evaluators import NearestView, Rendering, TrueField
from autonerf_lab.evaluators.rendering import (
    TargetView,
    class_scores,
    confusion_matrix,
    evaluate_rendering,
    flip,
    psnr,
    sample_test_poses,
    simulated_views,
    ssim,
)
from autonerf_lab.geometry import Intrinsics, planar_pose
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


def test_ssim_of_one_window_by_the_formula(pair):
    """In an image of 11 x 11 pixels, the window of Wang et al. fits once, around the middle pixel."""
    image, target = (a[20:31, 10:21].astype(np.float64) for a in pair)
    g = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
    window = (g[:, None] * g / g.sum() ** 2)[..., None]
    mx, my = (window * image).sum(axis=(0, 1)), (window * target).sum(axis=(0, 1))
    vx, vy = (window * (image - mx) ** 2).sum(axis=(0, 1)), (window * (target - my) ** 2).sum(axis=(0, 1))
    vxy = (window * (image - mx) * (target - my)).sum(axis=(0, 1))
    c1, c2 = 0.01**2, 0.03**2
    by_hand = (2 * mx * my + c1) * (2 * vxy + c2) / ((mx**2 + my**2 + c1) * (vx + vy + c2))
    assert 0.2 < by_hand.mean() < 0.95
    assert ssim(image, target) == pytest.approx(by_hand.mean(), abs=1e-5)


class Fixed:
    """A field that renders the given images, one after the other."""

    def __init__(self, *images):
        self.images = list(images)

    def render(self, c2w, intrinsics):
        return self.images.pop(0)


def flat_view(depth, color=128, semantics=None, size=12):
    """Return a target of one colour with a (size, size) depth image of the given values, repeated."""
    rgb = np.full((size, size, 3), color, np.uint8)
    depths = None if depth is None else np.resize(np.float32(depth), (size, size))
    return TargetView(np.eye(4), Intrinsics.from_fov(size, size), rgb, depths, semantics)


def flat_image(depth, color=128 / 255, semantics=None, size=12):
    rgb = np.full((size, size, 3), color, np.float32)
    return Rendering(rgb, np.resize(np.float32(depth), (size, size)), semantics, np.ones((size, size), np.float32))


def test_flip_has_the_viewing_distance_of_its_authors(pair):
    image, target = pair
    assert flip(image, target)[0] == pytest.approx(float(flip_evaluator.evaluate(target, image, "LDR")[1]), abs=1e-6)


def test_rendered_colours_beyond_their_range_are_black_and_white():
    """Colours of -0.5 and 1.5 are as good as 0 and 1, and are stored as 0 and 255."""
    images, views = [flat_image([1.0], color=c) for c in (-0.5, 1.5)], [flat_view(None, color=c) for c in (0, 255)]
    result = evaluate_rendering(Fixed(*images), views)
    np.testing.assert_allclose(result.artifact["psnr"], 58.9, atol=0.05)
    assert [int(stored["rgb"].min()) for stored in result.artifact["images"]] == [0, 255]
    assert [int(stored["rgb"].max()) for stored in result.artifact["images"]] == [0, 255]


def test_images_need_not_be_square():
    """In a fourth of an image of 12 x 16 pixels, the depth is 1 m too large; in the rest it is right: median 0."""
    depth = np.full((12, 16), 2.0, np.float32)
    rgb, far = np.full((12, 16, 3), 128, np.uint8), depth + (np.arange(16) < 4)
    image = Rendering(rgb.astype(np.float32) / 255, far, None, np.ones((12, 16), np.float32))
    view = TargetView(np.eye(4), Intrinsics.from_fov(16, 12), rgb, depth, None)
    assert evaluate_rendering(Fixed(image), [view]).values["depth_median_error_m"] == 0


def test_the_depth_error_is_the_median_of_absolute_errors():
    """Errors of -0.3, -0.2, +0.1 and -0.4 m, and a pixel without a true surface: median of 0.1, 0.2, 0.3 and 0.4 m."""
    true, rendered = [2.0, 2.0, 2.0, 2.0, 0.0, 0.0], [1.7, 1.8, 2.1, 1.6, 9.0, 9.0]
    result = evaluate_rendering(Fixed(flat_image(rendered)), [flat_view(true)])
    assert result.values["depth_median_error_m"] == pytest.approx(0.25)
    # A second view adds as many errors of 0.5 m: the median is over the pixels of all views.
    images, views = [flat_image(rendered), flat_image([2.5])], [flat_view(true), flat_view([2.0])]
    assert evaluate_rendering(Fixed(*images), views).values["depth_median_error_m"] == pytest.approx(0.5)


def test_image_scores_are_means_over_the_views():
    """Errors of 1/10 and 1/100 of full scale: 20 and 40 dB, mean 30 dB."""
    images = [flat_image([1.0], 0.4 + 0.1), flat_image([1.0], 0.4 + 0.01)]
    ticks = []
    result = evaluate_rendering(Fixed(*images), [flat_view([1.0], 102)] * 2, lambda: ticks.append(0))  # 102 / 255 = 0.4
    assert result.values["psnr"] == pytest.approx(30, abs=1e-3) and len(ticks) == 2
    assert result.artifact["psnr"] == pytest.approx([20, 40], abs=1e-3)
    assert set(result.n.values()) == {2} and result.artifact["poses"].shape == (2, 4, 4)
    shown = result.artifact["images"][0]
    assert (shown["rgb"] == 128).all() and (shown["true_rgb"] == 102).all() and shown["semantics"] is None


def test_values_that_are_missing_have_a_status():
    """Images of 10 pixels, without surfaces and labels."""
    result = evaluate_rendering(Fixed(flat_image([1.0], size=10)), [flat_view([0.0], size=10)])
    objects = dict.fromkeys(("per_class_accuracy", "miou", "miou_objects"), "no labels")
    assert result.status == objects | {
        "ssim": "images under 11 pixels",
        "lpips": "weights_missing",
        "depth_median_error_m": "no surface in the test images",
    }
    assert {name for name, value in result.values.items() if value is None} == set(result.status)
    background = np.zeros((11, 11), np.uint8)
    result = evaluate_rendering(
        Fixed(flat_image([1.0], semantics=background, size=11)), [flat_view(None, semantics=background, size=11)]
    )
    assert result.values["ssim"] == pytest.approx(1) and result.status["miou_objects"] == "no object in the test images"
    assert result.values["miou"] == 100 and result.values["depth_median_error_m"] is None


def test_lpips_is_computed_if_its_weights_are_given():
    class SideOfTheImage:
        min_side = 16

        def __call__(self, image, target):
            return float(image.shape[0]) / 128

    lpips = SideOfTheImage()
    result = evaluate_rendering(
        Fixed(flat_image([1.0], size=64), flat_image([1.0], size=64)),
        [flat_view([1.0], size=64)] * 2,
        lpips=lpips,
    )
    assert result.values["lpips"] == 0.5 and "lpips" not in result.status
    result = evaluate_rendering(Fixed(flat_image([1.0], size=11)), [flat_view([1.0], size=11)], lpips=lpips)
    assert result.values["lpips"] is None and result.status["lpips"].startswith("images under")


def test_images_of_the_first_twelve_views_are_stored():
    result = evaluate_rendering(Fixed(*[flat_image([1.0])] * 13), [flat_view([1.0])] * 13)
    assert len(result.artifact["images"]) == 12 and len(result.artifact["psnr"]) == 13


def test_colours_that_are_not_finite_or_out_of_range_are_clipped():
    broken = flat_image([1.0], np.nan)
    broken.rgb[:6] = 7.0
    result = evaluate_rendering(Fixed(broken), [flat_view([1.0], 255)])
    # Half of the pixels are white as the target, half black: MSE 0.5
    assert result.values["psnr"] == pytest.approx(-10 * np.log10(0.5))


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
