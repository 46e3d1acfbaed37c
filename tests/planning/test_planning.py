import heapq

import numpy as np
import pytest

from autonerf_lab.exploration import explore
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.planning import descend, dilate, path_length, travel_distance, weighted_success
from autonerf_lab.planning.dilation import bounding_box, nearest_set_cell
from autonerf_lab.planning.fast_marching import UpdatedDistance
from autonerf_lab.scenes import load_scene
from autonerf_lab.simulator import Simulator

MAZE = """
..........
.####.....
....#..##.
.##.#...#.
.#..#.#.#.
.#.##.#...
......####
"""
X = np.inf
# Made with scikit-fmm 2025.6.23: skfmm.distance of a masked array of ones, 0 at the goal, dx=1, order=1.
SKFMM = np.array(
    [
        [6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0, 15.0],
        [5.0, X, X, X, X, 12.0, 12.545328925, 13.442230407, 14.370902299, 15.318743358],
        [4.0, 3.0, 2.0, 1.0, X, 11.0, 11.707106781, X, X, 16.318743358],
        [5.0, X, X, 0.0, X, 10.0, 11.0, 12.0, X, 17.318743358],
        [6.0, X, 2.0, 1.0, X, 9.0, X, 13.0, X, 17.0],
        [7.0, X, 3.0, X, X, 8.0, X, 14.0, 15.0, 16.0],
        [6.0, 5.0, 4.0, 5.0, 6.0, 7.0, X, X, X, X],
    ]
)


def _grid(text):
    return np.array([[c == "." for c in row] for row in text.split()])


def test_distances_equal_scikit_fmm():
    distance = travel_distance(_grid(MAZE), np.array([[3, 3]]))
    np.testing.assert_allclose(distance, SKFMM, rtol=0, atol=2e-9)


def test_one_diagonal_step_computed_by_hand():
    distance = travel_distance(np.ones((2, 2), bool), np.array([[0, 0]]), cell=2.0)
    # Both neighbours at 1: (T - 1)^2 + (T - 1)^2 = 1, so T = 1 + 1 / sqrt 2, in cells of 2 m.
    np.testing.assert_allclose(distance, [[0, 2], [2, 2 + np.sqrt(2)]])


def test_the_error_on_open_ground_decreases_with_the_cell():
    errors = []
    for size in (41, 161):
        middle = size // 2
        distance = travel_distance(np.ones((size, size), bool), np.array([[middle, middle]]), 1 / size)
        rows, cols = np.mgrid[:size, :size]
        exact = np.hypot(rows - middle, cols - middle) / size
        errors.append(np.abs(distance - exact).max())
        assert (distance >= exact - 1e-12).all()  # never shorter than the straight line
    assert errors[1] < 0.4 * errors[0]
    assert errors[1] < 0.01


def _marched_with_a_heap(free, goal):
    """Fast marching as in the textbook: always expand the nearest cell, from a heap."""
    distance = np.full((free.shape[0] + 2, free.shape[1] + 2), np.inf)
    heap = [(0.0, r + 1, c + 1) for r, c in np.argwhere(free & goal)]
    best = {(r, c): 0.0 for _, r, c in heap}
    while heap:
        key, r, c = heapq.heappop(heap)
        if distance[r, c] <= key:
            continue
        distance[r, c] = key
        for y, x in ((r - 1, c), (r + 1, c), (r, c - 1), (r, c + 1)):
            inside = 0 < y <= free.shape[0] and 0 < x <= free.shape[1]
            if not inside or not free[y - 1, x - 1] or distance[y, x] < np.inf:
                continue
            a = min(distance[y - 1, x], distance[y + 1, x])
            b = min(distance[y, x - 1], distance[y, x + 1])
            value = (a + b + np.sqrt(2 - (a - b) ** 2)) / 2 if abs(a - b) < 1 else min(a, b) + 1
            if value < best.get((y, x), np.inf):
                best[y, x] = value
                heapq.heappush(heap, (value, y, x))
    return distance[1:-1, 1:-1]


