"""Local policy: actions in small maps, and its plans compared with values by hand and naive references."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from autonerf_lab.geometry import planar_from_pose, planar_pose, world_to_cell
from autonerf_lab.mapping import empty_map
from autonerf_lab.planning import LocalPolicy, travel_distance
from autonerf_lab.planning.fast_marching import UpdatedDistance
from autonerf_lab.planning.local_policy import _goal_cells, _near_obstacle
from autonerf_lab.types import Action


def _map(walls=(), heading=0.0, at=(0.01, 0.01)):
    """Explored map of 6 m a side around the origin; walls are (x0, y0, x1, y1), metres."""
    state = empty_map(planar_pose(0.01, 0.01, 0.0), size=120)
    state = replace(state, pose=planar_pose(*at, heading))
    state.explored[:] = True
    for x0, y0, x1, y1 in walls:
        cols = slice(round((x0 + 3) / 0.05), max(round((x0 + 3) / 0.05) + 1, round((x1 + 3) / 0.05)))
        rows = slice(round((y0 + 3) / 0.05), max(round((y0 + 3) / 0.05) + 1, round((y1 + 3) / 0.05)))
        state.occupied[rows, cols] = True
    return state


def test_turns_to_the_waypoint_then_moves_forward():
    local = LocalPolicy()
    assert local.act(_map(), np.array([2.0, 0.0])) == Action.FORWARD
    assert local.act(_map(), np.array([0.0, 2.0])) == Action.TURN_LEFT
    assert LocalPolicy().act(_map(), np.array([0.0, -2.0])) == Action.TURN_RIGHT
    assert LocalPolicy().act(_map(heading=np.pi / 2), np.array([0.0, 2.0])) == Action.FORWARD


def _simulate(local, state, waypoint, steps, truth=None):
    """Simulate the robot with obstacles ``truth`` (default: the map); return its positions."""
    x, y, heading = planar_from_pose(state.pose)
    track = [(x, y)]
    for _ in range(steps):
        state = replace(state, pose=planar_pose(x, y, heading))
        action = local.act(state, np.asarray(waypoint))
        if np.hypot(x - waypoint[0], y - waypoint[1]) < 0.3:
            break
        if action == Action.FORWARD:
            to = (x + 0.25 * np.cos(heading), y + 0.25 * np.sin(heading))
            points = np.linspace((x, y), to, 6)[1:]
            cells = world_to_cell(points, state.origin, state.cell)
            if not (state.occupied if truth is None else truth)[tuple(cells.T)].any():
                x, y = to
        else:
            heading += np.radians(30) * (1 if action == Action.TURN_LEFT else -1)
        track.append((x, y))
    return np.array(track)


def test_passes_a_wall_with_clearance():
    state = _map([(1.0, -2.0, 1.1, 2.0)])
    track = _simulate(LocalPolicy(), state, (2.0, 0.0), 60)
    assert np.hypot(*(track[-1] - (2.0, 0.0))) < 0.3
    across = track[(np.abs(track[:, 0] - 1.05) < 0.15)]
    assert (np.abs(across[:, 1]) > 2.0 + 0.1).all()


def test_an_obstacle_missing_in_the_map_is_detected_by_collisions():
    truth = np.zeros((120, 120), bool)
    truth[50:70, 80:84] = True  # at x in [1, 1.2], y in [-0.5, 0.5]
    state = _map()
    local = LocalPolicy()
    track = _simulate(local, state, (2.0, 0.0), 120, truth)
    assert np.hypot(*(track[-1] - (2.0, 0.0))) < 0.3


def test_an_unreachable_waypoint_leads_to_the_nearest_reachable_position():
    inside = [(1, 1, 2, 1.1), (1, 2, 2.1, 2.1), (1, 1, 1.1, 2), (2, 1, 2.1, 2.1)]
    local = LocalPolicy()
    track = _simulate(local, _map(inside), (1.5, 1.5), 60)
    assert local.blocked and local.arrived
    assert np.hypot(*(track[-1] - (1.5, 1.5))) < 1.2
    wall = LocalPolicy()
    track = _simulate(wall, _map([(2, -3, 2.2, 3)]), (2.1, 0.0), 40)
    assert 1.4 < track[-1, 0] < 2.0


def test_a_waypoint_outside_the_map_is_clipped():
    assert LocalPolicy().act(_map(), np.array([500.0, 0.0])) == Action.FORWARD


def test_a_doorway_mapped_too_narrow_is_passed():
    """A doorway of 70 cm, mapped 10 cm too narrow on either side, as happens with oblique depth rays."""
    state = _map([(1.0, -3.0, 1.1, -0.25), (1.0, 0.25, 1.1, 3.0)])
    track = _simulate(LocalPolicy(), state, (2.0, 0.0), 40)
    assert np.hypot(*(track[-1] - (2.0, 0.0))) < 0.3


def test_a_new_obstacle_changes_the_path():
    local = LocalPolicy()
    assert local.act(_map(), np.array([2.5, 0.0])) == Action.FORWARD
    assert (np.abs(local.path[:, 0] - 60) <= 1).all()  # straight along the row
    local.act(_map([(1.0, -1.0, 1.1, 1.0)]), np.array([2.5, 0.0]))
    assert (np.abs(local.path[:, 0] - 60) > 20).any()


class Counting(LocalPolicy):
    """Local policy that counts its plans."""

    plans = 0

    def _make_plan(self, *arguments):
        self.plans += 1
        return super()._make_plan(*arguments)


def test_a_plan_is_made_again_after_25_steps():
    """The robot of this map never moves: it turns towards a waypoint at its left again and again."""
    local, made = Counting(), []
    for _ in range(52):
        assert local.act(_map(), np.array([0.0, 2.0])) == Action.TURN_LEFT
        made.append(local.plans)
    assert made == [1] * 25 + [2] * 25 + [3] * 2


def test_obstacles_at_the_start_of_a_path_do_not_make_a_plan_stale():
    state = _map([(-0.1, 1.0, -0.05, 1.05)], at=(0.01, 1.01))  # 2 cells to the right of a robot that looks to +x
    local = Counting()
    for _ in range(10):
        assert local.act(state, np.array([0.0, 2.5])) == Action.TURN_LEFT
    assert local.plans == 1


def test_there_is_no_path_without_a_plan():
    assert LocalPolicy().path.shape == (0, 2)


@pytest.mark.parametrize(
    ("x", "blocked"), [(2.808, []), (2.77, [[59, 119], [60, 119], [61, 119]])], ids=["outside", "half outside"]
)
def test_a_collision_at_the_edge_of_the_map_blocks_the_cells_inside(x, blocked):
    """The robot does not move. The blocked strip has two columns, here 120 and 121 or 119 and 120; the map has 120."""
    local, state = LocalPolicy(), _map(at=(x, 0.03))
    assert local.act(state, np.array([3.5, 0.03])) == Action.FORWARD
    local.act(state, np.array([3.5, 0.03]))
    assert np.argwhere(local._bumped).tolist() == blocked


def test_obstacles_are_avoided_by_18_cm_except_around_the_robot(monkeypatch):
    """An obstacle 4 cells ahead blocks the robot's own cell, which is freed together with its eight neighbours."""
    plans = []

    def update(self, free, goal, stop_at, corner=(0, 0)):
        plans.append((free.copy(), corner))
        return travel_distance(free, goal, self._cell, stop_at)

    monkeypatch.setattr(UpdatedDistance, "update", update)
    state = _map(at=(0.03, 1.03))  # cell 80, 60
    state.occupied[80, 64] = True
    LocalPolicy().act(state, np.array([-2.0, 1.0]))
    (free, (top, left)), rows, cols = plans[0], *np.mgrid[:120, :120]
    want = (rows - 80) ** 2 + (cols - 64) ** 2 > 4.5**2
    want[79:82, 59:62] = True
    np.testing.assert_array_equal(free, want[top : top + len(free), left : left + free.shape[1]])


