"""Exercises of notebook 08: PSNR, the IoU of classes, accuracy over classes.

The solutions are read by students: they say in a line or two what ``evaluators.rendering`` computes.
"""

import numpy as np

from autonerf_lab.course.checker import Case, Exercise, Mistake


def psnr(image: np.ndarray, target: np.ndarray) -> float:
    return float(-10 * np.log10(np.mean((image - target) ** 2)))  # the peak is 1


def iou(confusion: np.ndarray) -> np.ndarray:
    hits = np.diag(confusion)
    union = confusion.sum(axis=0) + confusion.sum(axis=1) - hits  # predicted or true; the hits are both
    return hits / union


def class_accuracy(confusion: np.ndarray) -> float:
    target = confusion.sum(axis=1)  # pixels of each true class
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
    "Peak signal-to-noise ratio of two images in [0, 1], dB.",
    (
        Case("every value off by 0.1", (_GREY + 0.1, _GREY), 20.0),
        Case("every value off by 0.01", (_GREY - 0.01, _GREY), 40.0),
        Case("half of the pixels right, half off by 0.2", (_STRIPES, _GREY), float(-10 * np.log10(0.02))),
    ),
    psnr,
    (
        Mistake("A good image has many decibels: the sign is missing.", lambda a, b: 10 * np.log10(_mse(a, b))),
        Mistake(
            "20 log10 is for the root of the mean square. For the mean square itself it is 10 log10.",
            lambda a, b: -20 * np.log10(_mse(a, b)),
        ),
        Mistake("Decibels count in powers of ten: log10, not log.", lambda a, b: -10 * np.log(_mse(a, b))),
        Mistake(
            "These are absolute errors; the S in MSE is for squares. A few large errors should weigh more.",
            lambda a, b: -20 * np.log10(np.mean(np.abs(a - b))),
        ),
        Mistake(
            "The peak is 1 here, and not 255: the values lie in [0, 1].",
            lambda a, b: 20 * np.log10(255) - 10 * np.log10(_mse(a, b)),
        ),
        Mistake("This is the mean squared error. Now in decibels.", _mse),
    ),
)

IOU = Exercise(
    "08-iou",
    "Intersection over union of each class, (K,), from a confusion matrix: rows are true, columns predicted.",
    (
        Case("three classes of 90, 10 and 20 pixels", (_PAIR,), np.array([80 / 95, 5 / 20, 1.0])),
        Case("a class that is only predicted", (_FALSE_ALARM,), np.array([0.75, 0.5, 0.0])),
    ),
    iou,
    (
        Mistake(
            "This is the accuracy of each true class. Pixels that are wrongly given to a class should hurt it, too.",
            lambda c: np.diag(c) / c.sum(axis=1),
        ),
        Mistake(
            "This is the precision of each prediction. Pixels of a class that were missed should hurt it, too.",
            lambda c: np.diag(c) / c.sum(axis=0),
        ),
        Mistake(
            "The hits are counted twice below the line: they are in the row and in the column.",
            lambda c: np.diag(c) / (c.sum(axis=0) + c.sum(axis=1)),
        ),
        Mistake(
            "This is the Dice score, 2 hits / (true + predicted). IoU divides the hits by the union.",
            lambda c: 2 * np.diag(c) / (c.sum(axis=0) + c.sum(axis=1)),
        ),
        Mistake("One value for each class, please; the mean comes later.", lambda c: np.mean(iou(c))),
        Mistake(
            "Only the misses are below the line: the union has the hits, too.",
            lambda c: np.diag(c) / (c.sum(axis=0) + c.sum(axis=1) - 2 * np.diag(c)),
        ),
    ),
)

CLASS_ACCURACY = Exercise(
    "08-class-accuracy",
    "The accuracy of each class that is there, and of these the mean: one number in [0, 1].",
    (
        Case("classes of 90, 10 and 20 pixels", (_PAIR,), (80 / 90 + 0.5 + 1) / 3),
        Case("classes of 90, 10 and 0 pixels", (_ABSENT,), 0.7),
        Case("a class that is only predicted", (_FALSE_ALARM,), 0.625),
    ),
    class_accuracy,
    (
        Mistake(
            "This is the accuracy over pixels: a large wall decides it. Take each class for itself first.",
            lambda c: np.trace(c) / c.sum(),
        ),
        Mistake(
            "A class without a pixel is neither right nor wrong: leave it out, instead of counting it as 0.",
            lambda c: np.mean(np.diag(c) / np.maximum(c.sum(axis=1), 1)),
        ),
        Mistake(
            "0 / 0 is no number, and no mean survives it. Leave classes without a pixel out.",
            lambda c: np.mean(np.diag(c) / c.sum(axis=1)),
        ),
        Mistake(
            "Rows are the true classes, columns the predicted ones: this is the mean precision.",
            lambda c: class_accuracy(c.T),
        ),
        Mistake("This is the mean IoU, which is harder: false alarms count, too.", lambda c: np.nanmean(iou(c))),
    ),
)

EXERCISES = (PSNR, IOU, CLASS_ACCURACY)
