"""Sampling of training pixels."""

from dataclasses import replace

import numpy as np
import pytest

from autonerf_lab.data.dataset import Dataset
from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.geometry import Intrinsics, planar_pose
from autonerf_lab.nerf.field_frame import FieldFrame
from autonerf_lab.nerf.pixel_sampler import PixelSampler

CAMERA = Intrinsics.from_fov(100, 101)


def pixels_of(labels: np.ndarray | None, by_class: float = 0.0) -> PixelSampler:
    """Return a sampler of two images of 10,100 pixels; ``labels`` are those of the first, the second is all class 0."""
    poses = np.stack([planar_pose(0, 0, 0), planar_pose(1, 0, 0)])
    images = np.zeros((2, 101, 100, 3), np.uint8)
    semantics = None if labels is None else np.stack([labels, np.zeros_like(labels)])
    data = Dataset.from_trajectory(Trajectory(poses, images, None, semantics, CAMERA))
    return PixelSampler(data, FieldFrame(), by_class=by_class)


@pytest.fixture
def rare() -> PixelSampler:
    """Class 0 has 20,100 pixels, class 3 has 100: the last row of the first image. Other classes are absent."""
    labels = np.zeros((101, 100), np.uint8)
    labels[100] = 3
    return pixels_of(labels, by_class=0.4)


def test_a_share_of_the_batch_is_sampled_by_class(rare: PixelSampler) -> None:
    sampled = rare.sample(200_000, np.random.default_rng(0))
    common, few = np.sqrt(20_100), np.sqrt(100)
    expected = 0.6 * 100 / 20_200 + 0.4 * few / (few + common)
    assert (rare.labels[sampled] == 3).mean() == pytest.approx(expected, rel=0.03)
    counts = np.bincount(sampled[rare.labels[sampled] == 3] - 10_000, minlength=100)
    assert len(counts) == 100 and counts.min() > 0.6 * counts.mean()  # uniform within the class


def test_sampling_is_uniform_without_a_share_or_without_labels() -> None:
    for pixels in (pixels_of(np.arange(10_100, dtype=np.uint8).reshape(101, 100) % 7), pixels_of(None, by_class=0.4)):
        sampled = pixels.sample(200_000, np.random.default_rng(0))
        assert pixels.targets(sampled[:5]).importance is None
        last = (sampled >= 10_000) & (sampled < 10_100)
        assert last.mean() == pytest.approx(100 / 20_200, rel=0.1)


@pytest.mark.parametrize("distance, expected", [(1.0, [0.6, 0.6, 0.15, 0.0375, 0.15]), (0.0, [0.6] * 5)])
def test_labels_of_far_surfaces_count_less(distance: float, expected: list[float]) -> None:
    """The last pixel has no depth and counts as one at twice the distance."""
    depth = np.array([[0.3, 1.0, 2.0, 4.0, 0.0]], np.float32)[None]
    poses, labels = planar_pose(0, 0, 0)[None], np.zeros((1, 1, 5), np.uint8)
    certain = np.full((1, 1, 5), 153, np.uint8)  # a confidence of 0.6
    camera, black = Intrinsics.from_fov(5, 1), np.zeros((1, 1, 5, 3), np.uint8)
    data = Dataset.from_trajectory(Trajectory(poses, black, depth, labels, camera, confidence=certain))
    targets = PixelSampler(data, FieldFrame(), distance).targets(np.arange(5))
    np.testing.assert_allclose(targets.trust, expected, rtol=1e-6)
    assert (targets.depth > 0).tolist() == [True] * 4 + [False]


EDGES = np.zeros((2, 3, 3), np.uint8)  # brightness 0 and 30 in two columns, 60 in the last pixel
EDGES[:, 1:] = 30
EDGES[1, 2] = 60


def two_images(mask: np.ndarray | None = None, **shares: float) -> PixelSampler:
    """Return a sampler of EDGES, whose last pixel has class 1, and of a black image of class 0."""
    images = np.stack([EDGES, np.zeros_like(EDGES)])
    labels = np.zeros((2, 2, 3), np.uint8)
    labels[0, 1, 2] = 1
    poses = np.stack([planar_pose(0, 0, 0), planar_pose(1, 0, 0)])
    data = Dataset.from_trajectory(Trajectory(poses, images, None, labels, Intrinsics.from_fov(3, 2)))
    return PixelSampler(replace(data, masks=None if mask is None else [mask, mask]), FieldFrame(), **shares)


def test_shares_and_importance_by_hand() -> None:
    """Four of the 12 pixels differ by 30 from their right or their lower neighbour, the others from neither.

    Probabilities are proportional to 2 + contrast, in the sum 4 * 32 + 8 * 2 = 144: 2/9 for each of the four pixels
    and 1/72 for each of the others. Two pixels are on planes. The only pixel of class 1 is drawn with a probability of
    1 / (1 + sqrt(11)), because the probability of a class is proportional to the root of its number of pixels.
    """
    pixels = two_images(by_contrast=0.25, on_planes=0.1, by_class=0.2)
    pixels.learn_planes(np.array([1, 2]), np.ones(2, np.float32))
    sampled = pixels.sample(1_000_000, np.random.default_rng(0))
    rare = 1 / (1 + np.sqrt(11))
    classes = np.array([(1 - rare) / 11] * 5 + [rare] + [(1 - rare) / 11] * 6)
    edges = np.array([16, 1, 16, 16, 16, 1, 1, 1, 1, 1, 1, 1]) / 72
    planes = np.array([0, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0]) / 2
    expected = 0.45 / 12 + 0.2 * classes + 0.25 * edges + 0.1 * planes
    np.testing.assert_allclose(np.bincount(sampled) / len(sampled), expected, rtol=0.03)
    np.testing.assert_allclose(pixels.targets(np.arange(12)).importance, 1 / (0.75 + 0.25 * 12 * edges), rtol=1e-6)


@pytest.mark.parametrize("share", [0.25, 1.0])
def test_importance_undoes_sampling_by_contrast(share: float) -> None:
    """Weighted means over samples are means over the unmasked pixels."""
    used = np.ones((2, 3), bool)
    used[0, 0] = False
    pixels = two_images(used, by_contrast=share)
    sampled = pixels.sample(1_000_000, np.random.default_rng(0))
    weighted = np.bincount(sampled, pixels.targets(sampled).importance, minlength=12) / len(sampled)
    np.testing.assert_allclose(weighted, np.array([0, 1, 1, 1, 1, 1] * 2) / 10, rtol=0.03)
