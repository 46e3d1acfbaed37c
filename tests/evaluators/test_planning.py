"""Planning: paths and outcomes computed by hand, then perfect, empty and blocked maps."""

import gc
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import toy_scene
from hand_map import hand_map

from autonerf_lab.classes import CLASS_NAMES, NUM_CLASSES
from autonerf_lab.evaluators import TrueField
from autonerf_lab.evaluators.ground_truth import true_map
from autonerf_lab.evaluators.maps import CellState, predict_states
from autonerf_lab.evaluators.planning import (
    MAX_OBSTACLE_CELLS,
    Episode,
    EpisodeSet,
    PlanningTask,
    dilate_obstacles,
    evaluate_planning,
    object_ring,
    obstacle_cells,
    plan_objects,
    plan_points,
    planning_scores,
    sample_episodes,
    scene_episodes,
    spl,
)
from autonerf_lab.evaluators.semantic_maps import class_votes, semantic_cells
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.presets import preset
from autonerf_lab.simulator import Simulator


@pytest.fixture(scope="module")
def truth():
    return true_map(Simulator(toy_scene.two_rooms(), Intrinsics.from_fov(48, 48), supersample=1))


@pytest.fixture(scope="module")
def episode_set(truth):
    return sample_episodes(truth, 20, seed=1)


@pytest.fixture(scope="module")
def perfect(truth):
    labels = np.zeros(truth.grid.shape, np.uint8)
    for k in truth.classes:
        labels[truth.semantics[k - 1]] = k
    return np.where(truth.free, CellState.FREE, CellState.OCCUPIED).astype(np.uint8), labels


def episode(reason: str, length: float, shortest: float) -> Episode:
    return Episode(np.zeros(2), None, 0, reason, None, length, shortest)


def test_spl_by_hand():
    episodes = [episode("", 4.0, 2.0), episode("", 1.0, 3.0), episode("no path", 1.0, 1.0), episode("", 0.0, 0.0)]
    assert spl(episodes) == pytest.approx(100 * (0.5 + 1 + 0 + 1) / 4)
    assert spl([]) is None


def test_dilation_by_hand():
    free = np.ones((5, 5), bool)
    free[2, 2] = False
    remaining = dilate_obstacles(free, 0.01, 0.01)
    assert (~remaining).astype(int).tolist() == [
        [0, 0, 0, 0, 0],
        [0, 0, 1, 0, 0],
        [0, 1, 1, 1, 0],
        [0, 0, 1, 0, 0],
        [0, 0, 0, 0, 0],
    ]


def test_obstacle_cells_count_what_lies_between_waypoints():
    passable = np.ones((3, 40), bool)
    passable[:, 10:19] = False
    path = np.array([[1, 0], [1, 39]])
    assert obstacle_cells(path, passable) == 9 == MAX_OBSTACLE_CELLS - 1


def strip(text: str, goal: int, cell: float = 0.1) -> tuple[object, EpisodeSet]:
    """Return a true map of three equal rows, and one episode in its middle row, from column 0 to ``goal``."""
    truth = hand_map([text] * 3, cell)
    shortest_object = np.full((NUM_CLASSES, 1), np.inf)
    shortest_object[truth.classes] = cell
    passable = truth.free | truth.semantics.any(axis=0)
    episodes = EpisodeSet(
        *(passable, np.array([[1, 0]]), np.array([[1, goal]]), np.array([cell * goal])),
        *(tuple(truth.classes), shortest_object),
    )
    return truth, episodes


@pytest.mark.parametrize(("distance", "reason"), [(9, ""), (10, "ended far"), (15, "ended far")])
def test_an_object_is_reached_within_less_than_a_metre(distance, reason):
    """The class is predicted in column 40: the path ends at its goal region, 25 cells before, in column 15.

    The true object is in column 15 + ``distance``, in cells of 10 cm.
    """
    truth, episodes = strip("." * (15 + distance) + "4" + "." * 40, 50)
    labels = np.zeros(truth.grid.shape, np.uint8)
    labels[1, 40] = 4
    (episode,) = plan_objects(np.ones(truth.grid.shape, bool), labels, truth, episodes)
    assert episode.path[-1].tolist() == [1, 15] and episode.length == pytest.approx(1.5)
    assert episode.reason == reason and episode.class_id == 4 and episode.goal is None


@pytest.mark.parametrize(("blocked", "reason"), [(9, ""), (10, "through an obstacle")])
def test_a_path_may_cross_nine_obstacle_cells(blocked, reason):
    truth, episodes = strip("." * 20 + "#" * blocked + "." * 20, 39)
    (episode,) = plan_points(np.ones(truth.grid.shape, bool), episodes, 0.1)
    assert episode.reason == reason and episode.success == (reason == "")
    assert episode.length == pytest.approx(3.9) and episode.shortest == pytest.approx(3.9)
    assert episode.spl == pytest.approx(1.0 if reason == "" else 0.0)


