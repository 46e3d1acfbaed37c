"""Scores of label images: confusion matrix, per-class accuracy, mean IoU, precision and recall."""

import numpy as np

from autonerf_lab.classes import NUM_CLASSES


def confusion_matrix(predicted: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Count the pixels of each pair of classes: (16, 16) int64, row = true class, column = predicted class.

    Example:
        >>> confusion_matrix(np.array([1, 1]), np.array([1, 0]))[:2, :2]
        array([[0, 1],
               [0, 1]])
    """
    pairs = np.asarray(target).astype(np.int64).ravel() * NUM_CLASSES + np.asarray(predicted).ravel()
    return np.bincount(pairs, minlength=NUM_CLASSES**2).reshape(NUM_CLASSES, NUM_CLASSES)


def class_scores(confusion: np.ndarray) -> dict[str, float | None]:
    """Compute per-class accuracy and mean IoU, percent, over the classes in the targets.

    Args:
        confusion: (16, 16) pixel counts of :func:`confusion_matrix`.

    Example:
        >>> c = np.zeros((16, 16), int); c[0, 0] = 6; c[0, 1] = 2; c[1, 1] = 2
        >>> scores = class_scores(c)
        >>> scores["per_class_accuracy"], scores["miou"], scores["miou_objects"]
        (87.5, 62.5, 50.0)
    """
    hits, target, predicted = np.diag(confusion), confusion.sum(axis=1), confusion.sum(axis=0)
    present = target > 0
    accuracy = hits[present] / target[present]
    iou = hits[present] / (target + predicted - hits)[present]
    objects = iou[1:] if present[0] else iou
    return {
        "per_class_accuracy": float(100 * accuracy.mean()) if len(accuracy) else None,
        "miou": float(100 * iou.mean()) if len(iou) else None,
        "miou_objects": float(100 * objects.mean()) if len(objects) else None,
    }


def object_precision_recall(confusion: np.ndarray) -> tuple[float | None, float | None]:
    """Compute precision and recall of the 15 object classes, percent: means over the classes in the targets.

    A class that is never predicted has no precision and is left out of that mean.

    Args:
        confusion: (16, 16) pixel counts of :func:`confusion_matrix`.

    Example:
        >>> c = np.zeros((16, 16), int); c[0, 0] = 6; c[0, 1] = 2; c[1, 1] = 2; c[2, 0] = 5
        >>> object_precision_recall(c)
        (50.0, 50.0)
    """
    hits, target, predicted = (v[1:] for v in (np.diag(confusion), confusion.sum(axis=1), confusion.sum(axis=0)))
    present = target > 0
    found = present & (predicted > 0)
    precision = float(100 * (hits[found] / predicted[found]).mean()) if found.any() else None
    return precision, float(100 * (hits[present] / target[present]).mean()) if present.any() else None
