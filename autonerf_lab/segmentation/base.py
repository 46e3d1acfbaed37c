"""Segmenter: labels and confidences of images."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np


@dataclass(frozen=True)
class Segmentation:
    """Predicted labels of one image or of a batch."""

    labels: np.ndarray  # (..., H, W) uint8, class index
    confidence: np.ndarray  # (..., H, W) float32 in [0, 1], estimated probability that the label is right


@runtime_checkable
class Segmenter(Protocol):
    """Predictor of the class of every pixel.

    ``reset`` starts an episode and gives the random generator. A call segments an image (H, W, 3) uint8 or a batch
    (B, H, W, 3). ``depth`` (..., H, W) float32, metres, 0 for none, is None if the camera has no depth sensor.
    ``truth`` (..., H, W) uint8 holds the simulator's labels, for simulated errors (``true``, ``noisy``); a segmenter
    that predicts from images does not read it, and it is None for photographs.
    """

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode with the given random numbers."""

    def __call__(
        self, rgb: np.ndarray, depth: np.ndarray | None = None, truth: np.ndarray | None = None
    ) -> Segmentation:
        """Return the labels and confidences of an image or of a batch."""
        ...