@pytest.mark.parametrize("blocked", [0.0, 0.1, 0.3])
def test_distances_equal_those_of_a_heap_bit_for_bit(blocked):
    rng = np.random.default_rng(7)
    for _ in range(8):
        free = rng.random((40, 50)) >= blocked
        goal = rng.random((40, 50)) < rng.choice([0.001, 0.02, 0.3])
        want = _marched_with_a_heap(free, goal)
        np.testing.assert_array_equal(travel_distance(free, goal), want)
        np.testing.assert_array_equal(travel_distance(free, goal, limit=6.3), np.where(want <= 6.3, want, np.inf))
        row, col = rng.integers(40), rng.integers(50)
        near = want <= want[row, col]  # everything if it is unreachable
        np.testing.assert_array_equal(travel_distance(free, goal, stop_at=(row, col)), np.where(near, want, np.inf))


def test_stopping_early_does_not_change_the_reached_cells():
    free = np.random.default_rng(0).random((30, 40)) > 0.2
    free[5, 5] = free[20, 30] = True
    full = travel_distance(free, np.array([[5, 5]]))
    early = travel_distance(free, np.array([[5, 5]]), stop_at=(20, 30))
    assert np.isfinite(full[20, 30])
    reached = np.isfinite(early)
    assert reached[20, 30]
    np.testing.assert_array_equal(early[reached], full[reached])
    assert (full[reached] <= full[20, 30]).all() and not reached.all()


