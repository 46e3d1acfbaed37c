"""Widgets of exploration, without a browser: clicks and sliders redraw the figure, and a static PNG remains."""

import io
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from toy_scene import empty_room

from autonerf_lab.course.widgets.exploration import Drive, RewardMixer, Route
from autonerf_lab.course.widgets.live import LiveFigure
from autonerf_lab.exploration import explore
from autonerf_lab.geometry import Intrinsics, planar_pose
from autonerf_lab.mapping import empty_map
from autonerf_lab.rewards import cov
from autonerf_lab.simulator import Simulator
from autonerf_lab.types import Action


def shown(live: LiveFigure) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(live.png)).convert("RGB"))


@pytest.fixture
def drive():
    return Drive([empty_room()], "cov", seed=1, size=24)


@pytest.fixture
def route():
    """Return a route in a room of 5 x 4 m with a wall that leaves a gap of 1 m at its upper end."""
    known = empty_map(planar_pose(0, 0, 0), size=100)
    known.explored[10:90, 0:100] = True
    known.occupied[10:70, 50] = True
    return Route(known, (-2.0, -1.5), (2.0, -1.5))


def mixer() -> RewardMixer:
    values = {"cov": np.array([1.0, 2.0, 0.0]), "nov": np.array([0.5, 0.5, 0.5])}
    return RewardMixer({"a": values, "b": {name: value[::-1] for name, value in values.items()}})


def test_buttons_drive(drive):
    start = shown(drive)
    assert [button.icon for button in drive.buttons.values()][:3] == ["arrow-left", "arrow-up", "arrow-right"]
    for name in ("turn left", "turn left", "forward", "turn right"):
        before = drive.png
        drive.buttons[name].click()
        assert drive.png != before and shown(drive).shape == start.shape
    assert len(drive.rewards) == 4 and min(drive.rewards) >= 0 and sum(drive.rewards) > 1
    drive.buttons["restart"].click()
    assert drive.rewards == [] and np.array_equal(shown(drive), start)
    drive.act(Action.TURN_LEFT, Action.TURN_LEFT, Action.FORWARD)
    assert len(drive.rewards) == 3


def test_the_rewards_of_a_drive():
    """The rewards sum to the growth of the map that `explore` builds from the same actions."""

    class TurnLeft:
        waypoint = None

        def reset(self, rng):
            pass

        def act(self, known, observation):
            return Action.TURN_LEFT

    pose = planar_pose(1.5, 1.0, 0.3)
    sim = Simulator(empty_room(), Intrinsics.from_fov(24, 24))
    explored = explore(sim, TurnLeft(), steps=4, pose=pose, progress=False).meta["explored_m2"]
    drive = Drive([empty_room()], cov, size=24)
    drive._env.sim.reset = lambda seed, start=drive._env.sim.reset: start(seed, pose)
    drive.start()
    drive.act(*[Action.TURN_LEFT] * 3)
    assert sum(drive.rewards) == pytest.approx(explored[3] - explored[0], abs=1e-3)


def test_a_drive_ends_with_its_episode_or_with_a_reward_that_fails():
    drive = Drive([empty_room()], size=16, max_steps=2)
    drive.act(*[Action.TURN_LEFT] * 5)
    assert len(drive.rewards) == 2

    def broken(transition):
        return float("nan") if transition.observation.step == 2 else 1.0

    drive = Drive([empty_room()], broken, size=16)
    drive.act(Action.TURN_LEFT)
    before = drive.png
    drive.act(*[Action.TURN_LEFT] * 3)
    assert drive.rewards == [1.0] and drive.png != before
    figure = drive.figure()
    assert figure.get_supxlabel() == "reward 'broken' returned nan at step 2, not a finite number"
    drive.buttons["restart"].click()
    assert drive.figure().get_supxlabel() == ""


def test_a_route_goes_around_the_wall(route):
    """Two straight lines over the upper corner of the wall are a lower bound of the length."""
    bound = 2 * np.hypot(2.0, 2.5)
    assert bound < route.length < 1.05 * bound + 0.5
    before, longer = route.png, route.length
    route.sliders["clearance"].value = 0.0
    assert route.png != before and bound < route.length < longer
    route.sliders["goal x"].value = -1.0
    assert route.length == pytest.approx(1.0, abs=0.01)
    for name in ("start x", "start y", "goal y"):
        before = route.png
        route.sliders[name].value += 0.5
        assert route.png != before


def test_start_and_goal_are_set_by_clicks(route):
    """The map of 100 cells of 5 cm has a thin black frame in the image."""
    image = shown(route)
    dark = (image < 60).all(axis=2)
    (top, bottom), (left, right) = (np.flatnonzero(dark.mean(axis=axis) > 0.5)[[0, -1]] for axis in (1, 0))
    (x0, x1), (y0, y1) = route._figure.axes[0].get_xlim(), route._figure.axes[0].get_ylim()
    height, width, _ = image.shape
    for x, y in ((-1.5, 0.75), (-1.5, -0.75)):
        across = left + (right - left) * (x - x0) / (x1 - x0)
        down = bottom - (bottom - top) * (y - y0) / (y1 - y0)
        before, target = route.png, route.next_click.value
        route._shown._handle_custom_msg([(across + 0.5) / width, (down + 0.5) / height], [])
        assert route.png != before and route.next_click.value != target
    np.testing.assert_allclose(route.start_goal, [(-1.5, 0.75), (-1.5, -0.75)], atol=0.02)
    assert route.length == pytest.approx(1.5, abs=0.05)
    before = route.png
    route.click(0.001, 0.5)
    assert route.png == before and route.next_click.value == "start", "outside the map"


def test_a_route_that_does_not_exist(route):
    route.sliders["clearance"].value = 0.5
    route._known.occupied[10:90, 50] = True
    route.refresh()
    assert route.length == np.inf and route.figure().axes[0].get_title().startswith("no path")


def test_a_mixer_sums():
    mix = mixer()
    assert mix.reward == "1*cov"
    before = mix.png
    mix.sliders["nov"].value = 2.0
    assert mix.png != before and mix.reward == "1*cov+2*nov"
    curve, bars = mix.figure().axes
    np.testing.assert_allclose(curve.lines[0].get_ydata(), [2, 5, 6])
    np.testing.assert_allclose(curve.lines[1].get_ydata(), [1, 4, 6])
    assert [patch.get_width() for patch in bars.patches] == [3, 3, 3, 3]
    for slider in mix.sliders.values():
        slider.value = 0
    assert mix.reward == "" and mix.figure().axes[0].get_title() == "all weights are 0"


def test_names_are_not_drawn_as_formulas():
    """Matplotlib fails on a single dollar sign, which starts a formula."""
    RewardMixer({r"$\frac$": {r"a$\x$": np.ones(2)}})


@pytest.mark.parametrize("kind", ["drive", "route", "mixer"])
def test_a_static_image_remains_without_a_kernel_and_follows_the_controls(kind, request, monkeypatch):
    live = mixer() if kind == "mixer" else request.getfixturevalue(kind)
    displayed, updates = [], []

    def display(thing, display_id=False):
        displayed.append(thing)
        return SimpleNamespace(update=updates.append) if display_id else None

    monkeypatch.setattr("IPython.display.display", display)
    live._ipython_display_()
    controls, static = displayed
    assert type(controls).__name__ == "VBox"
    assert (getattr(controls.children[0], "value", None) == live.png) == (kind == "route")  # only this one is clicked
    assert static.data == live.png and static._repr_mimebundle_()[0]["image/png"]
    live.refresh()
    assert updates[-1].data == live.png
