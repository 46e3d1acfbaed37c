"""Figures of an evaluation: they show the values of the artifact, also for a field without classes."""

import matplotlib
import numpy as np
import pytest
import toy_scene
import trimesh
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from autonerf_lab.evaluators import TASKS
from autonerf_lab.evaluators.ground_truth import MapGrid, TrueMap
from autonerf_lab.evaluators.maps import CellState
from autonerf_lab.evaluators.planning import Episode, EpisodeSet
from autonerf_lab.geometry import planar_pose
from autonerf_lab.pipeline import figures as run_figures
from autonerf_lab.pipeline.gallery import read_gallery
from autonerf_lab.viz import figures
from autonerf_lab.viz.figures import evaluation

SHAPE = (40, 60)


def words(figure):
    figure.canvas.draw()
    return "\n".join(text.get_text() for text in figure.findobj(matplotlib.text.Text))


@pytest.fixture
def truth():
    """A strip of wall with a couch in it; the rest is free, but for an ignored margin."""
    occupied, free = np.zeros(SHAPE, bool), np.zeros(SHAPE, bool)
    occupied[18:22, 5:55] = True
    free[2:38, 5:55] = ~occupied[2:38, 5:55]
    semantics = np.zeros((15, *SHAPE), bool)
    semantics[1, 18:22, 10:20] = True
    return TrueMap(MapGrid(np.zeros(2), SHAPE, 0.1), occupied, occupied, free, semantics)


def rendered(count, semantics):
    rng = np.random.default_rng(0)
    image = rng.integers(255, size=(8, 8, 3), dtype=np.uint8)
    labels = np.full((8, 8), 4, np.uint8)
    one = {"true_rgb": image, "rgb": image, "flip": np.zeros((8, 8)), "true_semantics": labels, "semantics": semantics}
    confusion = np.zeros((16, 16), int)
    if semantics is not None:
        confusion[4, 4], confusion[4, 2], confusion[2, 2] = 75, 25, 10
    return {"images": [one] * count, "psnr": np.arange(count, dtype=float), "confusion": confusion}


def test_a_comparison_shows_the_best_and_the_worst_images():
    figure = figures.render_comparison(rendered(9, np.full((8, 8), 2, np.uint8)), rows=3)
    labels = [ax.get_ylabel() for ax in figure.axes if "dB" in ax.get_ylabel()]
    assert labels == ["8.0 dB", "4.0 dB", "0.0 dB"]
    assert "bed" in words(figure) and "couch" in words(figure) and "classes, rendered" in words(figure)
    without = figures.render_comparison(rendered(2, None))
    assert "classes, true" in words(without) and "classes, rendered" not in words(without)


def test_confusion_is_in_percent_of_the_true_pixels():
    ax = figures.confusion(rendered(1, np.zeros((8, 8), np.uint8))).axes[0]
    assert [tick.get_text() for tick in ax.get_yticklabels()] == ["couch", "bed"]
    np.testing.assert_allclose(ax.images[0].get_array(), [[100, 0], [25, 75]])
    assert sorted(text.get_text() for text in ax.texts) == ["100", "25", "75"]
    assert "no class labels" in words(figures.confusion(rendered(1, None)))


def test_a_map_has_false_positives_and_negatives_in_two_colours(truth):
    states = np.where(truth.free, CellState.FREE, CellState.OCCUPIED).astype(np.uint8)
    states[18:20, 5:55] = CellState.FREE  # half of the wall is missed
    states[30, 10:20] = CellState.OCCUPIED  # and a bar is imagined
    states[35, 5:55] = CellState.UNKNOWN
    labels = np.zeros(SHAPE, np.uint8)
    labels[5:9, 40:50] = 10
    figure = figures.map_overlay({"states": states, "labels": labels, "truth": truth})
    shown = figure.axes[0].images[0]
    colors = shown.cmap(shown.norm(np.asarray(shown.get_array())))[..., :3]

    def cells(color):
        return int(np.all(np.isclose(colors, to_rgb(color), atol=1e-3), axis=-1).sum())

    assert cells(figures.ORANGE) == 100 and cells(figures.BLUE) == 10 and cells(figures.YELLOW) == 50
    text = words(figure)
    assert "couch" in text and "refrigerator" in text and "bed" not in text


