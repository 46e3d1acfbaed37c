"""The player shows the map of the robot, its page loads nothing, and text from files is never executed."""

import base64
import io
import json
import re
import sys
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from toy_scene import empty_room, two_rooms

import autonerf_lab as lab
from autonerf_lab import cli
from autonerf_lab.classes import CLASS_COLORS
from autonerf_lab.data.dataset import Dataset
from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.errors import DataError, MissingPackageError, WrongTypeError
from autonerf_lab.exploration import explore
from autonerf_lab.exploration.replay import EXPLORED, FRONTIER, OCCUPIED, PALETTE, UNKNOWN, map_image, replay_map
from autonerf_lab.geometry import Intrinsics, planar_pose
from autonerf_lab.mapping import empty_map, update
from autonerf_lab.pipeline.run_folder import RunConfig, open_run
from autonerf_lab.simulator import Simulator
from autonerf_lab.types import Observation
from autonerf_lab.viz.figures.rollouts import rollouts
from autonerf_lab.viz.player.page import page_html, player_html
from autonerf_lab.viz.player.player import Player, play

CAMERA = Intrinsics.from_fov(24, 24)
STEPS = 13
EVIL = "<img src=x onerror=alert(1)></script>"


@pytest.fixture(scope="module")
def trajectory() -> Trajectory:
    return explore(Simulator(two_rooms(), CAMERA, supersample=1), "frontier", steps=STEPS, seed=1, progress=False)


@pytest.fixture(scope="module")
def other() -> Trajectory:
    sim = Simulator(two_rooms(), CAMERA, supersample=1)
    return explore(sim, "random-waypoints", steps=8, seed=2, progress=False)


class Elements(HTMLParser):
    """Tags in order; fails if an element is closed that is not open."""

    EMPTY = ("meta", "img", "input", "circle", "line", "path", "polyline")

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.script = ""
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))
        if tag not in self.EMPTY:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open[-1:] == ["script"] and not self.script:
            self.script = data  # the first script holds the data of the player


def decode(uri: str) -> Image.Image:
    return Image.open(io.BytesIO(base64.b64decode(uri.split(",")[1])))


def test_last_map_is_the_map_of_the_robot(trajectory: Trajectory) -> None:
    """Reference: update the large map of the robot step by step, then crop it to the known area."""
    assert trajectory.depth is not None and trajectory.semantics is not None
    known, areas = empty_map(trajectory.poses[0], 640), []
    for t in range(STEPS):
        known = update(
            known,
            Observation(trajectory.rgb[t], trajectory.depth[t], trajectory.semantics[t], trajectory.poses[t]),
            CAMERA,
        )
        areas.append(np.count_nonzero(known.explored) * 0.05**2)
    expected = map_image(known)
    rows, cols = np.flatnonzero((expected > 0).any(axis=1)), np.flatnonzero((expected > 0).any(axis=0))
    shown = replay_map(trajectory, np.array([0, 5, STEPS - 1]))
    assert shown.maps is not None and shown.area is not None
    np.testing.assert_array_equal(shown.maps[-1], expected[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1])
    np.testing.assert_allclose(shown.corner, known.origin + 0.05 * np.array([cols[0], rows[0]]), atol=1e-9)
    np.testing.assert_allclose(shown.area, np.array(areas)[[0, 5, -1]])
    np.testing.assert_allclose(shown.area, np.array(trajectory.meta["explored_m2"])[[0, 5, -1]], atol=1e-3)
    np.testing.assert_allclose(shown.length, trajectory.meta["path_m"], atol=1e-3)


def test_map_cells_by_hand() -> None:
    known = empty_map(planar_pose(0, 0, 0), 5)
    known.explored[1:4, 1:4] = True
    known.occupied[1, 1] = known.occupied[1, 2] = True
    known.semantics[6, 1, 2] = known.semantics[13, 1, 2] = True  # a cup (14) on a table (7)
    u, e, f, o = UNKNOWN, EXPLORED, FRONTIER, OCCUPIED
    rows = [[u, u, u, u, u], [u, o, o + 14, f, u], [u, f, e, f, u], [u, f, f, f, u], [u, u, u, u, u]]
    np.testing.assert_array_equal(map_image(known), rows)
    np.testing.assert_array_equal(PALETTE[o + 1 :, :3], CLASS_COLORS[1:])
    assert PALETTE[:, 3].tolist() == [0] + [255] * 18