def test_predicted_obstacles_are_dilated_by_20_cm_and_true_ones_by_18():
    """Cells of 5 cm: the centres of 4 cells on either side lie within 20 cm of the obstacle, of 3 within 18 cm."""
    truth, episodes = strip("." * 20 + "#" + "." * 20, 40, cell=0.05)
    states = np.where(truth.free, CellState.FREE, CellState.OCCUPIED)
    free = evaluate_planning(states, np.zeros_like(states), truth, episodes).artifact["free"]
    assert np.flatnonzero(~free[1]).tolist() == list(range(16, 25))
    passable = sample_episodes(hand_map(["." * 20 + "#" + "." * 21], 0.05), 1).passable
    assert np.flatnonzero(passable[0]).tolist() == list(range(24, 42)), "the larger of the two sides"


def test_unknown_cells_are_obstacles_of_the_plan():
    truth, episodes = strip("." * 80, 79)
    states = np.full(truth.grid.shape, CellState.FREE)
    states[:, 20:61] = CellState.UNKNOWN
    result = evaluate_planning(states, np.zeros_like(states), truth, episodes)
    assert result.artifact["reasons"]["pointgoal"] == {"no path": 1}


@pytest.mark.parametrize(("goal", "reason"), [(100, ""), (101, "no path")])
def test_a_disc_of_40_cells_is_cleared_around_a_blocked_goal(goal, reason):
    """Columns 60 and above are blocked: the disc around column 100 begins there, that around 101 one cell later."""
    truth, episodes = strip("." * 120, goal)
    free = np.ones(truth.grid.shape, bool)
    free[:, 60:] = False
    (episode,) = plan_points(free, episodes, 0.1)
    assert episode.reason == reason and free[:, 60:].sum() == 0
    assert episode.length == (np.inf if reason else pytest.approx(10.0))


@pytest.mark.parametrize(("first", "reason"), [(40, ""), (41, "no path")])
def test_a_blocked_start_is_left_on_a_straight_line(first, reason):
    truth, episodes = strip("." * 120, 110)
    free = np.ones(truth.grid.shape, bool)
    free[:, :first] = False
    (episode,) = plan_points(free, episodes, 0.1)
    assert episode.reason == reason
    if not reason:
        assert episode.path[:2].tolist() == [[1, 0], [1, 40]] and episode.length == pytest.approx(11.0)


def test_goals_are_at_a_geodesic_distance_of_two_metres():
    """On a strip one cell wide, the geodesic distance is the difference of the columns."""
    found = sample_episodes(hand_map(["." * 26], 0.1), 200, seed=3)
    columns = np.abs(found.starts[:, 1] - found.goals[:, 1])
    assert columns[columns > 0].min() == 20 and columns.max() == 25
    np.testing.assert_allclose(found.shortest, 0.1 * columns)
    inner = (found.starts[:, 1] > 5) & (found.starts[:, 1] < 20)
    assert inner.any() and not columns[inner].any() and columns[~inner].mean() > 19, "no cell is 2 m from the middle"
    assert np.array_equal(found.goals[inner], found.starts[inner])
    assert not len(plan_points(np.ones((1, 26), bool), found, 0.1)) - (~inner).sum()
    assert not np.array_equal(found.starts, sample_episodes(hand_map(["." * 26], 0.1), 200, seed=4).starts)


def test_a_map_without_passable_cells_has_no_episode():
    found = sample_episodes(hand_map(["###", "#.#", "###"], 0.1), 5)
    assert found.starts.shape == found.goals.shape == (0, 2) and found.classes == () and len(found.shortest) == 0
    assert found.shortest_object.shape == (NUM_CLASSES, 0) and not found.passable.any()


def test_shortest_paths_to_objects_lead_to_their_goal_regions():
    """Class 4 is in columns 0 and 1, its goal region ends 25 cells later; a start inside it is not an episode."""
    truth = hand_map(["44" + "." * 58] * 9, 0.1)
    found = sample_episodes(truth, 30, seed=0)
    assert found.classes == (4,)
    middle = found.starts[:, 0] == 4
    wanted = np.maximum(0.0, 0.1 * (found.starts[:, 1] - 26))
    np.testing.assert_allclose(found.shortest_object[4][middle], wanted[middle], atol=1e-9)
    assert np.isinf(found.shortest_object[[0, 3, 5]]).all()
    labels = np.zeros(truth.grid.shape, np.uint8)
    labels[:, :2] = 4
    planned = plan_objects(found.passable, labels, truth, found)
    assert 0 < len(planned) == int((found.shortest_object[4] > 0).sum()) < 30
    assert {episode.reason for episode in planned} == {"ended far"}, "the region ends 2.5 m from the object"


