"""Conformance check of segmenters: for their tests, and before a plug-in is listed."""

from collections.abc import Callable
from typing import Any

import numpy as np

from autonerf_lab.classes import NUM_CLASSES
from autonerf_lab.segmentation.base import Segmentation, Segmenter
from autonerf_lab.utils.plugins import require

_SIZES = ((48, 48), (30, 44))  # (H, W) of the images of the check


def check_members(segmenter: Any) -> None:
    """Check that an object has the members of a segmenter.

    Raises:
        AssertionError: names the missing member.
    """
    require(not isinstance(segmenter, type), "it is a class; pass an instance")
    require(callable(segmenter), "a segmenter must be callable")
    require(callable(getattr(segmenter, "reset", None)), "a segmenter needs a method 'reset'")


def check_segmenter(make: Callable[[], Segmenter], seed: int = 0) -> None:
    """Check a segmenter: shapes, types and ranges; the same labels for the same seed; inputs unchanged.

    Args:
        make: class or function that makes the segmenter; called without arguments.
        seed: random seed of the images and of the segmenter.

    Raises:
        AssertionError: names the requirement that is not met.

    Example:
        >>> from autonerf_lab.segmentation import NoisyLabels
        >>> check_segmenter(NoisyLabels)
    """
    require(callable(make), f"a segmenter is registered as a class or function, not a {type(make).__name__}")
    segmenter = make()
    check_members(segmenter)
    for height, width in _SIZES:
        rng = np.random.default_rng(seed)
        rgb = rng.integers(256, size=(2, height, width, 3), dtype=np.uint8)
        depth = rng.uniform(0, 5, (2, height, width)).astype(np.float32)
        truth = np.zeros((2, height, width), np.uint8)
        truth[:, 8:20, 10:30] = rng.integers(NUM_CLASSES, size=(2, 1, 1))
        inputs: list[np.ndarray] = [rgb, depth, truth]
        copies = [array.copy() for array in inputs]
        first, second = (_segment(segmenter, inputs, seed) for _ in range(2))
        unchanged = all(np.array_equal(a, b) for a, b in zip(inputs, copies, strict=True))
        require(unchanged, "a segmenter must not write to its inputs")
        same = np.array_equal(first.labels, second.labels) and np.array_equal(first.confidence, second.confidence)
        require(same, "after reset with the same seed, a segmenter must return the same labels and confidences")
        single = _segment(segmenter, [array[0] for array in inputs], seed)
        for found, shape in ((first, (2, height, width)), (single, (height, width))):
            require(found.labels.shape == shape, f"labels of {shape} images must not be {found.labels.shape}")
            require(found.confidence.shape == shape, "confidences must have the shape of the labels")
            require(found.labels.dtype == np.uint8, f"labels must be uint8, not {found.labels.dtype}")
            require(found.labels.max() < NUM_CLASSES, f"labels must be 0 to {NUM_CLASSES - 1}")
            inside = (found.confidence >= 0).all() and (found.confidence <= 1).all()
            require(bool(inside), "confidences must be in [0, 1]")


def _segment(segmenter: Segmenter, inputs: list[np.ndarray], seed: int) -> Segmentation:
    segmenter.reset(np.random.default_rng(seed))
    found = segmenter(*inputs)
    require(isinstance(found, Segmentation), f"a segmenter must return a Segmentation, not a {type(found).__name__}")
    return found
