"""Planning: paths and outcomes computed by hand, then perfect, empty and blocked maps."""

import numpy as np
import pytest
import toy_scene

from autonerf_lab.classes import CLASS_NAMES
from autonerf_lab.evaluators import TrueField
from autonerf_lab.evaluators.ground_truth import true_map
from autonerf_lab.evaluators.maps import CellState, predict_states
from autonerf_lab.evaluators.planning import (
    MAX_OBSTACLE_CELLS,
    Episode,
    dilate_obstacles,
    evaluate_planning,
    object_ring,
    obstacle_cells,
    sample_episodes,
    spl,
)
from autonerf_lab.evaluators.semantic_maps import point_cloud, semantic_cells
from autonerf_lab.geometry import Intrinsics
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
    labels = semantic_cells(*point_cloud(field), truth.grid)
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
