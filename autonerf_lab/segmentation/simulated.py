"""Segmenters ``true`` and ``noisy``: the simulator's labels, exact or with seeded errors."""

import numpy as np
from scipy import ndimage

from autonerf_lab.classes import NUM_CLASSES
from autonerf_lab.errors import DataError
from autonerf_lab.segmentation.base import Segmentation


class TrueLabels:
    """The simulator's labels with confidence 1."""

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode; nothing is random."""

    def __call__(
        self, rgb: np.ndarray, depth: np.ndarray | None = None, truth: np.ndarray | None = None
    ) -> Segmentation:
        """Return the labels of the simulator.

        Raises:
            DataError: there are none, as for photographs.
        """
        labels = _required(truth, "true")
        return Segmentation(labels.astype(np.uint8), np.ones(labels.shape, np.float32))


class NoisyLabels:
    """The simulator's labels with random confusion of objects and noisy boundaries, independent from image to image.

    Each connected region of an object class gets, with the rate ``confusion``, one of the 15 other labels, all with the
    same probability; the background is one of them (a missed object). Then each pixel takes the label of a pixel
    nearby: the displacements are normal with the standard deviation ``boundary``, smooth over a few pixels, and zero on
    average. The confidence is ``1 - confusion`` everywhere.

    Args:
        confusion: probability that the region of an object gets a wrong label.
        boundary: standard deviation of the displacement of boundaries, pixels.

    Raises:
        ValueError: a rate is out of range.

    Example:
        >>> truth = np.zeros((32, 32), np.uint8); truth[8:24, 8:24] = 4
        >>> noisy = NoisyLabels(confusion=0.0, boundary=1.0); noisy.reset(np.random.default_rng(0))
        >>> labels = noisy(np.zeros((32, 32, 3), np.uint8), truth=truth).labels
        >>> bool(0.8 < (labels == truth).mean() < 1), bool(labels[16, 16] == 4)
        (True, True)
    """

    _SMOOTH = 2.0  # pixels, standard deviation of the filter of the displacements

    def __init__(self, confusion: float = 0.1, boundary: float = 1.0) -> None:
        if not 0 <= confusion <= 1 or not 0 <= boundary <= 100:
            raise ValueError(f"confusion must be in [0, 1] and boundary in [0, 100], not {confusion} and {boundary}")
        self.confusion, self.boundary = confusion, boundary
        self._rng = np.random.default_rng(0)

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode with the given random numbers."""
        self._rng = rng

    def __call__(
        self, rgb: np.ndarray, depth: np.ndarray | None = None, truth: np.ndarray | None = None
    ) -> Segmentation:
        """Return the labels of the simulator with errors.

        Raises:
            DataError: there are no labels, as for photographs.
        """
        target = _required(truth, "noisy")
        images = [self._one(image) for image in target.reshape(-1, *target.shape[-2:])]
        labels = np.stack(images).reshape(target.shape)
        return Segmentation(labels, np.full(labels.shape, 1 - self.confusion, np.float32))

    def _one(self, truth: np.ndarray) -> np.ndarray:
        labels = truth.astype(np.uint8)
        for k in np.unique(truth[truth > 0]):
            regions, count = ndimage.label(truth == k)
            wrong = self._rng.random(count) < self.confusion
            other = self._rng.integers(NUM_CLASSES - 1, size=count)
            new = np.where(wrong, other + (other >= k), k).astype(np.uint8)
            labels = np.where(regions > 0, np.append(0, new)[regions], labels).astype(np.uint8)
        if not self.boundary:
            return labels
        noise = self._rng.standard_normal((2, *truth.shape))
        smooth = ndimage.gaussian_filter(noise, (0, self._SMOOTH, self._SMOOTH), mode="wrap")
        # a Gaussian filter of white noise divides the standard deviation by 2 sigma sqrt(pi)
        shifts = np.rint(smooth * (self.boundary * 2 * self._SMOOTH * np.sqrt(np.pi))).astype(np.int64)
        height, width = truth.shape
        rows = np.clip(np.arange(height)[:, None] + shifts[0], 0, height - 1)
        columns = np.clip(np.arange(width) + shifts[1], 0, width - 1)
        return labels[rows, columns]


def _required(truth: np.ndarray | None, name: str) -> np.ndarray:
    if truth is None:
        raise DataError(f"the segmenter {name!r} needs the simulator's labels; use 'compact' for images without them")
    return np.asarray(truth)
