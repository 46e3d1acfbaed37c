"""Widgets of policy training, benchmark and lens, without a browser."""

import time
from dataclasses import replace

import numpy as np
import pytest

from autonerf_lab.benchmark.results_table import ResultsTable
from autonerf_lab.course.widgets.benchmark import PolicyComparison
from autonerf_lab.course.widgets.lens import Lens, through_lens
from autonerf_lab.course.widgets.training import PolicyTraining
from autonerf_lab.evaluators.metrics import Metric
from autonerf_lab.geometry import Intrinsics

SCORE, OTHER = Metric("t", "m", "%", "Score", 1, 1, 100), Metric("t", "other", "", "Other", -1)


class Trainer:
    """Training of five episodes with a checkpoint after every second one, from which it resumes."""

    checkpoint = 0

    def __call__(self, callback):
        for episode in range(self.checkpoint, 5):
            callback({"frames": 100.0 * (episode + 1), "reward": float(episode), "explored_m2": 10.0 - episode})
            self.checkpoint = episode + 1 if episode % 2 else self.checkpoint


def rewards_of(learning):
    return [row["reward"] for row in learning.curve]


def test_a_stopped_training_resumes_and_repeats_lost_episodes():
    learning = PolicyTraining(Trainer(), "metres")
    empty = learning.png
    learning.run(episodes=3)
    assert rewards_of(learning) == [0, 1, 2] and learning.png != empty
    learning.run()
    assert rewards_of(learning) == [0, 1, 2, 3, 4] and learning.starts == [100, 300]
    reward, area = learning.figure().axes
    assert reward.get_ylabel() == "metres"
    assert [list(line.get_ydata()) for line in reward.lines[:2]] == [[0, 1, 2, 3, 4], [2]]
    np.testing.assert_allclose(area.lines[0].get_ydata(), [10, 9, 8, 7, 6])


def test_an_interrupt_ends_a_training_and_an_error_is_shown():
    def interrupted(callback):
        callback({"frames": 1.0, "reward": 1.0, "explored_m2": 1.0})
        raise KeyboardInterrupt

    learning = PolicyTraining(interrupted)
    learning.run()
    assert rewards_of(learning) == [1]

    def broken(callback):
        raise ValueError("a $ sign")

    learning = PolicyTraining(broken)
    with pytest.raises(ValueError, match="sign"):
        learning.run()
    learning.buttons["train on"].click()
    learning.stop()
    assert learning.figure().get_supxlabel() == r"ValueError: a \$ sign"


def test_a_training_runs_in_the_background():
    def endless(callback):
        frames = 0.0
        while True:
            frames += 1
            callback({"frames": frames, "reward": 1.0, "explored_m2": 1.0})

    learning = PolicyTraining(endless)
    learning.buttons["train on"].click()
    started = time.monotonic()
    while len(learning.curve) < 2:
        assert time.monotonic() - started < 60
        time.sleep(0.01)
    learning.buttons["stop"].click()
    episodes = len(learning.curve)
    time.sleep(0.05)
    assert len(learning.curve) == episodes


def results():
    """Return two policies in two scenes with two starts; the second is better by 1, 1 and 2, 4 %."""
    first = {("a", 0): 0.1, ("a", 1): 0.2, ("b", 0): 0.3, ("b", 1): 0.1}
    second = {("a", 0): 0.11, ("a", 1): 0.21, ("b", 0): 0.32, ("b", 1): 0.14}
    rows = {
        (name, "model"): {place: {SCORE.key: value, OTHER.key: None} for place, value in values.items()}
        for name, values in (("first", first), ("second", second))
    }
    return ResultsTable({row: list(cells) for row, cells in rows.items()}, rows, [], 8)


def test_pairs():
    pairs = PolicyComparison(results(), [SCORE, OTHER])
    assert pairs.difference.mean == pytest.approx(0.02)
    assert pairs.difference.half_width == pytest.approx(0.12706, abs=1e-5)
    both, differences = pairs.figure().axes
    assert differences.get_title() == "+2.00 ± 12.71" and "second − first" in differences.get_xlabel()
    assert [tick.get_text() for tick in both.get_xticklabels()] == ["a", "b"]
    before = pairs.png
    pairs.selected["first"].value, pairs.selected["second"].value = ("second", "model"), ("first", "model")
    assert pairs.difference.mean == pytest.approx(-0.02) and pairs.png != before
    pairs.selected["score"].value = OTHER  # missing in all runs
    assert pairs.difference is None and pairs.figure().axes[1].get_title() == ""


def test_through_lens_maps_each_pixel_to_its_direction():
    """The colours of the image encode ray directions, so the result must encode the directions of the lens."""
    wide, lens = Intrinsics.from_fov(240, 200, 100), replace(Intrinsics.from_fov(40, 30, 65), k1=-0.12, k2=0.03)

    def tangents(camera):
        return 128 + 80 * camera.directions()

    image = through_lens(tangents(wide).round().astype(np.uint8), wide, lens)
    assert image.dtype == np.uint8 and np.abs(image - tangents(lens)).max() < 1.1
    narrow = Intrinsics.from_fov(24, 20, 30)
    assert (through_lens(np.full((20, 24, 3), 255, np.uint8), narrow, lens)[0] == 0).all(), "black outside the image"


def test_a_lens_follows_its_sliders():
    rng = np.random.default_rng(0)
    lens = Lens(
        rng.integers(0, 255, (40, 60, 3), np.uint8), Intrinsics.from_fov(60, 40, 90), Intrinsics.from_fov(24, 18, 65)
    )
    for name in ("k1", "k2"):
        before = lens.png
        lens.sliders[name].value = -0.05
        assert lens.png != before and getattr(lens.camera, name) == -0.05
    assert lens.figure().axes[2].get_title() == "k1 = -0.05, k2 = -0.05"