def test_episodes_of_a_map_are_sampled_once():
    truth = hand_map(["." * 30], 0.1)
    first = scene_episodes(truth, 3, seed=1)
    assert scene_episodes(truth, 3, seed=1) is first
    assert scene_episodes(truth, 3, seed=2) is not first and len(scene_episodes(truth, 4, seed=1).starts) == 4
    from autonerf_lab.evaluators import planning

    count = len(planning._EPISODES)
    del truth, first
    gc.collect()
    assert len(planning._EPISODES) == count - 3, "nothing is kept of a map that is gone"


def test_scores_without_episodes_say_why():
    for rows, words in ((["..."], "no object in the scene"), (["4.."], "no goal within reach")):
        result = planning_scores([], [], hand_map(rows))
        assert set(result.values.values()) == {None} and set(result.n.values()) == {0}
        assert result.status["pointgoal_success"] == result.status["pointgoal_spl"] == "no goal within reach"
        assert result.status["objectgoal_success"] == result.status["objectgoal_spl"] == words


def test_planning_scores_by_hand():
    points = [episode("", 4.0, 2.0), episode("no path", np.inf, 1.0), episode("", 1.0, 1.0), episode("", 2.0, 2.0)]
    result = planning_scores(points, [episode("ended far", 1.0, 1.0)], hand_map(["4.."]))
    assert result.values == {
        **{"pointgoal_success": 75.0, "pointgoal_spl": 62.5},  # (1/2 + 0 + 1 + 1) / 4
        **{"objectgoal_success": 0.0, "objectgoal_spl": 0.0},
    }
    assert result.n == {name: 4 if name.startswith("point") else 1 for name in result.values} and not result.status
    assert result.details["reasons"]["PointGoal"] == {"no path": 1, "success": 3}


@pytest.mark.parametrize(
    ("first", "ring"),
    [
        (10, list(range(10, 26))),  # up to 25 cells from the object in column 0
        (30, list(range(30, 36))),  # the nearest free cell, and 5 cells more
        (20, list(range(20, 26))),
        (21, list(range(21, 27))),
        (99, [99, 100]),  # the region of an object is searched up to 100 cells away
        (100, []),  # out of reach
    ],
)
def test_the_goal_region_of_an_object_by_hand(first, ring):
    cells, passable = np.zeros((1, 150), bool), np.zeros((1, 150), bool)
    cells[0, 0], passable[0, first:] = True, True
    assert np.flatnonzero(object_ring(cells, passable)[0]).tolist() == ring
    assert not object_ring(np.zeros_like(cells), passable).any()


@pytest.mark.parametrize(("size", "kept"), [(10, True), (11, False)])
def test_patches_under_a_tenth_of_the_largest_are_noise(size, kept):
    cells, passable = np.zeros((3, 200), bool), np.ones((3, 200), bool)
    cells[1, :size] = cells[1, 150] = True
    passable[cells] = False
    assert object_ring(cells, passable, min_share=0.1)[1, 130] == kept


@pytest.mark.parametrize(("size", "end"), [(10, 15), (11, 65)])
def test_paths_do_not_lead_to_patches_that_are_noise(size, end):
    """A single predicted cell in column 40, and a patch of ``size`` cells from column 90 on."""
    truth, episodes = strip("." * 95 + "4" + "." * 24, 0)
    labels = np.zeros(truth.grid.shape, np.uint8)
    labels[1, [40, *range(90, 90 + size)]] = 4
    (episode,) = plan_objects(np.ones(truth.grid.shape, bool), labels, truth, episodes)
    assert episode.path[-1].tolist() == [1, end]


@pytest.mark.parametrize(("gap", "joined"), [(3, True), (4, False)])
def test_cells_of_a_patch_may_have_gaps(gap, joined):
    """Columns 0 to 10 and a single cell ``gap`` columns later: alone it would be noise."""
    cells, passable = np.zeros((1, 100), bool), np.ones((1, 100), bool)
    cells[0, :11] = cells[0, 10 + gap] = True
    ring = object_ring(cells, passable, min_share=0.1)
    assert ring[0].nonzero()[0].max() == (10 + gap if joined else 10) + 25


def test_obstacle_cells_include_both_ends_of_a_path():
    passable = np.ones((1, 3), bool)
    passable[0, [0, 2]] = False
    assert obstacle_cells(np.array([[0, 0], [0, 2]]), passable) == 2
    assert obstacle_cells(np.array([[0, 2]]), passable) == 1


