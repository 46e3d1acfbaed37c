"""Confidence intervals of scene means: values by hand and coverage probability."""

import numpy as np
import pytest

from autonerf_lab.benchmark.statistics import Interval, difference, interval


def test_interval_by_hand():
    found = interval({"a": [1, 2, 3], "b": [4, 4, 4], "c": [6]})
    assert found.mean == 4 and found.scenes == 3
    assert found.half_width == pytest.approx(4.303 * 2 / np.sqrt(3), abs=1e-3)  # t for 2 degrees of freedom
    assert not found.excludes_zero
    single = interval({"a": [1.0]})
    assert single.mean == 1 and np.isnan(single.half_width) and single.scenes == 1 and not single.excludes_zero
    with pytest.raises(ValueError, match="at least one run"):
        interval({})


def test_an_interval_that_touches_zero_does_not_exclude_it():
    """A mean of 1 and half a width of 1; one of -2 excludes zero."""
    assert not Interval(1.0, 1.0, 2).excludes_zero and Interval(-2.0, 1.0, 2).excludes_zero
    assert str(Interval(-2.04, 0.96, 2)) == "-2.0 ± 1.0"


def test_paired_differences_remove_the_variation_between_scenes():
    hard, easy = [10.0, 12.0], [90.0, 94.0]
    better = {"hard": [11.0, 13.0], "easy": [91.0, 95.2]}
    found = difference(better, {"hard": hard, "easy": easy})
    assert found.mean == pytest.approx(1.05) and found.excludes_zero
    assert not interval(better).excludes_zero
    # Means of 1 and 1.1: standard error 0.05, t of one degree of freedom 12.71 (95 %) and 1 (50 %)
    assert found.half_width == pytest.approx(12.706 * 0.05, abs=1e-4)
    assert difference(better, {"hard": hard, "easy": easy}, level=0.5).half_width == pytest.approx(0.05)
    with pytest.raises(ValueError, match=r"same scenes and starts, not {'hard': 2, 'easy': 2} and {'hard': 2}"):
        difference(better, {"hard": hard})
    with pytest.raises(ValueError, match="at least one run"):
        interval({"a": []})


def test_intervals_have_the_nominal_coverage_probability():
    rng = np.random.default_rng(0)
    contained = 0
    for _ in range(4000):
        scenes = rng.normal(50, 8, 5)  # more variation between scenes than between starts
        runs = {str(k): rng.normal(mean, 3, 5).tolist() for k, mean in enumerate(scenes)}
        found = interval(runs)
        contained += abs(found.mean - 50) < found.half_width
    assert 0.93 < contained / 4000 < 0.97
