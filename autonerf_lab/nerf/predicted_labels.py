"""Weights of predicted labels: near ones count more, because a segmenter sees more of what is near."""

from dataclasses import replace

import numpy as np

from autonerf_lab.data.dataset import Dataset

NEAR = 1.0  # metres; beyond it, the weight is the inverse square of the distance, like the pixels that a surface covers
UNKNOWN = 2.0  # metres, distance assumed where depth is missing


def trust_near_labels(data: Dataset) -> Dataset:
    """Return data with the confidences of its labels multiplied by min(1, (1 m / depth)²).

    Without it, a surface that is seen once from nearby and often from afar gets the label of the many poor views.

    Args:
        data: images with depth and predicted labels.

    Example:
        >>> from autonerf_lab.data.trajectory import Trajectory
        >>> from autonerf_lab.geometry import Intrinsics
        >>> depth = np.array([[[0.5, 1.0, 2.0, 0.0]]], np.float32)
        >>> labels, certain = np.zeros((1, 1, 4), np.uint8), np.full((1, 1, 4), 255, np.uint8)
        >>> camera, black = Intrinsics.from_fov(4, 1), np.zeros((1, 1, 4, 3), np.uint8)
        >>> seen = Trajectory(np.eye(4)[None], black, depth, labels, camera, confidence=certain)
        >>> trust_near_labels(Dataset.from_trajectory(seen)).confidences[0].tolist()
        [[255, 255, 64, 64]]
    """
    assert data.confidences is not None and data.depths is not None
    weighted = []
    for confidence, depth in zip(data.confidences, data.depths, strict=True):
        distance = np.maximum(np.where(depth > 0, depth, UNKNOWN), NEAR)
        weighted.append(np.rint(confidence * (NEAR / distance) ** 2).astype(np.uint8))
    return replace(data, confidences=weighted)
