"""Widgets of a radiance field, without a browser, on fields with known output."""

import time

import numpy as np
import pytest

from autonerf_lab.course.widgets import live
from autonerf_lab.course.widgets.field import FieldTraining, PlanComparison, ViewComparison
from autonerf_lab.evaluators.ground_truth import MapGrid, TrueMap
from autonerf_lab.evaluators.maps import CellState
from autonerf_lab.evaluators.oracle import TrueField
from autonerf_lab.exploration import explore
from autonerf_lab.geometry import Intrinsics, planar_from_pose, planar_pose
from autonerf_lab.scenes import load_scene
from autonerf_lab.simulator import Simulator

TRUTH = np.full((4, 4, 3), 255, np.uint8)


class Learner:
    """Learner whose error halves at each step and whose image converges to white."""

    error = 1.0

    def step(self):
        self.error /= 2
        return 3 * self.error, self.error

    def image(self):
        return np.full((4, 4, 3), 1 - self.error)


def wait_for(condition):
    started = time.monotonic()
    while not condition():
        assert time.monotonic() - started < 60
        time.sleep(0.01)


def test_a_training_draws_its_curves():
    learner = Learner()
    training = FieldTraining(learner.step, learner.image, TRUTH)
    before = training.png
    training.run(30)
    np.testing.assert_allclose(training.psnr, 10 * np.log10(2) * np.arange(1, 31))
    assert training.png != before and training.static_image().data == training.png
    curve, shown, _, loss = training.figure().axes
    np.testing.assert_allclose(curve.lines[0].get_ydata(), training.psnr)
    np.testing.assert_allclose(curve.lines[1].get_ydata(), 10 * np.log10(2) * np.arange(10.5, 21))
    np.testing.assert_allclose(loss.lines[0].get_ydata(), 3 * 0.5 ** np.arange(1, 31))
    np.testing.assert_allclose(loss.lines[1].get_ydata()[0], 3 * (1 - 0.5**20) / 20)
    assert (loss.get_ylabel(), loss.get_yscale()) == ("loss", "log")
    assert shown.get_title() == "rendering, step 30"


@pytest.mark.parametrize(("seconds", "drawings"), [(0.0, 31), (1e6, 2)])
def test_drawings_of_a_running_training_are_limited(monkeypatch, seconds, drawings):
    learner, drawn = Learner(), []
    training = FieldTraining(learner.step, learner.image, TRUTH)
    monkeypatch.setattr(live, "_SECONDS", seconds)
    monkeypatch.setattr(live.time, "perf_counter", lambda: 2e6)
    monkeypatch.setattr(training, "refresh", lambda: drawn.append(len(training.psnr)))
    training.run(30)
    assert len(drawn) == drawings and drawn[0] == 1 and drawn[-1] == 30


def test_an_interrupted_training_keeps_its_steps():
    learner = Learner()

    def step():
        if learner.error < 0.2:
            raise KeyboardInterrupt
        return learner.step()

    training = FieldTraining(step, learner.image, TRUTH)
    training.run(100)
    assert len(training.psnr) == 3 and training.figure().axes[1].get_title() == "rendering, step 3"


def test_a_training_runs_in_the_background_until_it_is_stopped():
    training = FieldTraining(lambda: (0.0, 0.01), lambda: np.zeros((4, 4, 3)), TRUTH)
    training.buttons["stop"].click()  # no thread is running
    for _ in range(2):
        before = len(training.psnr)
        training.buttons["train on"].click()
        training.buttons["train on"].click()  # has no effect while it runs
        wait_for(lambda before=before: len(training.psnr) > before + 2)
        training.buttons["stop"].click()
        steps = len(training.psnr)
        time.sleep(0.05)
        assert len(training.psnr) == steps and training.figure().axes[1].get_title() == f"rendering, step {steps}"


def test_an_error_in_the_background_is_shown_in_the_figure():
    def broken():
        raise ValueError("a $ sign")

    training = FieldTraining(broken, lambda: np.zeros((4, 4, 3)), TRUTH)
    with pytest.raises(ValueError, match="sign"):
        training.run(1)
    training.buttons["train on"].click()
    training._thread.join()
    assert training.figure().get_supxlabel() == r"ValueError: a \$ sign"
    training._step = lambda: (0.0, 0.01)
    training.buttons["train on"].click()
    wait_for(lambda: training.psnr)
    training.buttons["stop"].click()
    assert training.figure().get_supxlabel() == "", "the error of the last attempt is gone"


