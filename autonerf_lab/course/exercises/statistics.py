"""Exercises of notebook 12: confidence interval, paired difference, correlation.

Students read the solutions. They compute what ``benchmark.statistics`` computes, in the notation of the notebook.
"""

import numpy as np
import scipy  # loads its parts on first use

from autonerf_lab.course.checker import Case, Exercise, Mistake

Runs = list[list[float]]  # for each scene, one value per start pose


def half_width(runs: Runs) -> float:
    """Return half the width of the 95 % confidence interval over scenes."""
    means = [np.mean(starts) for starts in runs]  # each scene is one sample
    factor = scipy.stats.t.ppf(0.975, len(means) - 1)  # 2.5 % in each tail
    return float(factor * np.std(means, ddof=1) / np.sqrt(len(means)))


def paired(first: Runs, second: Runs) -> tuple[float, float]:
    """Return mean and half width of second minus first."""
    differences = [[b - a for a, b in zip(*scene, strict=True)] for scene in zip(first, second, strict=True)]
    return float(np.mean([np.mean(starts) for starts in differences])), half_width(differences)


def correlation(x: list[float], y: list[float]) -> float:
    """Return Pearson's r."""
    x_centred, y_centred = np.array(x) - np.mean(x), np.array(y) - np.mean(y)
    return float((x_centred @ y_centred) / np.sqrt((x_centred @ x_centred) * (y_centred @ y_centred)))


def _half(samples: list[float], factor: float, ddof: int = 1, root: bool = True) -> float:
    return float(factor * np.std(samples, ddof=ddof) / (np.sqrt(len(samples)) if root else 1))


def _means(runs: Runs) -> list[float]:
    return [float(np.mean(starts)) for starts in runs]


def _all(runs: Runs) -> list[float]:
    return [start for starts in runs for start in starts]


def _t(count: int, quantile: float = 0.975) -> float:
    return float(scipy.stats.t.ppf(quantile, count - 1))


_THREE = [[1.0, 3.0], [2.0, 2.0], [3.0, 3.0, 6.0]]

HALF_WIDTH = Exercise(
    "12-half-width",
    "Return half the width of the 95 % confidence interval: Student's t on the means of the scenes.",
    (
        Case("two scenes of one start each, 1 and 3", ([[1.0], [3.0]],), 12.706205),
        Case("three scenes with starts 1, 3; 2, 2; 3, 3, 6", (_THREE,), 2.868435),
        Case("scenes with equal means but different starts", ([[0.0, 4.0], [1.0, 3.0], [2.0, 2.0]],), 0.0),
    ),
    half_width,
    (
        Mistake(
            "All starts are treated as independent, but those of one scene are correlated. Take the mean of each scene "
            "first.",
            lambda runs: _half(_all(runs), _t(sum(map(len, runs)))),
        ),
        Mistake(
            "1.96 applies to many scenes. For few scenes use Student's t: scipy.stats.t.ppf(0.975, scenes - 1).",
            lambda runs: _half(_means(runs), float(scipy.stats.norm.ppf(0.975))),
        ),
        Mistake(
            "Use the sample standard deviation, which divides by n - 1: ddof=1.",
            lambda runs: _half(_means(runs), _t(len(runs)), ddof=0),
        ),
        Mistake(
            "This is the spread of the scenes. The standard error of their mean is smaller by the square root of n.",
            lambda runs: _half(_means(runs), _t(len(runs)), root=False),
        ),
        Mistake(
            "0.95 leaves 5 % in one tail. A two-sided interval has 2.5 % in each tail: 0.975.",
            lambda runs: _half(_means(runs), _t(len(runs), 0.95)),
        ),
        Mistake(
            "n scenes have n - 1 degrees of freedom, because their mean is estimated from the same data.",
            lambda runs: _half(_means(runs), _t(len(runs) + 1)),
        ),
        Mistake("This is the full width. Return half of it.", lambda runs: 2 * half_width(runs)),
    ),
)

