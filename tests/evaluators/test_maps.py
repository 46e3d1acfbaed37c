"""Maps: grids computed by hand, the true map of a toy scene, and the scores of perfect, empty and displaced fields."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import toy_scene
from hand_map import hand_map

from autonerf_lab.errors import SceneError
from autonerf_lab.evaluators import TrueField
from autonerf_lab.evaluators.context import EvaluationContext
from autonerf_lab.evaluators.ground_truth import MapGrid, true_map
from autonerf_lab.evaluators.maps import (
    CellState,
    band_levels,
    free_scores,
    occupancy_scores,
    predict_states,
    share_within,
)
from autonerf_lab.evaluators.radiance_field import point_cloud, training_views
from autonerf_lab.evaluators.semantic_maps import MapsTask, class_votes, semantic_cells, semantic_scores
from autonerf_lab.geometry import Intrinsics, camera_rays
from autonerf_lab.presets import preset
from autonerf_lab.simulator import Simulator
from autonerf_lab.types import Rendering

U, F, O = CellState.UNKNOWN, CellState.FREE, CellState.OCCUPIED  # noqa: E741


@pytest.fixture(scope="module")
def sim():
    return Simulator(toy_scene.two_rooms(), Intrinsics.from_fov(48, 48), supersample=1)


@pytest.fixture(scope="module")
def truth(sim):
    return true_map(sim)


@pytest.fixture(scope="module")
def field(sim):
    return TrueField(sim.scene, sim, views=300)


HAND = hand_map(["     ", " ##  ", " #...", " #...", "     "])


def test_free_scores_by_hand():
    states = np.array([[U, U, U, U, U], [U, O, O, U, U], [U, O, F, F, U], [U, F, F, F, O], [F, F, F, F, F]])
    # Of 6 free cells 4 are found, one is unknown, one taken for occupied; of 4 occupied one is taken for free
    scores = free_scores(states, HAND)
    assert scores["free_accuracy"] == pytest.approx(100 * (4 + 3) / 10)
    assert scores["free_precision"] == pytest.approx(100 * 4 / 5)
    assert scores["free_recall"] == pytest.approx(100 * 4 / 6)


def test_a_map_without_free_cells_has_no_precision():
    scores = free_scores(np.full((5, 5), U), HAND)
    assert scores == {"free_accuracy": 40.0, "free_precision": None, "free_recall": 0.0}


def test_occupancy_tolerance_by_hand():
    truth = hand_map(["#........."])
    states = np.array([[F, F, F, F, F, O, O, F, F, F]])
    assert occupancy_scores(states, truth, tolerance=0.05) == {"occupancy_precision": 50.0, "occupancy_recall": 100.0}
    assert occupancy_scores(states, truth, tolerance=0.04) == {"occupancy_precision": 0.0, "occupancy_recall": 0.0}


def test_share_within_matches_a_naive_reference():
    rng = np.random.default_rng(0)
    cells, others = rng.integers(0, 60, (80, 2)), rng.integers(0, 60, (40, 2))
    naive = np.mean([min(np.hypot(*(c - o)) for o in others) <= 5 for c in cells])
    assert share_within(cells, others, 5) == pytest.approx(100 * naive)


class Columns:
    """One map cell per entry: a voxel at ``height`` of the cell has this density, the rest is air."""

    def __init__(self, density, height=0.5, seen_at=None):
        self.column, self.height, self.seen_at = np.array(density), height, seen_at

    def density(self, points):
        there = np.abs(points[:, 2] - self.height) < 0.015
        return np.where(there, self.column[points[:, 0].astype(int)], 0)

    def seen(self, points):
        return np.ones(len(points), bool) if self.seen_at is None else np.abs(points[:, 2] - self.seen_at) < 0.015


def test_a_cell_is_occupied_from_an_opacity_of_nine_tenths():
    """1 - exp(-0.1 sigma) is 0.5 for 6.93 per metre, 0.89 for 22.07, 0.9 for 23.03 and 0.91 for 24.08."""
    grid = MapGrid(np.zeros(2), (1, 4), 1.0)
    assert predict_states(Columns([0, 6.94, 22.07, 24.08]), grid).tolist() == [[F, F, F, O]]
    assert predict_states(Columns([0, 6.92, 6.94, 24.08]), grid, threshold=0.5).tolist() == [[F, F, O, O]]


def test_the_height_band_has_26_voxels_of_3_cm():
    levels = band_levels()
    assert levels == pytest.approx(0.115 + 0.03 * np.arange(26)) and levels[-1] == pytest.approx(0.865)
    for height, state in ((0.08, F), (0.115, O), (0.145, O), (0.865, O), (0.895, F)):
        assert predict_states(Columns([100.0], height), MapGrid(np.zeros(2), (1, 1), 1.0)).item() == state


def test_a_cell_is_known_if_a_view_saw_it_at_every_second_level():
    for height, state in ((0.115, F), (0.145, U), (0.175, F), (0.835, F), (0.865, U)):
        field = Columns([0.0], seen_at=height)
        assert predict_states(field, MapGrid(np.zeros(2), (1, 1), 1.0)).item() == state


def test_unseen_cells_are_unknown_even_if_they_are_opaque():
    class Half(Columns):
        def seen(self, points):
            return points[:, 0] < 2

    assert predict_states(Half([0.0, 100, 0, 100]), MapGrid(np.zeros(2), (1, 4), 1.0)).tolist() == [[F, O, U, U]]


def test_large_maps_are_computed_in_parts(monkeypatch):
    from autonerf_lab.evaluators import maps

    grid, field = MapGrid(np.zeros(2), (3, 4), 1.0), Columns([0.0, 100, 0, 100])
    monkeypatch.setattr(maps, "_SLAB", 5)  # parts of 5, 5 and 2 of the 12 cells
    assert predict_states(field, grid).tolist() == [[F, O, F, O]] * 3


def test_the_tolerance_of_occupied_cells_is_5_cm():
    """Three predicted cells, 5 cm, 5.1 cm and farther from the true cell; the last is not scored."""
    truth = hand_map(["#........     ", ".........     "])
    states = np.array([[F, F, F, F, F, O, F, F, F, F, F, F, F, O], [F, F, F, F, F, O, F, F, F, F, F, F, F, F]])
    assert occupancy_scores(states, truth) == {"occupancy_precision": 50.0, "occupancy_recall": 100.0}
    unscored = np.array([[F] * 9 + [O] * 5] * 2)
    assert occupancy_scores(unscored, truth) == {"occupancy_precision": None, "occupancy_recall": 0.0}


def test_semantic_scores_by_hand():
    truth = hand_map(["44...", "44...", ".....", "....7", "....."])
    labels = np.zeros((5, 5), np.uint8)
    labels[0, :3] = 4  # two hits and one false alarm next to the object, two cells missed
    scores = semantic_scores(labels, truth)
    # class 4: accuracy 22/25, precision 2/3, recall 2/4; class 7: 24/25, 0, 0
    assert scores["semantic_accuracy"] == pytest.approx(100 * (22 / 25 + 24 / 25) / 2)
    assert scores["semantic_precision"] == pytest.approx(100 * (2 / 3) / 2)
    assert scores["semantic_recall"] == pytest.approx(100 * (1 / 2) / 2)
    assert scores["semantic_precision_5cm"] == pytest.approx(50)
    assert scores["semantic_recall_5cm"] == pytest.approx(50)


def test_a_scene_without_objects_has_no_semantic_scores():
    assert set(semantic_scores(np.zeros((5, 5), np.uint8), HAND).values()) == {None}


class Views:
    """Field with given images: a camera at the origin that looks along -z, moved to ``origins``."""

    def __init__(self, depth, classes, origins=((0.0, 0.0, 0.0),)):
        self.depth, self.classes = np.array(depth, np.float32), np.array(classes, np.uint8)
        self.intrinsics = Intrinsics.from_fov(self.depth.shape[1], self.depth.shape[0])
        self.poses = np.tile(np.eye(4), (len(origins), 1, 1))
        self.poses[:, :3, 3] = origins

    def render(self, c2w, intrinsics):
        rgb = np.zeros((*self.depth.shape, 3), np.float32)
        return Rendering(rgb, self.depth, self.classes, (self.depth > 0).astype(np.float32))


def test_points_outside_the_height_band_or_the_grid_are_ignored():
    """One pixel: a point 0.5 m below the camera, which stands at four positions."""
    grid = MapGrid(np.zeros(2), (2, 2), 1.0)
    origins = [[0.5, 0.5, 0.55], [0.5, 0.5, 1.45], [5, 5, 1.0], [1.5, 0.5, 1.0]]
    votes = class_votes(Views([[0.5]], [[4]], origins), grid)
    assert votes.sum(axis=(1, 2)).tolist() == [36 * (k == 4) for k in range(16)] and votes[4, 0, 1] == 36
    assert semantic_cells(votes).tolist() == [[0, 4], [0, 0]]


def test_background_votes_and_classes_that_do_not_exist_are_background():
    grid = MapGrid(np.zeros(2), (1, 1), 1.0)
    over = [[0.5, 0.5, 1.0]]
    assert class_votes(Views([[0.5]], [[200]], over), grid)[0].item() == 36
    votes = class_votes(Views([[0.5]], [[4]], over * 2), grid) + class_votes(Views([[0.5]], [[0]], over * 3), grid)
    assert semantic_cells(votes).item() == 0


def naive_votes(field, grid):
    """Points between four neighbouring end points: a plane through a pixel's ray and three others, by its depth."""
    votes = np.zeros((16, *grid.shape), int)
    for c2w, intrinsics, image in training_views(field, 1):
        rays_o, rays_d = camera_rays(intrinsics, c2w)
        ends = rays_o + image.depth[..., None] * rays_d
        for i, j in np.argwhere(image.depth > 0):
            four = (slice(i, i + 2), slice(j, j + 2))
            points, known = ends[four].reshape(-1, 3), (image.depth[four] > 0).all()
            a, b, c, d = points if len(points) == 4 else np.zeros((4, 3))
            near = max(np.linalg.norm(p - q) for p, q in ((a, b), (a, c), (d, b), (d, c))) <= 0.2
            one = len(points) == 4 and known and near and len(np.unique(image.semantics[four])) == 1
            for u, v in itertools.product(np.arange(6) / 6, repeat=2):
                point = ends[i, j]
                if one:
                    shares = np.array([[(1 - u) * (1 - v), (1 - u) * v], [u * (1 - v), u * v]])[..., None]
                    ray = (shares * rays_d[four]).sum(axis=(0, 1))
                    point = rays_o[i, j] + ray / (shares[..., 0] / image.depth[four]).sum()
                cells, inside = grid.cells(point[None])
                if inside[0] and 0.1 <= point[2] <= 0.88:
                    votes[image.semantics[i, j], cells[0, 0], cells[0, 1]] += 1
    return votes


