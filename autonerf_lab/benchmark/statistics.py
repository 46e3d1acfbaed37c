"""Intervals: scenes differ more than runs, so that a scene is one sample, however many runs it has.

Taking all runs for independent makes intervals far too narrow: with 5 scenes of 5 starts, an interval that says 95 %
then holds the truth in little more than half of all cases.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

Runs = Mapping[str, Sequence[float]]  # scene -> one value a start


@dataclass(frozen=True)
class Interval:
    """A mean over scenes, and what it is uncertain by."""

    mean: float
    half: float  # of the width of the interval; nan for a single scene
    scenes: int

    @property
    def clear(self) -> bool:
        """Zero lies outside."""
        return abs(self.mean) > self.half

    def __str__(self) -> str:
        return f"{self.mean:.1f} ± {self.half:.1f}"


def interval(runs: Runs, level: float = 0.95) -> Interval:
    """Student's t on the means of scenes.

    Args:
        runs: of every scene.
        level: share of the cases in which the interval holds the mean over all scenes there could be.

    Raises:
        ValueError: a scene has no run, or there is no scene.

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
    """How much more than others, paired by scene and start.

    Raises:
        ValueError: not the same scenes and starts.

    Example:
        >>> print(difference({"a": [1.0, 3.0], "b": [9.0, 8.0]}, {"a": [0.0, 2.0], "b": [8.0, 7.0]}))
        1.0 ± 0.0
    """
    counts = [{scene: len(values) for scene, values in part.items()} for part in (runs, others)]
    if counts[0] != counts[1]:
        raise ValueError(f"pairs need the same scenes and starts, not {counts[0]} and {counts[1]}")
    return interval({scene: np.subtract(values, others[scene]).tolist() for scene, values in runs.items()}, level)