def test_the_task_plans_on_the_map_of_the_field():
    truth = hand_map(["." * 60] * 3, 0.1)
    states = np.full(truth.grid.shape, CellState.FREE)
    sizes = replace(preset("smoke"), planning_starts=7)
    context = SimpleNamespace(truth=truth, states=states, labels=np.zeros_like(states), preset=sizes, seed=2)
    result = PlanningTask().run(context)
    assert result.artifact["truth"] is truth and result.artifact["free"].all()
    assert result.artifact["episode_set"] is scene_episodes(truth, 7, seed=2)
    assert result.n["pointgoal_success"] == len(result.artifact["points"]) == 7


def test_ring_is_beside_the_object_and_small_patches_are_noise():
    passable = np.ones((120, 300), bool)
    object_cells = np.zeros_like(passable)
    object_cells[50:60, 50:60] = True
    object_cells[5, 290] = True
    passable[45:65, 45:65] = False
    ring = object_ring(object_cells, passable, min_share=0.1)
    assert ring[55, 70] and not ring[55, 55] and not ring[5, 280] and not ring[55, 100]
    assert object_ring(object_cells, passable)[5, 280]


def test_episodes_follow_the_protocol(truth, episode_set):
    assert np.all(episode_set.passable[tuple(episode_set.starts.T)]) and np.all(
        episode_set.passable[tuple(episode_set.goals.T)]
    )
    straight = np.hypot(*(episode_set.starts - episode_set.goals).T) * truth.grid.cell
    assert np.all(episode_set.shortest >= 2.0) and np.all(episode_set.shortest > straight - 0.02)
    again = sample_episodes(truth, 20, seed=1)
    np.testing.assert_array_equal(again.goals, episode_set.goals)
    assert episode_set.classes == (4, 7, 10, 13)


def test_perfect_map_with_equal_dilation(truth, episode_set, perfect):
    result = evaluate_planning(*perfect, truth, episode_set, dilation=0.18)
    assert result.values["pointgoal_success"] == result.values["objectgoal_success"] == 100.0
    assert result.values["pointgoal_spl"] >= 99 and result.values["objectgoal_spl"] >= 99


def test_the_true_geometry_as_a_field_with_equal_dilation(truth, episode_set):
    field = TrueField(toy_scene.two_rooms(), views=300)
    labels = semantic_cells(class_votes(field, truth.grid))
    result = evaluate_planning(predict_states(field, truth.grid), labels, truth, episode_set, dilation=0.18)
    assert result.values["pointgoal_success"] == 100 and result.values["pointgoal_spl"] >= 99
    assert result.values["objectgoal_success"] == 100 and result.values["objectgoal_spl"] >= 95


def test_paths_on_an_empty_map_cross_obstacles_and_have_no_objects(truth, episode_set):
    states = np.full(truth.grid.shape, CellState.FREE, np.uint8)
    result = evaluate_planning(states, np.zeros_like(states), truth, episode_set)
    assert result.values["objectgoal_success"] == 0.0
    count = int((episode_set.shortest_object[list(episode_set.classes)] > 0).sum())
    assert result.artifact["reasons"]["objectgoal"] == {"class not predicted": count}
    assert "through an obstacle" in result.artifact["reasons"]["pointgoal"]
    reasons = result.details["reasons"]
    assert list(reasons) == ["PointGoal", "ObjectGoal", *(f"ObjectGoal: {CLASS_NAMES[k]}" for k in episode_set.classes)]
    assert sum(reasons[f"ObjectGoal: {CLASS_NAMES[k]}"]["class not predicted"] for k in episode_set.classes) == count


def test_a_wall_in_the_doorway_separates_the_rooms(truth, episode_set, perfect):
    states, labels = perfect[0].copy(), perfect[1]
    cells = np.indices(states.shape).reshape(2, -1).T
    x = truth.grid.centers(cells)[:, 0].reshape(states.shape)
    states[np.abs(x - 4.05) < 0.5] = CellState.UNKNOWN
    result = evaluate_planning(states, labels, truth, episode_set, dilation=0.18)
    for e in result.artifact["points"]:
        ends = np.sort(truth.grid.centers(np.stack([e.start, e.goal]))[:, 0])
        if ends[0] < 3 and ends[1] > 5.1:
            assert e.reason == "no path" and e.spl == 0
        elif ends[1] < 3 or ends[0] > 5.1:
            assert e.success


def test_paths_to_misplaced_objects_end_far(truth, episode_set, perfect):
    states, labels = perfect
    wrong = np.where(labels == 10, 4, np.where(labels == 4, 10, labels)).astype(np.uint8)
    result = evaluate_planning(states, wrong, truth, episode_set, dilation=0.18)
    reasons = {e.reason for e in result.artifact["objects"] if e.class_id in (4, 10)}
    assert reasons == {"ended far"}