def test_votes_match_a_naive_reference():
    rng = np.random.default_rng(0)
    depth = 1.0 + 0.1 * rng.random((12, 12))
    depth[3, 4], depth[7, 7:] = 0.0, 1.6  # a hole and an edge
    classes = np.where(rng.random((12, 12)) < 0.1, 3, 8)
    field, grid = Views(depth, classes, [[1.013, 0.987, 1.5]]), MapGrid(np.zeros(2), (50, 50), 0.04)
    np.testing.assert_array_equal(class_votes(field, grid), naive_votes(field, grid))


def test_a_plane_between_pixels_has_no_gaps():
    """A table top, 1 m below the camera: pixels are 12 cm apart, cells 3 cm, and rays fall on one cell of 16."""
    field, grid = (
        Views(np.ones((16, 16)), np.full((16, 16), 7), [[1.0, 1.0, 1.5]]),
        MapGrid(np.zeros(2), (66, 66), 0.03),
    )
    labels = semantic_cells(class_votes(field, grid))
    assert (labels[3:62, 3:62] == 7).all()
    field.classes[8, 8] = 0  # its neighbours no longer share a surface with it
    assert (semantic_cells(class_votes(field, grid))[3:62, 3:62] == 0).sum() == pytest.approx(64, abs=16)