def test_waypoints_come_from_the_trajectory(trajectory: Trajectory, other: Trajectory) -> None:
    assert len(other.meta["waypoints"]) == 8 and len({tuple(point) for point in other.meta["waypoints"]}) == 1
    first = next(t for t, point in enumerate(trajectory.meta["waypoints"]) if point is not None)
    assert 0 < first < STEPS  # the frontier policy first looks around
    assert replay_map(trajectory, np.arange(STEPS)).waypoints[first] == tuple(trajectory.meta["waypoints"][first])
    old = replace(trajectory, meta={k: v for k, v in trajectory.meta.items() if k != "waypoints"})
    assert replay_map(old, np.arange(3)).waypoints == [None] * 3


def test_step_images_have_one_size_and_show_the_growing_map(trajectory: Trajectory, other: Trajectory) -> None:
    alone = lab.play(trajectory, every=4)
    assert len(alone) == 4 and alone.replays[0].steps.tolist() == [0, 4, 8, 12]
    images = [alone.image(k) for k in range(4)]
    assert len({image.shape for image in images}) == 1 and images[0].dtype == np.uint8
    floor = [np.count_nonzero((image == PALETTE[EXPLORED, :3]).all(axis=2)) for image in images]
    assert 1000 < floor[0] < floor[-1]
    np.testing.assert_array_equal(alone.image(-1), images[-1])
    both = lab.play(trajectory, other, every=4)
    assert both.replays[1].steps.tolist() == [0, 4, 7, 7]  # the shorter one stays at its last step
    assert both.image(2).shape == both.image(3).shape