@pytest.fixture
def views():
    sim = Simulator(load_scene("dev-0"), Intrinsics.from_fov(16, 16))
    trajectory = explore(sim, "random", steps=3, seed=0, progress=False)
    return ViewComparison(TrueField(sim.scene, sim), sim, trajectory, planar_pose(1.5, 1.0, np.radians(30)))


def test_views_follow_their_sliders(views):
    assert {name: slider.value for name, slider in views.sliders.items()} == pytest.approx(
        {"x": 1.5, "y": 1.0, "heading": 30.0}, abs=0.03
    )
    for name, value in (("x", 2.0), ("y", 1.5), ("heading", -90.0)):
        before = views.png
        views.sliders[name].value = value
        assert views.png != before
    np.testing.assert_allclose(views.pose, planar_pose(2.0, 1.5, -np.pi / 2), atol=1e-9)


def test_views_score_the_rendering_and_the_nearest_training_image(views):
    assert views.psnr["rendering"] == pytest.approx(58.9, abs=0.1) and 0 < views.psnr["nearest training image"] < 50
    assert [ax.get_title() for ax in views.figure().axes[1:]] == [
        "ground truth",
        "rendering: 58.9 dB",
        f"nearest training image: {views.psnr['nearest training image']:.1f} dB",
        "FLIP error of the rendering: 0.00",
    ]
    x, y, heading = planar_from_pose(views._nearest.poses[0])
    for slider, value in zip(views.sliders.values(), (x, y, np.degrees(heading)), strict=True):
        slider.value = value
    assert views.psnr["nearest training image"] > 25  # the same pose except for rounding


def plans(states=None):
    """Return a comparison in two rooms of 2 m with a door of 1 m; the default prediction is perfect."""
    free = np.pad(np.ones((100, 200), bool), 1)
    free[:60, 100] = False
    truth = TrueMap(MapGrid(np.zeros(2), free.shape, 0.02), ~free, ~free, free, np.zeros((15, *free.shape), bool))
    perfect = np.where(free, CellState.FREE, CellState.OCCUPIED).astype(np.uint8)
    return PlanComparison(perfect if states is None else states(perfect.copy()), truth, (0.6, 0.6), (3.4, 0.6))


def test_a_plan_on_a_perfect_map():
    shown = plans()
    assert shown.episode.success and shown.episode.length == pytest.approx(shown.episode.shortest, rel=0.05)
    assert 2.8 < shown.episode.shortest < 4.0
    assert shown.figure().get_suptitle() == f"success, SPL {100 * shown.episode.spl:.0f} %"
    for name, value in (("start x", 1.0), ("goal y", 1.5), ("goal x", 1.5)):
        before = shown.png
        shown.sliders[name].value = value
        assert shown.png != before
    assert shown.episode.shortest == pytest.approx(np.hypot(0.5, 0.9), abs=0.05)


def test_start_and_goal_are_set_by_clicks_on_either_map():
    shown = plans()
    figure = shown._figure
    for ax, position in zip(figure.axes, ((1.0, 0.6), (1.5, 1.5)), strict=True):
        shown.click(*(ax.transData.transform(position) / figure.bbox.size * (1, -1) + (0, 1)))
    np.testing.assert_allclose(shown.start_goal, [(1.0, 0.6), (1.5, 1.5)])
    assert shown.episode.shortest == pytest.approx(np.hypot(0.5, 0.9), abs=0.05)


def test_a_failed_plan_names_its_reason():
    def walled(states):
        states[:, 100] = CellState.OCCUPIED
        return states

    def open_(states):
        states[1:-1, 100] = CellState.FREE
        return states

    for wrong, reason in ((walled, "no path"), (open_, "through an obstacle")):
        shown = plans(wrong)
        assert shown.episode.reason == reason and shown.figure().get_suptitle() == f"failure: {reason}"


def test_a_start_where_the_robot_does_not_fit():
    shown = plans()
    shown.sliders["start x"].value = shown.sliders["start x"].min
    assert shown.episode.shortest == np.inf
    assert shown.figure().get_suptitle() == "the true map has no path between start and goal"
