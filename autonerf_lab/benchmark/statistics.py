"""Confidence intervals of mean scores. The sample is the scene: the runs in one scene are not independent.

Treating all runs as independent samples makes the intervals far too narrow: with 5 scenes and 5 starts per scene, a
nominal 95 % interval then contains the true mean in little more than half of all cases.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

LEVEL = 0.95  # of the intervals
ROUNDING = 1e-9  # relative to the mean: a smaller standard deviation is a rounding error
POWER = 0.8  # probability with which the smallest detectable difference is found
Runs = Mapping[str, Sequence[float]]  # scene -> one value per start


@dataclass(frozen=True)
class Interval:
    """Mean over scenes with its 95 % confidence interval.

    Example:
        >>> found = interval({"a": [1.0], "b": [2.0], "c": [3.0]})
        >>> round(found.p_value, 3), found.effect_size, round(found.detectable(), 2)
        (0.074, 2.0, 3.1)
    """

    mean: float
    half_width: float  # of the interval; nan for a single scene
    scenes: int  # number of scenes

    @property
    def standard_error(self) -> float:
        """Standard error of the mean; nan for a single scene."""
        return self.half_width / float(_t(self).ppf((1 + LEVEL) / 2))

    @property
    def p_value(self) -> float:
        """Two-sided p-value of Student's t test that the mean is zero; nan for a single scene.

        It is nan, too, if the scenes agree but for rounding. Few scenes do where a score has coarse steps, as that of
        20 poses has; their deviation of zero is no estimate of how much other scenes would differ.
        """
        if np.isinf(self.effect_size):
            return float("nan")
        with np.errstate(divide="ignore", invalid="ignore"):
            return float(2 * _t(self).sf(np.abs(np.divide(self.mean, self.standard_error))))

    @property
    def effect_size(self) -> float:
        """Mean in standard deviations of the scene means (Cohen's d of paired samples); nan for a single scene.

        Infinite if the scenes agree but for rounding.
        """
        deviation = self.standard_error * np.sqrt(self.scenes)
        if deviation < ROUNDING * abs(self.mean):
            return float(np.copysign(np.inf, self.mean))
        with np.errstate(divide="ignore", invalid="ignore"):
            return float(np.divide(self.mean, deviation))

    def detectable(self, comparisons: int = 1) -> float:
        """Return the smallest true mean that a test at the 5 % level finds with a probability of about 80 %.

        The usual sum of two quantiles: 80 % for ten scenes and more, 79 % for five, 73 % for two; nan for one.

        Args:
            comparisons: size of a family. The level is divided by it, as Holm's correction does with the smallest
                p-value of a family.
        """
        t = _t(self)
        return float(t.ppf(1 - (1 - LEVEL) / 2 / comparisons) + t.ppf(POWER)) * self.standard_error

    @property
    def excludes_zero(self) -> bool:
        """True if zero lies outside the interval."""
        return abs(self.mean) > self.half_width

    def __str__(self) -> str:
        return f"{self.mean:.1f} ± {self.half_width:.1f}"


def _t(found: Interval) -> Any:
    """Return Student's t distribution of an interval."""
    return stats.t(found.scenes - 1 if found.scenes > 1 else np.nan)


def holm(p_values: Sequence[float]) -> list[float]:
    """Adjust p-values for the number of comparisons (Holm 1979), so that one false finding is as rare as with one.

    Args:
        p_values: of all comparisons of the family; nan stays nan and does not count.

    Example:
        >>> holm([0.01, 0.04, float("nan"), 0.02])
        [0.03, 0.04, nan, 0.04]
    """
    adjusted, largest = [float("nan")] * len(p_values), 0.0
    known = sorted((p, k) for k, p in enumerate(p_values) if not np.isnan(p))
    for rank, (p, k) in enumerate(known):
        largest = max(largest, min(1.0, (len(known) - rank) * p))
        adjusted[k] = largest
    return adjusted


def interval(runs: Runs) -> Interval:
    """Return the mean of the scene means and its Student's t interval.

    Args:
        runs: Values of all runs by scene.

    Raises:
        ValueError: A scene has no run, or there is no scene.

    Example:
        >>> print(interval({"a": [1.0, 3.0], "b": [2.0], "c": [3.0]}))
        2.3 ± 1.4
    """
    if not runs or not all(len(values) for values in runs.values()):
        raise ValueError("every scene needs at least one run")
    means = np.array([np.mean(values) for values in runs.values()])
    count = len(means)
    if count == 1:
        return Interval(float(means[0]), float("nan"), 1)
    half = stats.t.ppf((1 + LEVEL) / 2, count - 1) * means.std(ddof=1) / np.sqrt(count)
    return Interval(float(means.mean()), float(half), count)


def difference(runs: Runs, others: Runs) -> Interval:
    """Return the interval of the differences ``runs - others``, paired by scene and start.

    Raises:
        ValueError: The scenes or the numbers of starts differ.

    Example:
        >>> print(difference({"a": [1.0, 3.0], "b": [9.0, 8.0]}, {"a": [0.0, 2.0], "b": [8.0, 7.0]}))
        1.0 ± 0.0
    """
    counts = [{scene: len(values) for scene, values in part.items()} for part in (runs, others)]
    if counts[0] != counts[1]:
        raise ValueError(f"pairs need the same scenes and starts, not {counts[0]} and {counts[1]}")
    return interval({scene: np.subtract(values, others[scene]).tolist() for scene, values in runs.items()})
