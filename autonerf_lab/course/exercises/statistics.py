"""Exercises of notebook 12: an interval, a paired difference, a correlation.

The solutions are read by students: they say in the notebook's words what ``benchmark.statistics`` does.
"""

import numpy as np
from scipy import stats

from autonerf_lab.course.checker import Case, Exercise, Mistake

Runs = list[list[float]]  # a list of starts for each scene


def half_width(runs: Runs) -> float:
    means = [np.mean(starts) for starts in runs]  # a scene is one sample
    factor = stats.t.ppf(0.975, len(means) - 1)  # 2.5 % of the cases lie beyond each end
    return float(factor * np.std(means, ddof=1) / np.sqrt(len(means)))


def paired(first: Runs, second: Runs) -> tuple[float, float]:
    differences = [[b - a for a, b in zip(*scene, strict=True)] for scene in zip(first, second, strict=True)]
    return float(np.mean([np.mean(starts) for starts in differences])), half_width(differences)


def correlation(x: list[float], y: list[float]) -> float:
    x_off, y_off = np.array(x) - np.mean(x), np.array(y) - np.mean(y)
    return float((x_off @ y_off) / np.sqrt((x_off @ x_off) * (y_off @ y_off)))


def _half(samples: list[float], factor: float, ddof: int = 1, root: bool = True) -> float:
    return float(factor * np.std(samples, ddof=ddof) / (np.sqrt(len(samples)) if root else 1))


def _means(runs: Runs) -> list[float]:
    return [float(np.mean(starts)) for starts in runs]


def _all(runs: Runs) -> list[float]:
    return [start for starts in runs for start in starts]


def _t(count: int, quantile: float = 0.975) -> float:
    return float(stats.t.ppf(quantile, count - 1))


_THREE = [[1.0, 3.0], [2.0, 2.0], [3.0, 3.0, 6.0]]

HALF_WIDTH = Exercise(
    "12-half-width",
    "Half the width of the 95 % interval: Student's t on the means of scenes.",
    (
        Case("two scenes of one start each, 1 and 3", ([[1.0], [3.0]],), 12.706205),
        Case("scenes whose starts are 1 and 3; 2 and 2; 3, 3 and 6", (_THREE,), 2.868435),
        Case("starts that differ in scenes that do not", ([[0.0, 4.0], [1.0, 3.0], [2.0, 2.0]],), 0.0),
    ),
    half_width,
    (
        Mistake(
            "All starts are taken for independent. Those of one scene resemble each other: take the mean of each scene "
            "first.",
            lambda runs: _half(_all(runs), _t(sum(map(len, runs)))),
        ),
        Mistake(
            "1.96 belongs to many scenes. With few, Student's t asks for more: stats.t.ppf(0.975, scenes - 1).",
            lambda runs: _half(_means(runs), float(stats.norm.ppf(0.975))),
        ),
        Mistake(
            "The deviation of a sample divides by one less than its size: ddof=1.",
            lambda runs: _half(_means(runs), _t(len(runs)), ddof=0),
        ),
        Mistake(
            "This says how far scenes are apart. A mean of n scenes is known better, by the root of n.",
            lambda runs: _half(_means(runs), _t(len(runs)), root=False),
        ),
        Mistake(
            "0.95 leaves 5 % beyond one end. With two ends, 2.5 % lie beyond each: 0.975.",
            lambda runs: _half(_means(runs), _t(len(runs), 0.95)),
        ),
        Mistake(
            "n scenes leave n - 1 degrees of freedom, as their mean is taken from the same data.",
            lambda runs: _half(_means(runs), _t(len(runs) + 1)),
        ),
        Mistake("This is the whole width, from end to end.", lambda runs: 2 * half_width(runs)),
    ),
    tolerance=1e-4,
)

_HERE, _THERE = [[1.0, 3.0], [11.0, 12.0]], [[2.0, 4.0], [13.0, 14.0]]

PAIRED = Exercise(
    "12-paired",
    "How much more the second has than the first, paired by scene and start: (mean, half width). Runs as before.",
    (
        Case("one more in each of three scenes", ([[1.0], [5.0], [9.0]], [[2.0], [6.0], [10.0]]), (1.0, 0.0)),
        Case("1, 3 and 11, 12; against 2, 4 and 13, 14", (_HERE, _THERE), (1.5, 6.353102)),
    ),
    paired,
    (
        Mistake("The other way round: the second minus the first.", lambda a, b: (-paired(a, b)[0], paired(a, b)[1])),
        Mistake(
            "The intervals of both are added. But both walk in the same scenes: subtract first, pair by pair.",
            lambda a, b: (paired(a, b)[0], half_width(a) + half_width(b)),
        ),
        Mistake(
            "As if they had walked in different scenes (the root of the sum of squares). Subtract first, pair by pair.",
            lambda a, b: (paired(a, b)[0], float(np.hypot(half_width(a), half_width(b)))),
        ),
        Mistake(
            "All pairs are taken for independent: take the mean over the starts of each scene first.",
            lambda a, b: (
                paired(a, b)[0],
                _half(list(np.subtract(_all(b), _all(a))), _t(sum(map(len, a)))),
            ),
        ),
    ),
    tolerance=1e-4,
)


def _ranks(values: list[float]) -> list[float]:
    return [float(rank) for rank in stats.rankdata(values)]


def _cosine(x: list[float], y: list[float]) -> float:
    return float(np.dot(x, y) / (np.linalg.norm(x) * np.linalg.norm(y)))


CORRELATION = Exercise(
    "12-correlation",
    "Pearson's r of two lists of numbers.",
    (
        Case("x = 1, 2, 3 and y = 10, 20, 30", ([1.0, 2.0, 3.0], [10.0, 20.0, 30.0]), 1.0),
        Case("x = 1, 2, 3 and y = 3, 2, 1", ([1.0, 2.0, 3.0], [3.0, 2.0, 1.0]), -1.0),
        Case("x = 0, 0, 1, 1 and y = 1, 2, 3, 10", ([0.0, 0.0, 1.0, 1.0], [1.0, 2.0, 3.0, 10.0]), 0.707107),
    ),
    correlation,
    (
        Mistake("Subtract the means first: this is the cosine of the angle between the lists.", _cosine),
        Mistake(
            "This is the covariance, which has units. Divide by the deviations of both.",
            lambda x, y: float(np.cov(x, y, ddof=0)[0, 1]),
        ),
        Mistake("Squared, it has lost its sign: r, not r squared.", lambda x, y: correlation(x, y) ** 2),
        Mistake(
            "This is the correlation of ranks (Spearman's). Pearson takes the values.",
            lambda x, y: correlation(_ranks(x), _ranks(y)),
        ),
        Mistake(
            "This is the slope of a line through the points; r has no units.",
            lambda x, y: float(np.polyfit(x, y, 1)[0]),
        ),
        Mistake(
            "One part divides by n, the other by n - 1. Use the same for covariance and deviations.",
            lambda x, y: correlation(x, y) * len(x) / (len(x) - 1),
        ),
    ),
    tolerance=1e-4,
)

EXERCISES = (HALF_WIDTH, PAIRED, CORRELATION)
