"""Exercises of notebook 08: PSNR, IoU per class, per-class accuracy.

Students read the solutions. They compute in a few lines what ``evaluators.rendering`` computes.
"""

import numpy as np

from autonerf_lab.course.checker import Case, Exercise, Mistake


def psnr(image: np.ndarray, target: np.ndarray) -> float:
    """Return the peak signal-to-noise ratio of images in [0, 1], dB."""
    return float(-10 * np.log10(np.mean((image - target) ** 2)))  # the peak value is 1


def iou(confusion: np.ndarray) -> np.ndarray:
    """Return the intersection over union of each class, (K,)."""
    hits = np.diag(confusion)
    union = confusion.sum(axis=0) + confusion.sum(axis=1) - hits  # predicted or true; hits would count twice
    return hits / union


def class_accuracy(confusion: np.ndarray) -> float:
    """Return the mean accuracy over the classes that are present."""
    target = confusion.sum(axis=1)  # number of pixels per true class
    present = target > 0
    return float(np.mean(np.diag(confusion)[present] / target[present]))


def _mse(image: np.ndarray, target: np.ndarray) -> np.ndarray:
    return np.mean((image - target) ** 2)


_GREY = np.full((2, 2, 3), 0.5)
_STRIPES = _GREY + np.array([0.0, 0.2])[:, None, None]
_PAIR = np.array([[80, 10, 0], [5, 5, 0], [0, 0, 20]])
_ABSENT = np.array([[90, 0, 0], [6, 4, 0], [0, 0, 0]])
_FALSE_ALARM = np.array([[6, 0, 2], [0, 4, 4], [0, 0, 0]])

PSNR = Exercise(
    "08-psnr",
    "Return the peak signal-to-noise ratio of two images with values in [0, 1], dB.",
    (
        Case("every value off by 0.1", (_GREY + 0.1, _GREY), 20.0),
        Case("every value off by 0.01", (_GREY - 0.01, _GREY), 40.0),
        Case("half of the pixels correct, half off by 0.2", (_STRIPES, _GREY), float(-10 * np.log10(0.02))),
    ),
    psnr,
    (
        Mistake("The sign is wrong: a good image has a high PSNR.", lambda a, b: 10 * np.log10(_mse(a, b))),
        Mistake(
            "20 log10 applies to the root mean squared error. For the mean squared error use 10 log10.",
            lambda a, b: -20 * np.log10(_mse(a, b)),
        ),
        Mistake("Decibels use the decimal logarithm: log10, not log.", lambda a, b: -10 * np.log(_mse(a, b))),
        Mistake(
            "These are absolute errors. PSNR uses the mean of squared errors.",
            lambda a, b: -20 * np.log10(np.mean(np.abs(a - b))),
        ),
        Mistake(
            "The peak is 1, not 255: the values are in [0, 1].",
            lambda a, b: 20 * np.log10(255) - 10 * np.log10(_mse(a, b)),
        ),
        Mistake("This is the mean squared error. Convert it to decibels.", _mse),
    ),
)

IOU = Exercise(
    "08-iou",
    "Return the intersection over union of each class, (K,), from a confusion matrix (rows true, columns predicted).",
    (
        Case("three classes of 90, 10 and 20 pixels", (_PAIR,), np.array([80 / 95, 5 / 20, 1.0])),
        Case("a class that is only predicted", (_FALSE_ALARM,), np.array([0.75, 0.5, 0.0])),
    ),
    iou,
    (
        Mistake(
            "This is the recall of each class. The union also includes pixels wrongly predicted as the class.",
            lambda c: np.diag(c) / c.sum(axis=1),
        ),
        Mistake(
            "This is the precision of each class. The union also includes the missed pixels of the class.",
            lambda c: np.diag(c) / c.sum(axis=0),
        ),
        Mistake(
            "The denominator counts the hits twice: they are in the row sum and in the column sum.",
            lambda c: np.diag(c) / (c.sum(axis=0) + c.sum(axis=1)),
        ),
        Mistake(
            "This is the Dice score, 2 hits / (true + predicted). IoU divides the hits by the union.",
            lambda c: 2 * np.diag(c) / (c.sum(axis=0) + c.sum(axis=1)),
        ),
        Mistake("This is the mean. Return one value per class.", lambda c: np.mean(iou(c))),
        Mistake(
            "The denominator contains only errors: the union also includes the hits.",
            lambda c: np.diag(c) / (c.sum(axis=0) + c.sum(axis=1) - 2 * np.diag(c)),
        ),
    ),
)

CLASS_ACCURACY = Exercise(
    "08-class-accuracy",
    "Return the mean accuracy over the classes that are present, in [0, 1].",
    (
        Case("classes of 90, 10 and 20 pixels", (_PAIR,), (80 / 90 + 0.5 + 1) / 3),
        Case("classes of 90, 10 and 0 pixels", (_ABSENT,), 0.7),
        Case("a class that is only predicted", (_FALSE_ALARM,), 0.625),
    ),
    class_accuracy,
    (
        Mistake(
            "This is the accuracy over pixels, which large classes dominate. Compute the accuracy of each class first.",
            lambda c: np.trace(c) / c.sum(),
        ),
        Mistake(
            "A class without true pixels counts as 0 here. Exclude it from the mean.",
            lambda c: np.mean(np.diag(c) / np.maximum(c.sum(axis=1), 1)),
        ),
        Mistake(
            "0 / 0 gives NaN, and so does the mean. Exclude classes without true pixels.",
            lambda c: np.mean(np.diag(c) / c.sum(axis=1)),
        ),
        Mistake(
            "This is the mean precision: rows are the true classes, columns the predicted ones.",
            lambda c: class_accuracy(c.T),
        ),
        Mistake("This is the mean IoU, which also counts false positives.", lambda c: np.nanmean(iou(c))),
    ),
)

EXERCISES = (PSNR, IOU, CLASS_ACCURACY)