def test_trajectories_stand_four_in_a_row(trajectory: Trajectory) -> None:
    four, five = (lab.play(*[trajectory] * count, every=12).image(0) for count in (4, 5))
    assert five.shape[1] == four.shape[1]
    panel = len(five) - len(four)
    np.testing.assert_array_equal(five[:panel], four[:panel])
    assert (five[panel : 2 * panel, four.shape[1] // 4 :] == 255).all()


def test_figure_has_one_row_per_policy_in_one_scale(trajectory: Trajectory, other: Trajectory) -> None:
    figure = lab.play(trajectory, other, every=1).figure()
    assert len(figure.axes) == 8 and len({(ax.get_xlim(), ax.get_ylim()) for ax in figure.axes}) == 1
    assert [ax.get_title().split(":")[0] for ax in figure.axes[:4]] == ["step 0", "step 3", "step 6", "step 12"]
    assert [ax.get_ylabel() for ax in figure.axes[::4]] == ["frontier", "random-waypoints"]
    figure.canvas.draw()


def test_page_is_self_contained(trajectory: Trajectory, other: Trajectory, tmp_path: Path) -> None:
    player = lab.play(trajectory, other, every=3)
    text = player.save(tmp_path / "play.html").read_text()
    elements = Elements(text)
    assert player._repr_html_() in text
    assert "://" not in text and not re.search(r"@import|url\(|<link", text)
    for tag, attrs in elements.found:
        assert (attrs.get("src") or "data:").startswith("data:image/") or tag != "img"
        assert tag != "img" or attrs["alt"]
        assert tag != "script" or "src" not in attrs
    assert {"button", "select", "input"} <= {tag for tag, _ in elements.found}
    data = json.loads(elements.script)
    assert data["steps"] == [0, 3, 6, 9, 12] and len(data["trajectories"]) == 2
    for one, seen in zip(data["trajectories"], (trajectory, other), strict=True):
        rgb, classes, maps = ([decode(uri) for uri in frames] for frames in one["views"])
        assert [len(layer) for layer in (rgb, classes, maps)] == [5, 5, 5]
        assert seen.semantics is not None
        last = min(12, len(seen) - 1)
        np.testing.assert_array_equal(np.asarray(classes[-1].convert("RGB")), CLASS_COLORS[seen.semantics[last]])
        loss = np.abs(np.asarray(rgb[-1]).astype(int) - seen.rgb).mean(axis=(1, 2, 3))
        assert loss[last] == loss.min() < 25  # WebP compresses noisy textures badly
        assert one["poses"][-1][:3] == [last, *(np.round(seen.poses[last, :2, 3] * (1, -1), 2).tolist())]
        assert len(one["path"]) == len(seen)
    drawn = player.replays[0].maps
    assert drawn is not None
    shown = np.asarray(decode(data["trajectories"][0]["views"][2][1]).convert("RGBA"))[::-1]  # north is up
    np.testing.assert_array_equal(shown[drawn[1] > 0], PALETTE[drawn[1]][drawn[1] > 0])
    assert (shown[drawn[1] == 0, 3] == 0).all()


def test_paths_of_other_pose_sources_are_drawn(trajectory: Trajectory) -> None:
    shifted = trajectory.poses.copy()
    shifted[:, 0, 3] += 0.5
    html = play(trajectory.with_poses("estimated", shifted), every=12).replays
    page = page_html(html, player_html(html))
    data = json.loads(re.findall(r'<script type="application/json">(.*?)</script>', page)[0])
    (true,) = data["trajectories"][0]["others"]
    path = data["trajectories"][0]["path"]
    assert true["name"] == "true" and len(true["path"]) == len(path) == STEPS
    assert float(path[0].split(",")[0]) - float(true["path"][0].split(",")[0]) == pytest.approx(0.5, abs=0.011)
    assert page.count('class="other"') == 1 and "true path" in page


def test_names_from_files_are_escaped(trajectory: Trajectory) -> None:
    evil = replace(trajectory, meta={**trajectory.meta, "scene": EVIL, "policy": EVIL})
    for text in (lab.play(evil, every=6)._repr_html_(), Player([replay_map(evil, np.array([0]))])._repr_html_()):
        elements = Elements(text)
        assert all("onerror" not in attrs for _, attrs in elements.found) and "<img src=x" not in text
        assert [tag for tag, _ in elements.found].count("script") == 2
        assert "&lt;img src=x onerror=alert(1)&gt;" in text
    dollars = replace(trajectory, meta={**trajectory.meta, "policy": "$\\frac{$"})
    lab.play(dollars, every=6).figure().canvas.draw()


def test_long_trajectory_makes_a_small_page() -> None:
    count = 900
    poses = np.stack([planar_pose(2 + np.cos(t / 50), np.sin(t / 50), t / 50) for t in range(count)])
    rgb = np.random.default_rng(0).integers(0, 255, (count, 16, 16, 3), np.uint8)
    blank = np.zeros((count, 16, 16), np.uint8)
    trajectory = Trajectory(poses, rgb, blank + np.float32(2), blank, Intrinsics.from_fov(16, 16))
    player = lab.play(trajectory)
    assert len(player) == 301
    images = replace(trajectory, depth=None)
    assert len(lab.play(images, images, images)) == 101
    assert len(player._repr_html_()) < 8e6


def test_trajectories_without_depth_or_classes(trajectory: Trajectory, tmp_path: Path) -> None:
    images = replace(trajectory, depth=None, semantics=None, meta={})
    player = lab.play(images, every=4)
    assert player.replays[0].maps is None and player.replays[0].area is None
    assert Elements(player._repr_html_()).found and player.image(1).shape == player.image(3).shape
    player.figure().canvas.draw()
    shapes = lab.play(replace(trajectory, semantics=None), every=12).replays[0].maps
    assert shapes is not None and shapes[-1].max() == OCCUPIED
    trajectory.save(tmp_path)
    again = lab.play(lab.load_trajectory(tmp_path), every=12)
    assert len(again) == 2 and again.replays[0].maps is not None


def test_videos(trajectory: Trajectory, tmp_path: Path) -> None:
    player = lab.play(trajectory, every=6)
    with Image.open(player.save(tmp_path / "play.gif", progress=False)) as gif:
        height, width = player.image(0).shape[:2]
        assert gif.n_frames == 3 and gif.size == (width + width % 2, height + height % 2)
    assert player.save(tmp_path / "play.mp4", progress=False).read_bytes()[4:8] == b"ftyp"
    with pytest.raises(DataError, match=r"play\.avi: unknown extension; a player is saved as \.html, \.gif or \.mp4"):
        player.save(tmp_path / "play.avi")


def test_widget_follows_its_slider(trajectory: Trajectory, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("ipywidgets")
    player = lab.play(trajectory, every=6)
    shown, controls = player.widget().children
    before, slider = shown.value, controls.children[1]
    slider.value = 2
    assert shown.value != before and slider.max == 2
    assert Image.open(io.BytesIO(shown.value)).size == player.image(2).shape[1::-1]
    monkeypatch.setitem(sys.modules, "ipywidgets", None)
    with pytest.raises(MissingPackageError, match=r'pip install "autonerf-lab\[notebooks\]"'):
        player.widget()


def test_videos_without_the_extra(trajectory: Trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "imageio.v2", None)
    with pytest.raises(MissingPackageError, match=r"autonerf-lab\[viewer\]"):
        lab.play(trajectory, every=6).save(tmp_path / "play.mp4")


def test_refused_trajectories(trajectory: Trajectory) -> None:
    elsewhere = explore(Simulator(empty_room(), CAMERA, supersample=1), "random", steps=3, progress=False)
    with pytest.raises(DataError, match=r"different scenes .*\(toy, empty\); play each alone"):
        lab.play(trajectory, elsewhere)
    tilted = trajectory.poses.copy()
    tilted[3, :3, 1:3] = tilted[3, :3, 1:3] @ [[0.8, -0.6], [0.6, 0.8]]
    for poses in (tilted, trajectory.poses + np.arange(STEPS)[:, None, None] * np.eye(4)[2][:, None] * np.eye(4)[3]):
        with pytest.raises(DataError, match="in a plane"):
            lab.play(replace(trajectory, poses=poses))
    far = trajectory.poses.copy()
    far[-1, 0, 3] += 1e5
    with pytest.raises(DataError, match=r"needs a map of 1000\d\d m"):
        lab.play(replace(trajectory, poses=far))
    with pytest.raises(WrongTypeError, match="photographs"):
        play(Dataset.from_trajectory(trajectory))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="at least 1"):
        lab.play(trajectory, every=0)
    for waypoints in ([None], "here", [[1, 2, 3]] * STEPS, [[float("nan"), 0]] * STEPS, [["a", "b"]] * STEPS):
        with pytest.raises(DataError, match="'waypoints' must hold"):
            lab.play(replace(trajectory, meta={**trajectory.meta, "waypoints": waypoints}))


def test_play_command(
    trajectory: Trajectory, other: Trajectory, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    trajectory.save(tmp_path / "a")
    other.save(tmp_path / "b")
    page = tmp_path / "new" / "play.html"
    assert cli.main(["play", str(tmp_path / "a"), str(tmp_path / "b"), "--out", str(page)]) == 0
    assert capsys.readouterr().out.strip() == str(page)
    assert len(json.loads(Elements(page.read_text()).script)["trajectories"]) == 2
    assert cli.main(["play", str(tmp_path / "c"), "--out", str(page)]) == 1
    assert "is this a trajectory folder" in capsys.readouterr().err
    run = open_run(tmp_path / "run", RunConfig("toy", trajectory.meta["scene_sha256"], "frontier", "smoke"))
    assert cli.main(["play", str(run.path), "--out", str(page)]) == 1
    assert "run `autonerf-lab explore` first" in capsys.readouterr().err
    trajectory.save(run / "trajectory")
    run.mark_finished("explore", 1.0, None)
    assert cli.main(["play", str(run.path), "--out", str(page)]) == 0
    assert len(json.loads(Elements(page.read_text()).script)["trajectories"]) == 1


def test_rollouts_show_the_map_of_each_trajectory_at_each_step(trajectory, other):
    figure = rollouts(trajectory, other, steps=(2, 8, 100), titles=("one", EVIL))
    titles = [ax.get_title() for ax in figure.axes]
    assert len(titles) == 6
    area = [replay_map(one, np.array([1, 7, 99])).area for one in (trajectory, other)]
    assert titles[0] == f"step 2: {area[0][0]:.0f} m²" and titles[5] == f"step 8: {area[1][2]:.0f} m²"
    lines = [ax.lines[1].get_xydata() for ax in figure.axes]
    np.testing.assert_allclose(lines[1], trajectory.poses[:8, :2, 3], atol=1e-9)  # the second trajectory ends there
    assert {(*ax.get_xlim(), *ax.get_ylim()) for ax in figure.axes} == {
        (*figure.axes[0].get_xlim(), *figure.axes[0].get_ylim())
    }
    with pytest.raises(DataError, match="at least one trajectory"):
        rollouts()
    with pytest.raises(DataError, match="without depth has no map"):
        rollouts(replace(trajectory, depth=None))