@pytest.mark.parametrize("goal", [(0, 0), (2, 11), (6, 3), (8, 12), (4, 6)])
def test_goal_cells_are_the_free_cells_of_a_disc(goal):
    free = np.random.default_rng(0).random((9, 13)) < 0.8
    rows, cols = np.mgrid[:9, :13]
    disc = (rows - goal[0]) ** 2 + (cols - goal[1]) ** 2 <= 9
    np.testing.assert_array_equal(_goal_cells(free, goal, 3), free & disc)


def test_a_path_is_near_an_obstacle_as_a_naive_search_finds():
    rng, found = np.random.default_rng(0), []
    for _ in range(400):
        occupied = rng.random((12, 12)) < 0.02
        path = rng.integers(0, 12, (int(rng.integers(1, 5)), 2))
        reach, (row, col) = int(rng.integers(1, 4)), rng.integers(0, 12, 2).tolist()
        cells = [a + (b - a) * s // max(abs(b - a)) for a, b in pairwise(path) for s in range(max(abs(b - a)))]
        obstacles = np.argwhere(occupied)
        want = any(
            ((obstacles - cell) ** 2).sum(axis=1).min(initial=999) <= reach**2
            for cell in cells
            if abs(cell - (row, col)).sum() > reach + 1
        )
        found.append(want)
        assert _near_obstacle(occupied, path, reach, row, col) == want
    assert 40 < sum(found) < 360
