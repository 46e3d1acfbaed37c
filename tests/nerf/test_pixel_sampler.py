"""Sampling of training pixels."""

import numpy as np
import pytest

from autonerf_lab.data.dataset import Dataset
from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.geometry import Intrinsics, planar_pose
from autonerf_lab.nerf.field_frame import FieldFrame
from autonerf_lab.nerf.pixel_sampler import PixelSampler

CAMERA = Intrinsics.from_fov(100, 101)


def pixels_of(labels: np.ndarray | None) -> PixelSampler:
    """Return a sampler of two images of 10,100 pixels; ``labels`` are those of the first, the second is all class 0."""
    poses = np.stack([planar_pose(0, 0, 0), planar_pose(1, 0, 0)])
    images = np.zeros((2, 101, 100, 3), np.uint8)
    semantics = None if labels is None else np.stack([labels, np.zeros_like(labels)])
    return PixelSampler(Dataset.from_trajectory(Trajectory(poses, images, None, semantics, CAMERA)), FieldFrame())


@pytest.fixture
def rare() -> PixelSampler:
    """Class 0 has 20,100 pixels, class 3 has 100: the last row of the first image. Other classes are absent."""
    labels = np.zeros((101, 100), np.uint8)
    labels[100] = 3
    return pixels_of(labels)


def test_a_share_of_the_batch_is_sampled_by_class(rare: PixelSampler) -> None:
    sampled = rare.sample(200_000, np.random.default_rng(0), by_class=0.4)
    common, few = np.sqrt(20_100), np.sqrt(100)
    expected = 0.6 * 100 / 20_200 + 0.4 * few / (few + common)
    assert (rare.labels[sampled] == 3).mean() == pytest.approx(expected, rel=0.03)
    counts = np.bincount(sampled[rare.labels[sampled] == 3] - 10_000, minlength=100)
    assert len(counts) == 100 and counts.min() > 0.6 * counts.mean()  # uniform within the class


def test_sampling_is_uniform_without_a_share_or_without_labels(rare: PixelSampler) -> None:
    for pixels in (rare, pixels_of(None)):
        share = 0.0 if pixels.labels is not None else 0.4
        sampled = pixels.sample(200_000, np.random.default_rng(0), by_class=share)
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
