"""Which pixels a batch is made of."""

import numpy as np
import pytest

from autonerf_lab.data.dataset import Dataset
from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.geometry import Intrinsics, planar_pose
from autonerf_lab.nerf.frame import FieldFrame
from autonerf_lab.nerf.pixel_sampler import Pixels

CAMERA = Intrinsics.from_fov(100, 101)


def pixels_of(labels: np.ndarray | None) -> Pixels:
    """One photograph of 10,100 pixels, and a second without anything."""
    poses = np.stack([planar_pose(0, 0, 0), planar_pose(1, 0, 0)])
    images = np.zeros((2, 101, 100, 3), np.uint8)
    semantics = None if labels is None else np.stack([labels, np.zeros_like(labels)])
    return Pixels(Dataset.of(Trajectory(poses, images, None, semantics, CAMERA)), FieldFrame())


@pytest.fixture
def rare() -> Pixels:
    """Class 0 has 20,100 pixels, class 3 has 100: the last row of the first photograph; no other class occurs."""
    labels = np.zeros((101, 100), np.uint8)
    labels[100] = 3
    return pixels_of(labels)


def test_a_share_of_the_batch_is_drawn_by_class(rare: Pixels) -> None:
    drawn = rare.draw(200_000, np.random.default_rng(0), by_class=0.4)
    common, few = np.sqrt(20_100), np.sqrt(100)
    expected = 0.6 * 100 / 20_200 + 0.4 * few / (few + common)
    assert (rare.labels[drawn] == 3).mean() == pytest.approx(expected, rel=0.03)
    counts = np.bincount(drawn[rare.labels[drawn] == 3] - 10_000, minlength=100)
    assert len(counts) == 100 and counts.min() > 0.6 * counts.mean()  # every pixel of the class alike


def test_without_a_share_and_without_labels_all_pixels_are_alike(rare: Pixels) -> None:
    for pixels in (rare, pixels_of(None)):
        share = 0.0 if pixels.labels is not None else 0.4
        drawn = pixels.draw(200_000, np.random.default_rng(0), by_class=share)
        last = (drawn >= 10_000) & (drawn < 10_100)
        assert last.mean() == pytest.approx(100 / 20_200, rel=0.1)