def test_rare_failures_are_drawn(truth):
    """One path through an obstacle and one missing path among two hundred episodes."""
    start, goal = np.array([5, 10]), np.array([10, 30])
    path = np.array([[5.0, 10.0], [10.0, 30.0]])
    points = [Episode(start, goal, 0, "", path, 1.0, 1.0) for _ in range(200)]
    points[117] = Episode(start, goal, 0, "through an obstacle", path, 1.0, 1.0)
    points[3] = Episode(start, goal, 0, "no path", None, np.inf, 1.0)
    none = np.zeros((0, 2), int)
    episode_set = EpisodeSet(truth.free, none, none, np.zeros(0), (), np.zeros((16, 0)))
    figure = figures.planned_paths(
        {"points": points, "objects": [], "truth": truth, "episode_set": episode_set}, count=20
    )
    left, right = figure.axes
    paths = [line for line in left.lines if len(line.get_xdata()) == 2]
    colors = [line.get_color() for line in paths]
    assert colors.count(figures.ORANGE) == 1 and 20 <= colors.count(figures.GREEN) <= 40
    assert any(line.get_color() == evaluation._REASON_COLORS["no path"] for line in left.lines), "its start is shown"
    np.testing.assert_allclose(paths[0].get_xydata(), truth.grid.centers(path))
    assert left.get_title() == "PointGoal: 198 of 200 episodes succeed" and "0 of 0" in right.get_title()


def test_traces_show_which_cameras_converged():
    truth = np.stack([planar_pose(0, 0, 0.0)] * 3)
    start = np.stack([planar_pose(0.05, 0, 0.08)] * 3)
    end = np.stack([truth[0], start[0], truth[0]])
    picture = np.zeros((3, 4, 4, 3))
    artifact = {
        "truth": truth, "iterations": np.array([0, 10]), "trace": np.stack([start, end]), "before": list(picture),
        "after": list(picture), "targets": picture.astype(np.uint8),
    }  # fmt: skip
    figure = figures.refinement_trace(artifact)
    turned, moved = figure.axes[:2]
    lines = [line for line in turned.lines if len(line.get_xdata()) == 2 and line.get_linestyle() == "-"]
    assert [line.get_color() for line in lines] == [figures.BLUE, figures.ORANGE, figures.BLUE]
    assert lines[1].get_ydata()[-1] == pytest.approx(np.degrees(0.08)) and "converged (2)" in words(figure)
    assert moved.lines[1].get_ydata()[0] == pytest.approx(50), "millimetres"


def test_errors_of_one_decade_or_two_have_plain_labels():
    figure = Figure()
    ax = figure.subplots()
    ax.semilogy([0.4, 30.0])
    ax.set_ylim(0.4, 30.0)
    figures.plain_log(ax.yaxis)
    figure.canvas.draw()
    low, high = ax.get_ylim()
    labels = [label for label in ax.get_yticklabels(which="both") if low <= label.get_position()[1] <= high]
    assert [label.get_text() for label in labels if label.get_text()] == ["0.5", "1", "2", "5", "10", "20"]


@pytest.mark.parametrize("classes", [True, False])
def test_a_mesh_is_shown_with_the_classes_it_has(classes):
    scene = toy_scene.two_rooms()
    mesh = trimesh.Trimesh(scene.vertices, scene.faces, process=False)
    mesh.visual.vertex_colors = np.full((len(mesh.vertices), 3), (200, 30, 30), np.uint8)
    if classes:
        mesh.vertex_attributes["semantics"] = np.full(len(mesh.vertices), 4, np.uint8)
    artifact = {"mesh": mesh, "points": mesh.vertices, "distance": np.full(len(mesh.vertices), 0.1), "limit": 0.1}
    figure = figures.mesh_view(artifact)
    titles = [ax.get_title() for ax in figure.axes if ax.images and ax.get_title()]
    assert titles == ["colours", *(["classes"] if classes else []), "distance to the true surface"]
    pixels = np.asarray(figure.axes[0].images[0].get_array()).reshape(-1, 3).astype(int)
    pixels = pixels[pixels.min(axis=1) < 250]
    assert np.mean((pixels[:, 0] > 110) & (pixels[:, 1] <= 30)) > 0.95, "in the colours of the mesh, but for edges"
    assert "no surface was found" in words(figures.mesh_view({**artifact, "mesh": trimesh.Trimesh()}))


def test_a_figure_that_fails_does_not_affect_the_others(tmp_path, monkeypatch):
    def broken(*args):
        raise ValueError("no pen")

    class Dark:
        def density(self, points):
            return np.zeros(len(points), np.float32)

        def seen(self, points):
            return np.zeros(len(points), bool)

    monkeypatch.setattr(figures, "map_overlay", broken)
    artifacts = {task: {"truth": None} for task in TASKS}
    run_figures.draw_scores(tmp_path, Dark(), toy_scene.two_rooms(), artifacts)
    stored = read_gallery(tmp_path, "evaluate")
    assert {figure.section for figure in stored} == set(TASKS)
    assert "ValueError: no pen" in words(run_figures._drawn("map_overlay", {"artifact": {"truth": None}}))
    assert "could not be computed" in words(run_figures._drawn("map_overlay", {"artifact": {}}))
