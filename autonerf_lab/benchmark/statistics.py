"""Confidence intervals of mean scores. The sample is the scene: the runs in one scene are not independent.

Treating all runs as independent samples makes the intervals far too narrow: with 5 scenes and 5 starts per scene, a
nominal 95 % interval then contains the true mean in little more than half of all cases.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

Runs = Mapping[str, Sequence[float]]  # scene -> one value per start


@dataclass(frozen=True)
class Interval:
    """Mean over scenes with its confidence interval."""

    mean: float
    half_width: float  # of the interval; nan for a single scene
    scenes: int  # number of scenes

    @property
    def excludes_zero(self) -> bool:
        """True if zero lies outside the interval."""
        return abs(self.mean) > self.half_width

    def __str__(self) -> str:
        return f"{self.mean:.1f} ± {self.half_width:.1f}"


def interval(runs: Runs, level: float = 0.95) -> Interval:
    """Return the mean of the scene means and its Student's t interval.

    Args:
        runs: Values of all runs by scene.
        level: Confidence level.

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
    half = stats.t.ppf((1 + level) / 2, count - 1) * means.std(ddof=1) / np.sqrt(count)
    return Interval(float(means.mean()), float(half), count)


def difference(runs: Runs, others: Runs, level: float = 0.95) -> Interval:
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
    return interval({scene: np.subtract(values, others[scene]).tolist() for scene, values in runs.items()}, level)