class Recorder:
    """Field whose renderings are empty; it records their poses and sizes."""

    def __init__(self, count, width, height):
        self.poses = np.tile(np.eye(4), (count, 1, 1))
        self.poses[:, 0, 3] = np.arange(count)
        self.intrinsics = Intrinsics.from_fov(width, height)
        self.views, self.sizes = [], set()

    def render(self, c2w, intrinsics):
        self.views.append(int(c2w[0, 3]))
        self.sizes.add((intrinsics.width, intrinsics.height))
        nothing = np.zeros((intrinsics.height, intrinsics.width), np.float32)
        return Rendering(np.zeros((*nothing.shape, 3), np.float32), nothing, None, nothing)


@pytest.mark.parametrize(
    ("camera", "size"),
    [((128, 96), (64, 48)), ((96, 128), (48, 64)), ((40, 30), (40, 30)), ((300, 1), (64, 1)), ((1, 300), (1, 64))],
)
def test_training_views_of_evaluators_have_at_most_64_pixels_a_side(camera, size):
    field = Recorder(2, *camera)
    point_cloud(field, 10**6)
    assert field.sizes == {size} and field.views == [0, 1]


@pytest.mark.parametrize(
    ("count", "views"), [(3 * 64 * 48, [0, 2, 4]), (1, [0]), (64 * 48 - 1, [0]), (10**6, [0, 1, 2, 3, 4])]
)
def test_training_views_of_evaluators_are_evenly_spaced(count, views):
    field = Recorder(5, 128, 96)
    point_cloud(field, count)
    assert field.views == views


