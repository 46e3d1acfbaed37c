"""Confidence intervals of scene means: values by hand and coverage probability."""

import numpy as np
import pytest
from scipy import stats

from autonerf_lab.benchmark.statistics import Interval, difference, holm, interval


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


def test_p_value_effect_size_and_detectable_difference_by_hand():
    """Scene means 1, 2, 3, 6: mean 3, standard deviation sqrt(14 / 3), t = 3 / sqrt(14 / 12) = 2.777, 3 d.o.f."""
    values = [1.0, 2.0, 3.0, 6.0]
    found = interval({str(k): [value] for k, value in enumerate(values)})
    assert found.standard_error == pytest.approx(np.sqrt(14 / 12))
    assert found.p_value == pytest.approx(stats.ttest_1samp(values, 0).pvalue) == pytest.approx(0.0692, abs=1e-4)
    assert found.effect_size == pytest.approx(3 / np.sqrt(14 / 3))
    assert found.detectable() == pytest.approx((3.1824 + 0.9785) * np.sqrt(14 / 12), abs=1e-3)
    assert found.detectable(comparisons=2) == pytest.approx((4.1765 + 0.9785) * np.sqrt(14 / 12), abs=1e-3)  # 1.25 %
    assert interval({"a": [-0.1], "b": [0.2 - 0.3]}).effect_size == -np.inf, "they differ by a rounding error"
    same = interval({"a": [2.0], "b": [2.0]})
    assert np.isnan(same.p_value) and np.isinf(same.effect_size) and same.detectable() == 0
    single = interval({"a": [2.0]})
    assert np.isnan([single.p_value, single.effect_size, single.detectable()]).all()
    assert np.isnan(interval({"a": [0.0], "b": [0.0]}).p_value), "no difference at all is not a finding"


def test_holm_by_hand_and_its_family_wise_error_rate():
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.9, 0.8]) == [1.0, 1.0] and holm([]) == []
    rng = np.random.default_rng(0)
    families = rng.normal(size=(1000, 6, 5))  # six comparisons without any difference, five scenes
    found = [holm(stats.ttest_1samp(family, 0, axis=1).pvalue.tolist()) for family in families]
    assert 0.03 < np.mean([min(family) < 0.05 for family in found]) < 0.07


def test_paired_differences_remove_the_variation_between_scenes():
    hard, easy = [10.0, 12.0], [90.0, 94.0]
    better = {"hard": [11.0, 13.0], "easy": [91.0, 95.2]}
    found = difference(better, {"hard": hard, "easy": easy})
    assert found.mean == pytest.approx(1.05) and found.excludes_zero
    assert not interval(better).excludes_zero
    # Means of 1 and 1.1: standard error 0.05, t of one degree of freedom 12.71
    assert found.half_width == pytest.approx(12.706 * 0.05, abs=1e-4)
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
