"""Exercises of notebook 16: variance of an ensemble, missing weight, points of a calibration plot."""

import numpy as np

from autonerf_lab.course.checker import Case, Exercise, Mistake


def variance(colors: np.ndarray) -> np.ndarray:
    """Return the variance of the members, averaged over the channels."""
    return ((colors - colors.mean(axis=0)) ** 2).mean(axis=(0, 2))


def missing(sums: np.ndarray) -> np.ndarray:
    """Return the square of the weight that is missing on average."""
    return (1 - sums.mean(axis=0)) ** 2


def calibration(uncertainty: np.ndarray, error: np.ndarray, groups: int) -> np.ndarray:
    """Return the mean uncertainty and the mean error of groups of equal size, sorted by uncertainty."""
    order = np.argsort(uncertainty)
    return np.array([(uncertainty[part].mean(), error[part].mean()) for part in np.array_split(order, groups)])


def _of_equal_width(uncertainty: np.ndarray, error: np.ndarray, groups: int) -> np.ndarray:
    span = np.ptp(uncertainty) or 1.0
    group = np.minimum(((uncertainty - uncertainty.min()) / span * groups).astype(int), groups - 1)
    parts = [group == k for k in range(groups)]
    return np.array([(uncertainty[p].mean(), error[p].mean()) if p.any() else (np.nan, np.nan) for p in parts])


_GREY = np.array([[[0.2, 0.2, 0.2]], [[0.4, 0.4, 0.4]]])
_TINTED = np.array([[[0.1, 0.5, 0.9], [0.3, 0.3, 0.3]], [[0.1, 0.5, 0.3], [0.3, 0.3, 0.3]]])
_THREE = np.concatenate([_TINTED, [[[0.1, 0.2, 0.6], [0.0, 0.6, 0.3]]]])

VARIANCE = Exercise(
    "16-variance",
    "Return the variance of the members at each pixel, averaged over the three channels, (N,), from colours (K, N, 3).",
    (
        Case("two members, one grey pixel", (_GREY,), np.array([0.01])),
        Case("two pixels, the first differs in blue only", (_TINTED,), np.array([0.03, 0.0])),
        Case("three members", (_THREE,), np.array([0.02666667, 0.01333333])),
    ),
    variance,
    (
        Mistake(
            "This divides by K - 1. The formula of the notebook divides by K.",
            lambda colors: colors.var(axis=0, ddof=1).mean(axis=-1),
        ),
        Mistake("This is the standard deviation. Do not take the root.", lambda colors: colors.std(axis=0).mean(-1)),
        Mistake("Average over the three channels instead of adding them.", lambda colors: colors.var(axis=0).sum(-1)),
        Mistake(
            "This mixes channels: a coloured pixel has a variance even if all members agree. Take the variance over "
            "the members first.",
            lambda colors: colors.var(axis=(0, 2)),
        ),
        Mistake(
            "This is the variance of the brightness. Take it for each channel, then average.",
            lambda colors: colors.mean(axis=2).var(axis=0),
        ),
        Mistake(
            "Average over the channels only: the result has one value for each pixel.",
            lambda colors: colors.var(axis=0).mean(),
        ),
    ),
)

MISSING = Exercise(
    "16-missing",
    "Return the squared missing weight of each pixel, (N,), from the sums of the weights of each member, (K, N).",
    (
        Case("an opaque pixel", (np.array([[1.0], [1.0]]),), np.array([0.0])),
        Case("members that disagree", (np.array([[1.0, 0.2], [0.0, 0.4]]),), np.array([0.25, 0.49])),
        Case("three members", (np.array([[0.9, 0.0], [0.6, 0.0], [0.9, 0.3]]),), np.array([0.04, 0.81])),
    ),
    missing,
    (
        Mistake("Take the mean over the members first, then the square.", lambda sums: ((1 - sums) ** 2).mean(axis=0)),
        Mistake("The square is missing.", lambda sums: 1 - sums.mean(axis=0)),
        Mistake("This is 1 minus the square. Square the difference.", lambda sums: 1 - sums.mean(axis=0) ** 2),
        Mistake("This is the square of the weight that is there: subtract it from 1.", lambda s: s.mean(axis=0) ** 2),
        Mistake("Average over the members instead of adding them.", lambda sums: (1 - sums.sum(axis=0)) ** 2),
        Mistake(
            "The mean is over the members, the first axis: the result has one value for each pixel.",
            lambda sums: (1 - sums.mean(axis=1)) ** 2,
        ),
    ),
)

_U, _E = np.array([0.3, 0.1, 0.2, 0.4]), np.array([0.9, 0.3, 0.2, 0.6])
_SKEWED = np.array([0.8, 0.01, 0.03, 0.02, 0.04, 0.05]), np.array([0.1, 0.4, 0.2, 0.3, 0.6, 0.5])

CALIBRATION = Exercise(
    "16-calibration",
    "Sort the pixels by uncertainty, divide them into groups of equal size, and return the mean uncertainty and the "
    "mean squared error of each group, (groups, 2).",
    (
        Case("four pixels in two groups", (_U, _E, 2), np.array([[0.15, 0.25], [0.35, 0.75]])),
        Case("one group", (_U, _E, 1), np.array([[0.25, 0.5]])),
        Case("one large uncertainty", (*_SKEWED, 3), np.array([[0.015, 0.35], [0.035, 0.4], [0.425, 0.3]])),
    ),
    calibration,
    (
        Mistake(
            "This sorts uncertainties and errors separately, so every uncertainty seems right. Sort the pixels: the "
            "error of a pixel stays with its uncertainty.",
            lambda u, e, n: calibration(np.sort(u), np.sort(e), n),
        ),
        Mistake(
            "Sort by uncertainty before you divide into groups.",
            lambda u, e, n: np.array(
                [(a.mean(), b.mean()) for a, b in zip(np.array_split(u, n), np.array_split(e, n), strict=True)]
            ),
        ),
        Mistake("Sort by the uncertainty, not by the error.", lambda u, e, n: calibration(e, u, n)[:, ::-1]),
        Mistake("The columns are swapped: first the uncertainty, then the error.", lambda *a: calibration(*a)[:, ::-1]),
        Mistake("The groups are in descending order.", lambda *a: calibration(*a)[::-1]),
        Mistake(
            "These groups have equal widths. Groups of equal size have equal numbers of pixels.",
            _of_equal_width,
        ),
    ),
)


EXERCISES = (VARIANCE, MISSING, CALIBRATION)