def test_updated_distances_equal_new_ones_bit_for_bit():
    """Blocks appear and vanish, the robot moves, the window grows, moves and shrinks, the goal changes."""
    for seed in range(30):
        rng = np.random.default_rng(seed)
        size = int(rng.integers(20, 90))
        occupied = rng.random((size, size)) < rng.choice([0.0, 0.005, 0.02])
        low, high = np.full(2, size // 3), np.full(2, 2 * size // 3)
        lengths, goal_cell, robot = UpdatedDistance(0.05), rng.integers(low, high), rng.integers(low, high)
        radius = int(rng.integers(4))
        for _ in range(25):
            for _ in range(rng.integers(4)):
                row, col, height, width = *rng.integers(size, size=2), *rng.integers(1, 5, 2)
                occupied[row : row + height, col : col + width] = rng.random() < 0.7
            if rng.random() < 0.3:
                low, high = (
                    np.maximum(0, low - rng.integers(3, size=2)),
                    np.minimum(size, high + rng.integers(3, size=2)),
                )
            elif rng.random() < 0.1:
                axis = rng.integers(2)
                low[axis] = min(low[axis] + 2, size // 3)
            if rng.random() < 0.05:
                goal_cell = rng.integers(low, high)
            robot = np.clip(robot + rng.integers(-4, 5, 2), low, high - 1)
            rows, cols = np.ogrid[low[0] : high[0], low[1] : high[1]]
            free = ~dilate(occupied, 1.5)[low[0] : high[0], low[1] : high[1]]
            goal = (rows - goal_cell[0]) ** 2 + (cols - goal_cell[1]) ** 2 <= radius**2
            free |= (abs(rows - robot[0]) <= 1) & (abs(cols - robot[1]) <= 1)
            stop = robot - low
            want = travel_distance(free, goal, 0.05, stop)
            np.testing.assert_array_equal(lengths.update(free, goal, stop, tuple(low)), want)


@pytest.mark.parametrize("noise", [None, "ans"])
def test_a_rollout_takes_the_same_actions_as_with_new_distances(noise, monkeypatch):
    sim = Simulator(load_scene("dev-0"), Intrinsics.from_fov(32, 32), rgb=False, noise=noise)
    updated = explore(sim, "frontier", steps=250, seed=1, progress=False).meta["actions"]
    calls = []

    def new(self, free, goal, stop_at, corner=(0, 0)):
        calls.append(corner)
        return travel_distance(free, goal, self._cell, stop_at)

    monkeypatch.setattr(UpdatedDistance, "update", new)
    assert explore(sim, "frontier", steps=250, seed=1, progress=False).meta["actions"] == updated
    assert len(calls) > 20


def test_an_update_keeps_the_lengths_before_the_change():
    """Lengths that are not computed again keep a value that was written into them."""
    lengths, free, goal = UpdatedDistance(), np.ones((2, 9), bool), np.zeros((2, 9), bool)
    goal[:, 0] = True
    lengths.update(free, goal, (0, 8))
    lengths._buffers.trial[1, 4] = 3.5  # behind the border: row 0, column 3
    free[0, 6] = False
    want = travel_distance(free, goal, stop_at=(0, 8))
    want[0, 3] = 3.5
    np.testing.assert_array_equal(lengths.update(free, goal, (0, 8)), want)


def test_weighted_success_by_hand():
    """A path of 4 m where 3 m are possible; one measured shorter than possible; a goal at the start; a failure."""
    cases = [(True, 4.0, 3.0), (True, 2.9, 3.0), (True, 0.0, 0.0), (False, 1.0, 1.0)]
    assert [weighted_success(*case) for case in cases] == [0.75, 1.0, 1.0, 0.0]


def test_the_goal_may_be_a_mask_and_blocked_goals_are_ignored():
    free = np.ones((5, 5), bool)
    free[0] = False
    goal = np.zeros((5, 5), bool)
    goal[0, 0] = goal[4, 4] = True
    np.testing.assert_array_equal(travel_distance(free, goal), travel_distance(free, np.array([[4, 4]])))
    assert np.isinf(travel_distance(free, np.array([[0, 0]]))).all()


def test_descent_in_the_maze_ends_at_the_goal_and_crosses_no_wall():
    free = _grid(MAZE)
    distance = travel_distance(free, np.array([[3, 3]]))
    for start in np.argwhere(np.isfinite(distance)):
        path = descend(distance, start)
        assert path[0].tolist() == start.tolist() and path[-1].tolist() == [3, 3]
        assert free[tuple(path.T)].all()
        assert (np.diff(distance[tuple(path.T)]) < 0).all()
        assert path_length(path) <= 1.05 * distance[tuple(start)] + 1e-9


def test_descent_on_open_ground_is_nearly_straight():
    distance = travel_distance(np.ones((120, 120), bool), np.array([[10, 10]]), 0.05)
    for start in [(100, 100), (100, 60), (31, 117)]:
        straight = 0.05 * np.hypot(start[0] - 10, start[1] - 10)
        assert path_length(descend(distance, start, 0.05), 0.05) < 1.01 * straight


def test_descent_from_a_blocked_cell_has_no_step():
    distance = travel_distance(_grid("..#."), np.array([[0, 0]]))
    assert descend(distance, (0, 3)).tolist() == [[0, 3]]


@pytest.mark.parametrize("radius", [0, 1, 2.5, 4])
def test_dilation_is_a_disc_around_every_cell(radius):
    mask = np.random.default_rng(1).random((20, 25)) < 0.03
    rows, cols = np.mgrid[:20, :25]
    want = np.zeros_like(mask)
    for r, c in np.argwhere(mask):
        want |= np.hypot(rows - r, cols - c) <= radius
    np.testing.assert_array_equal(dilate(mask, radius), want)


def test_the_bounding_box_contains_all_set_cells_and_none_is_empty():
    mask = np.zeros((9, 7), bool)
    assert bounding_box(mask) == (0, 0, 0, 0)
    mask[0, 3] = mask[6, 1] = mask[2, 6] = True
    assert bounding_box(mask) == (0, 7, 1, 7)


def test_the_nearest_set_cell_is_the_first_of_those_at_the_smallest_distance():
    rng = np.random.default_rng(0)
    for share in (0.01, 0.1, 0.9):
        mask = rng.random((17, 23)) < share
        cells = np.argwhere(mask)
        for row, col in rng.integers(0, 17, (40, 2)):
            want = cells[np.argmin(((cells - (row, col)) ** 2).sum(axis=1))]
            assert nearest_set_cell(mask, row, col) == tuple(want)
    assert nearest_set_cell(np.zeros((3, 3), bool), 1, 1) == (-1, -1)
