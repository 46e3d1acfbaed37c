"""Walks to watch: the map is the robot's own, the page needs nothing else, text from files is shown and never run."""

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
from autonerf_lab.exploration.replay import EXPLORED, FRONTIER, OCCUPIED, PALETTE, UNKNOWN, cells, retrace
from autonerf_lab.geometry import Intrinsics, planar_pose
from autonerf_lab.mapping import empty_map, update
from autonerf_lab.pipeline.run_folder import RunConfig, open_run
from autonerf_lab.simulator import Simulator
from autonerf_lab.types import Observation
from autonerf_lab.viz.figures.rollouts import rollouts
from autonerf_lab.viz.player.player import Player, play

CAMERA = Intrinsics.from_fov(24, 24)
STEPS = 13
EVIL = "<img src=x onerror=alert(1)></script>"


@pytest.fixture(scope="module")
def walk() -> Trajectory:
    return explore(Simulator(two_rooms(), CAMERA, supersample=1), "frontier", steps=STEPS, seed=1, progress=False)


@pytest.fixture(scope="module")
def other() -> Trajectory:
    sim = Simulator(two_rooms(), CAMERA, supersample=1)
    return explore(sim, "random-waypoints", steps=8, seed=2, progress=False)


class Elements(HTMLParser):
    """Tags in order; fails where an element is closed that is not open."""

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
            self.script = data  # the first is the data of the player


def image_of(uri: str) -> Image.Image:
    return Image.open(io.BytesIO(base64.b64decode(uri.split(",")[1])))


def test_the_last_map_is_the_robots_own(walk: Trajectory) -> None:
    """Built naively on the robot's large map, and cut to what is known."""
    assert walk.depth is not None and walk.semantics is not None
    known, areas = empty_map(walk.poses[0], 640), []
    for t in range(STEPS):
        known = update(known, Observation(walk.rgb[t], walk.depth[t], walk.semantics[t], walk.poses[t]), CAMERA)
        areas.append(np.count_nonzero(known.explored) * 0.05**2)
    expected = cells(known)
    rows, cols = np.flatnonzero((expected > 0).any(axis=1)), np.flatnonzero((expected > 0).any(axis=0))
    shown = retrace(walk, np.array([0, 5, STEPS - 1]))
    assert shown.maps is not None and shown.area is not None
    np.testing.assert_array_equal(shown.maps[-1], expected[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1])
    np.testing.assert_allclose(shown.corner, known.origin + 0.05 * np.array([cols[0], rows[0]]), atol=1e-9)
    np.testing.assert_allclose(shown.area, np.array(areas)[[0, 5, -1]])
    np.testing.assert_allclose(shown.area, np.array(walk.meta["explored_m2"])[[0, 5, -1]], atol=1e-3)
    np.testing.assert_allclose(shown.length, walk.meta["path_m"], atol=1e-3)


def test_a_map_drawn_by_hand() -> None:
    known = empty_map(planar_pose(0, 0, 0), 5)
    known.explored[1:4, 1:4] = True
    known.occupied[1, 1] = known.occupied[1, 2] = True
    known.semantics[6, 1, 2] = known.semantics[13, 1, 2] = True  # a cup (14) on a table (7)
    u, e, f, o = UNKNOWN, EXPLORED, FRONTIER, OCCUPIED
    rows = [[u, u, u, u, u], [u, o, o + 14, f, u], [u, f, e, f, u], [u, f, f, f, u], [u, u, u, u, u]]
    np.testing.assert_array_equal(cells(known), rows)
    np.testing.assert_array_equal(PALETTE[o + 1 :, :3], CLASS_COLORS[1:])
    assert PALETTE[:, 3].tolist() == [0] + [255] * 18


def test_waypoints_are_where_the_robot_heads(walk: Trajectory, other: Trajectory) -> None:
    assert len(other.meta["waypoints"]) == 8 and len({tuple(point) for point in other.meta["waypoints"]}) == 1
    first = next(t for t, point in enumerate(walk.meta["waypoints"]) if point is not None)
    assert 0 < first < STEPS  # the frontier looks around before it chooses
    assert retrace(walk, np.arange(STEPS)).waypoints[first] == tuple(walk.meta["waypoints"][first])
    old = replace(walk, meta={k: v for k, v in walk.meta.items() if k != "waypoints"})
    assert retrace(old, np.arange(3)).waypoints == [None] * 3


def test_pictures_have_one_size_and_show_what_is_there(walk: Trajectory, other: Trajectory) -> None:
    alone = lab.play(walk, every=4)
    assert len(alone) == 4 and alone.walks[0].steps.tolist() == [0, 4, 8, 12]
    pictures = [alone.picture(k) for k in range(4)]
    assert len({picture.shape for picture in pictures}) == 1 and pictures[0].dtype == np.uint8
    floor = [np.count_nonzero((picture == PALETTE[EXPLORED, :3]).all(axis=2)) for picture in pictures]
    assert 1000 < floor[0] < floor[-1]
    np.testing.assert_array_equal(alone.picture(-1), pictures[-1])
    both = lab.play(walk, other, every=4)
    assert both.walks[1].steps.tolist() == [0, 4, 7, 7]  # the shorter one waits at its end
    assert both.picture(2).shape == both.picture(3).shape