_FIRST, _SECOND = [[1.0, 3.0], [11.0, 12.0]], [[2.0, 4.0], [13.0, 14.0]]

PAIRED = Exercise(
    "12-paired",
    "Return (mean, half width) of second minus first, paired by scene and start.",
    (
        Case("a difference of 1 in each of three scenes", ([[1.0], [5.0], [9.0]], [[2.0], [6.0], [10.0]]), (1.0, 0.0)),
        Case("1, 3; 11, 12 against 2, 4; 13, 14", (_FIRST, _SECOND), (1.5, 6.353102)),
        Case("1, 1; 1 against 2, 4; 5", ([[1.0, 1.0], [1.0]], [[2.0, 4.0], [5.0]]), (3.0, 12.706205)),
    ),
    paired,
    (
        Mistake("The sign is wrong: second minus first.", lambda a, b: (-paired(a, b)[0], paired(a, b)[1])),
        Mistake(
            "The intervals of both are added. Both were measured in the same scenes: subtract pair by pair first.",
            lambda a, b: (paired(a, b)[0], half_width(a) + half_width(b)),
        ),
        Mistake(
            "The root of the sum of squares applies to independent scenes. Here subtract pair by pair first.",
            lambda a, b: (paired(a, b)[0], float(np.hypot(half_width(a), half_width(b)))),
        ),
        Mistake(
            "All pairs are treated as independent: take the mean over the starts of each scene first.",
            lambda a, b: (
                float(np.mean(np.subtract(_all(b), _all(a)))),
                _half(list(np.subtract(_all(b), _all(a))), _t(sum(map(len, a)))),
            ),
        ),
        Mistake(
            "Scenes with more starts count more: the mean difference is the mean of the scene means.",
            lambda a, b: (float(np.mean(np.subtract(_all(b), _all(a)))), paired(a, b)[1]),
        ),
    ),
)


def _ranks(values: list[float]) -> list[float]:
    return [float(rank) for rank in scipy.stats.rankdata(values)]


def _cosine(x: list[float], y: list[float]) -> float:
    return float(np.dot(x, y) / (np.linalg.norm(x) * np.linalg.norm(y)))


CORRELATION = Exercise(
    "12-correlation",
    "Return Pearson's r of two lists of numbers.",
    (
        Case("x = 1, 2, 3 and y = 10, 20, 30", ([1.0, 2.0, 3.0], [10.0, 20.0, 30.0]), 1.0),
        Case("x = 1, 2, 3 and y = 3, 2, 1", ([1.0, 2.0, 3.0], [3.0, 2.0, 1.0]), -1.0),
        Case("x = 0, 0, 1, 1 and y = 1, 2, 3, 10", ([0.0, 0.0, 1.0, 1.0], [1.0, 2.0, 3.0, 10.0]), 0.707107),
    ),
    correlation,
    (
        Mistake("Subtract the means first: this is the cosine of the angle between the lists.", _cosine),
        Mistake(
            "This is the covariance, which has units. Divide it by both standard deviations.",
            lambda x, y: float(np.cov(x, y, ddof=0)[0, 1]),
        ),
        Mistake("This is r squared, which has no sign. Return r.", lambda x, y: correlation(x, y) ** 2),
        Mistake(
            "This is the rank correlation (Spearman). Pearson's r uses the values.",
            lambda x, y: correlation(_ranks(x), _ranks(y)),
        ),
        Mistake(
            "This is the slope of the regression line, which has units. r has none.",
            lambda x, y: float(np.polyfit(x, y, 1)[0]),
        ),
        Mistake(
            "Covariance and standard deviations use different divisors. Use n for both or n - 1 for both.",
            lambda x, y: correlation(x, y) * len(x) / (len(x) - 1),
        ),
    ),
)

EXERCISES = (HALF_WIDTH, PAIRED, CORRELATION)
