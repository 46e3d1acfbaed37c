"""Intervals on scene means: values by hand, and whether they hold what they promise."""

import numpy as np
import pytest

from autonerf_lab.benchmark.statistics import difference, interval


def test_by_hand():
    found = interval({"a": [1, 2, 3], "b": [4, 4, 4], "c": [6]})
    assert found.mean == 4 and found.scenes == 3
    assert found.half == pytest.approx(4.303 * 2 / np.sqrt(3), abs=1e-3)  # t of 2 degrees of freedom; means 2, 4, 6
    assert not found.clear
    assert np.isnan(interval({"a": [1.0]}).half)


def test_pairs_take_out_what_scenes_have_in_common():
    hard, easy = [10.0, 12.0], [90.0, 94.0]
    better = {"hard": [11.0, 13.0], "easy": [91.0, 95.2]}
    found = difference(better, {"hard": hard, "easy": easy})
    assert found.mean == pytest.approx(1.05) and found.clear
    assert not interval(better).clear
    with pytest.raises(ValueError, match="same scenes and starts"):
        difference(better, {"hard": hard})
    with pytest.raises(ValueError, match="at least one run"):
        interval({"a": []})


def test_intervals_hold_the_truth_as_often_as_they_say():
    rng = np.random.default_rng(0)
    held = 0
    for _ in range(4000):
        scenes = rng.normal(50, 8, 5)  # scenes differ by more than starts do
        runs = {str(k): rng.normal(mean, 3, 5).tolist() for k, mean in enumerate(scenes)}
        found = interval(runs)
        held += abs(found.mean - 50) < found.half
    assert 0.93 < held / 4000 < 0.97