def test_the_figure_has_a_row_a_policy_in_one_scale(walk: Trajectory, other: Trajectory) -> None:
    figure = lab.play(walk, other, every=1).figure()
    assert len(figure.axes) == 8 and len({(ax.get_xlim(), ax.get_ylim()) for ax in figure.axes}) == 1
    assert [ax.get_title().split(":")[0] for ax in figure.axes[:4]] == ["step 0", "step 3", "step 6", "step 12"]
    assert [ax.get_ylabel() for ax in figure.axes[::4]] == ["frontier", "random-waypoints"]
    figure.canvas.draw()


def test_a_page_needs_nothing_else(walk: Trajectory, other: Trajectory, tmp_path: Path) -> None:
    player = lab.play(walk, other, every=3)
    text = player.save(tmp_path / "walk.html").read_text()
    elements = Elements(text)
    assert player._repr_html_() in text
    assert "://" not in text and not re.search(r"@import|url\(|<link", text)
    for tag, attrs in elements.found:
        assert (attrs.get("src") or "data:").startswith("data:image/") or tag != "img"
        assert tag != "img" or attrs["alt"]
        assert tag != "script" or "src" not in attrs
    assert {"button", "select", "input"} <= {tag for tag, _ in elements.found}
    data = json.loads(elements.script)
    assert data["steps"] == [0, 3, 6, 9, 12] and len(data["walks"]) == 2
    for one, seen in zip(data["walks"], (walk, other), strict=True):
        rgb, classes, maps = ([image_of(uri) for uri in frames] for frames in one["views"])
        assert [len(layer) for layer in (rgb, classes, maps)] == [5, 5, 5]
        assert seen.semantics is not None
        last = min(12, len(seen) - 1)
        np.testing.assert_array_equal(np.asarray(classes[-1].convert("RGB")), CLASS_COLORS[seen.semantics[last]])
        loss = np.abs(np.asarray(rgb[-1]).astype(int) - seen.rgb).mean(axis=(1, 2, 3))
        assert loss[last] == loss.min() < 25  # of a texture of noise WebP loses much
        assert one["at"][-1][:3] == [last, *(np.round(seen.poses[last, :2, 3] * (1, -1), 2).tolist())]
        assert len(one["way"]) == len(seen)
    drawn = player.walks[0].maps
    assert drawn is not None
    shown = np.asarray(image_of(data["walks"][0]["views"][2][1]).convert("RGBA"))[::-1]  # north is up
    np.testing.assert_array_equal(shown[drawn[1] > 0], PALETTE[drawn[1]][drawn[1] > 0])
    assert (shown[drawn[1] == 0, 3] == 0).all()


def test_names_from_files_are_text(walk: Trajectory) -> None:
    evil = replace(walk, meta={**walk.meta, "scene": EVIL, "policy": EVIL})
    for text in (lab.play(evil, every=6)._repr_html_(), Player([retrace(evil, np.array([0]))])._repr_html_()):
        elements = Elements(text)
        assert all("onerror" not in attrs for _, attrs in elements.found) and "<img src=x" not in text
        assert [tag for tag, _ in elements.found].count("script") == 2
        assert "&lt;img src=x onerror=alert(1)&gt;" in text
    dollars = replace(walk, meta={**walk.meta, "policy": "$\\frac{$"})
    lab.play(dollars, every=6).figure().canvas.draw()


def test_a_long_walk_makes_a_small_page() -> None:
    count = 900
    poses = np.stack([planar_pose(2 + np.cos(t / 50), np.sin(t / 50), t / 50) for t in range(count)])
    rgb = np.random.default_rng(0).integers(0, 255, (count, 16, 16, 3), np.uint8)
    blank = np.zeros((count, 16, 16), np.uint8)
    walk = Trajectory(poses, rgb, blank + np.float32(2), blank, Intrinsics.from_fov(16, 16))
    player = lab.play(walk)
    assert len(player) == 301
    images = replace(walk, depth=None)
    assert len(images.play(images, images)) == 101
    assert len(player._repr_html_()) < 8e6


def test_walks_without_depth_or_classes(walk: Trajectory, tmp_path: Path) -> None:
    colours = replace(walk, depth=None, semantics=None, meta={})
    player = lab.play(colours, every=4)
    assert player.walks[0].maps is None and player.walks[0].area is None
    assert Elements(player._repr_html_()).found and player.picture(1).shape == player.picture(3).shape
    player.figure().canvas.draw()
    shapes = lab.play(replace(walk, semantics=None), every=12).walks[0].maps
    assert shapes is not None and shapes[-1].max() == OCCUPIED
    walk.save(tmp_path)
    again = lab.play(lab.load_trajectory(tmp_path), every=12)
    assert len(again) == 2 and again.walks[0].maps is not None


