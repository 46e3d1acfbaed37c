"""Segmenter that labels saturated green pixels as potted plants."""

import numpy as np

from autonerf_lab.classes import CLASS_NAMES
from autonerf_lab.segmentation import Segmentation

PLANT = CLASS_NAMES.index("potted plant")


class GreenPlants:
    """Threshold on colour; the confidence is constant."""

    def reset(self, rng):
        """Begin an episode; nothing is random."""

    def __call__(self, rgb, depth=None, truth=None):
        """Return the labels and confidences of (..., H, W, 3) images."""
        red, green, blue = np.moveaxis(np.asarray(rgb, np.float32), -1, 0)
        labels = np.where(green > 1.2 * np.maximum(red, blue) + 10, PLANT, 0).astype(np.uint8)
        return Segmentation(labels, np.full(labels.shape, 0.6, np.float32))