def test_maps_have_two_million_rays():
    field = Recorder(801, 50, 50)
    class_votes(field, MapGrid(np.zeros(2), (1, 1), 1.0))
    assert len(field.views) == 800


def test_the_task_has_all_scores_of_maps(sim, truth, field):
    context = EvaluationContext(field, sim.scene, preset("smoke"))
    vars(context).update(
        truth=truth, states=predict_states(field, truth.grid), labels=np.full(truth.grid.shape, 4, np.uint8)
    )
    values = MapsTask().run(context).values
    expected = free_scores(context.states, truth) | occupancy_scores(context.states, truth)
    assert values == expected | semantic_scores(context.labels, truth)
    assert set(values) == {metric.name for metric in MapsTask.metrics}


def test_true_map_of_the_toy_scene(truth):
    def at(x, y):
        return tuple(np.floor((np.array([y, x]) - truth.grid.origin[::-1]) / truth.grid.cell).astype(int))

    assert truth.free[at(3, 1.5)] and truth.free[at(4.05, 1.5)], "floor and doorway"
    assert truth.occupied[at(1.0, 2.5)] and truth.semantics[3][at(1.0, 2.5)], "bed"
    assert truth.semantics[6][at(5.5, 2.5)] and truth.occupied[at(5.5, 2.5)], "the table is seen from above"
    assert not truth.scored[at(7.7, 0.3)], "inside the refrigerator"
    assert not truth.scored[at(4.05, 0.5)], "inside the wall"
    assert truth.classes == [4, 7, 10, 13]


def test_perfect_geometry_makes_a_perfect_map(field, truth):
    states = predict_states(field, truth.grid)
    assert set(free_scores(states, truth).values()) == {100.0}
    assert set(occupancy_scores(states, truth).values()) == {100.0}
    scores = semantic_scores(semantic_cells(class_votes(field, truth.grid)), truth)
    assert scores["semantic_precision_5cm"] > 99.9 and scores["semantic_recall_5cm"] > 99


class EmptyField(TrueField):
    """Air everywhere, seen from everywhere."""

    def density(self, points):
        return np.zeros(len(points), np.float32)

    def render(self, c2w, intrinsics):
        image = super().render(c2w, intrinsics)
        nothing = np.zeros_like(image.depth)
        return replace(image, depth=nothing, opacity=nothing, semantics=np.zeros_like(image.semantics))


def test_an_empty_field_has_recall_zero(sim, truth):
    field = EmptyField(sim.scene, sim, views=3)
    states = predict_states(field, truth.grid)
    scores = free_scores(states, truth) | occupancy_scores(states, truth)
    assert scores["occupancy_recall"] == 0.0 and scores["occupancy_precision"] is None
    assert scores["free_recall"] == 100.0 and scores["free_precision"] < 95
    assert semantic_scores(semantic_cells(class_votes(field, truth.grid)), truth)["semantic_recall_5cm"] == 0.0


class Displaced(TrueField):
    """The true scene, moved along x."""

    shift = 0.0

    def density(self, points):
        return super().density(points - np.array([self.shift, 0, 0]))


def test_displaced_walls_reduce_the_scores(sim, truth):
    """A scene moved by 2 cm stays within tolerance; by 10 cm, walls across the motion are lost."""
    scores = {}
    for shift in (0.02, 0.10):
        field = Displaced(sim.scene, sim, views=1)
        field.shift = shift
        states = predict_states(field, truth.grid)
        scores[shift] = free_scores(states, truth) | occupancy_scores(states, truth)
    assert scores[0.02]["occupancy_recall"] == 100.0
    assert scores[0.10]["occupancy_recall"] < 99
    assert 100 > scores[0.02]["free_recall"] > scores[0.10]["free_recall"]


def test_unseen_cells_are_unknown(sim, truth):
    class HalfSeen(TrueField):
        def seen(self, points):
            return points[:, 0] < 4

    states = predict_states(HalfSeen(sim.scene, sim, views=1), truth.grid)
    x = truth.grid.centers(np.argwhere(states == CellState.UNKNOWN))[:, 0]
    assert x.min() >= 4 and np.all(states[:, -100:] == CellState.UNKNOWN)
    assert free_scores(states, truth)["free_precision"] == 100.0


def test_a_grid_that_would_not_fit_is_refused():
    with pytest.raises(SceneError, match="map cells"):
        MapGrid.over(np.array([[0, 0, 0], [1e4, 1e4, 3]]))