def test_films(walk: Trajectory, tmp_path: Path) -> None:
    player = lab.play(walk, every=6)
    with Image.open(player.save(tmp_path / "walk.gif", progress=False)) as gif:
        height, width = player.picture(0).shape[:2]
        assert gif.n_frames == 3 and gif.size == (width + width % 2, height + height % 2)
    assert player.save(tmp_path / "walk.mp4", progress=False).read_bytes()[4:8] == b"ftyp"
    with pytest.raises(DataError, match=r"walk\.avi: a walk is written as \.html, \.gif or \.mp4"):
        player.save(tmp_path / "walk.avi")


def test_the_widget_follows_its_slider(walk: Trajectory, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("ipywidgets")
    player = lab.play(walk, every=6)
    shown, controls = player.widget().children
    before, slider = shown.value, controls.children[1]
    slider.value = 2
    assert shown.value != before and slider.max == 2
    assert Image.open(io.BytesIO(shown.value)).size == player.picture(2).shape[1::-1]
    monkeypatch.setitem(sys.modules, "ipywidgets", None)
    with pytest.raises(MissingPackageError, match=r'pip install "autonerf-lab\[notebooks\]"'):
        player.widget()


def test_films_without_the_extra(walk: Trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "imageio.v2", None)
    with pytest.raises(MissingPackageError, match=r"autonerf-lab\[viewer\]"):
        lab.play(walk, every=6).save(tmp_path / "walk.mp4")


def test_what_cannot_be_played(walk: Trajectory) -> None:
    elsewhere = explore(Simulator(empty_room(), CAMERA, supersample=1), "random", steps=3, progress=False)
    with pytest.raises(DataError, match=r"different scenes .*\(toy, empty\); play each alone"):
        lab.play(walk, elsewhere)
    tilted = walk.poses.copy()
    tilted[3, :3, 1:3] = tilted[3, :3, 1:3] @ [[0.8, -0.6], [0.6, 0.8]]
    for poses in (tilted, walk.poses + np.arange(STEPS)[:, None, None] * np.eye(4)[2][:, None] * np.eye(4)[3]):
        with pytest.raises(DataError, match="in a plane"):
            lab.play(replace(walk, poses=poses))
    far = walk.poses.copy()
    far[-1, 0, 3] += 1e5
    with pytest.raises(DataError, match=r"needs a map of 1000\d\d m"):
        lab.play(replace(walk, poses=far))
    with pytest.raises(WrongTypeError, match="photographs"):
        play(Dataset.of(walk))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="at least 1"):
        lab.play(walk, every=0)
    for waypoints in ([None], "here", [[1, 2, 3]] * STEPS, [[float("nan"), 0]] * STEPS, [["a", "b"]] * STEPS):
        with pytest.raises(DataError, match="'waypoints' must hold"):
            lab.play(replace(walk, meta={**walk.meta, "waypoints": waypoints}))


def test_command(walk: Trajectory, other: Trajectory, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    walk.save(tmp_path / "a")
    other.save(tmp_path / "b")
    page = tmp_path / "new" / "walk.html"
    assert cli.main(["play", str(tmp_path / "a"), str(tmp_path / "b"), "--out", str(page)]) == 0
    assert capsys.readouterr().out.strip() == str(page)
    assert len(json.loads(Elements(page.read_text()).script)["walks"]) == 2
    assert cli.main(["play", str(tmp_path / "c"), "--out", str(page)]) == 1
    assert "is this a trajectory folder" in capsys.readouterr().err
    run = open_run(tmp_path / "run", RunConfig("toy", walk.meta["scene_sha256"], "frontier", "smoke"))
    assert cli.main(["play", str(run.path), "--out", str(page)]) == 1
    assert "`autonerf-lab explore` comes first" in capsys.readouterr().err
    walk.save(run / "trajectory")
    run.mark("explore", 1.0, None)
    assert cli.main(["play", str(run.path), "--out", str(page)]) == 0
    assert len(json.loads(Elements(page.read_text()).script)["walks"]) == 1


def test_rollouts_show_what_each_walk_knew_by_when(walk, other):
    figure = rollouts(walk, other, steps=(2, 8, 100), titles=("one", EVIL))
    titles = [ax.get_title() for ax in figure.axes]
    assert len(titles) == 6
    area = [retrace(one, np.array([1, 7, 99])).area for one in (walk, other)]
    assert titles[0] == f"step 2: {area[0][0]:.0f} m²" and titles[5] == f"step 8: {area[1][2]:.0f} m²"
    lines = [ax.lines[1].get_xydata() for ax in figure.axes]
    np.testing.assert_allclose(lines[1], walk.poses[:8, :2, 3], atol=1e-9)  # the second walk ends there
    assert {(*ax.get_xlim(), *ax.get_ylim()) for ax in figure.axes} == {
        (*figure.axes[0].get_xlim(), *figure.axes[0].get_ylim())
    }
    with pytest.raises(DataError, match="at least one walk"):
        rollouts()
    with pytest.raises(DataError, match="kept no depth"):
        rollouts(replace(walk, depth=None))
