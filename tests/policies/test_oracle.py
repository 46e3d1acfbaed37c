"""The oracles of exploration, which know what there is to find."""

import numpy as np
import pytest

from autonerf_lab.errors import PolicyError
from autonerf_lab.exploration import explore
from autonerf_lab.geometry import Intrinsics, planar_pose
from autonerf_lab.mapping import empty_map
from autonerf_lab.policies.oracle import Oracle, visible_gain
from autonerf_lab.scenes import load_scene
from autonerf_lab.simulator import Simulator


def test_a_ray_ends_at_the_first_wall_and_a_cell_counts_once():
    walls = np.zeros((7, 7), bool)
    walls[:, 4] = True
    worth = np.ones((1, 7, 7), np.float32)
    inside, wall, beyond = visible_gain(walls, worth, np.array([[3, 1], [3, 4], [3, 6]]), 0.5, 20.0)
    assert (inside, wall, beyond) == (7 * 5 - 1, 0, 7 * 3 - 1)  # all but the cell one stands in, the wall included


def test_what_is_seen_from_one_side_counts_from_there():
    worth = np.zeros((4, 5, 5), np.float32)
    worth[0, 2, 0] = 1  # to be seen from between east and north
    north_east, south_east = visible_gain(np.zeros((5, 5), bool), worth, np.array([[4, 2], [0, 2]]), 0.5, 5.0)
    assert (north_east, south_east) == (1, 0)


def test_the_truth_lies_where_it_is_on_a_coarser_map_too():
    pose = planar_pose(0, 0, 0)
    there, map = empty_map(pose, 8, 0.05), empty_map(pose, 6, 0.1)  # the robot's reaches 10 cm further on each side
    there.occupied[5, 2] = there.occupied[0, 7] = True
    map.occupied[1, 4] = True  # which is that of the first row
    oracle = Oracle("obs")
    oracle.set_visible_map(there)
    walls, missing = oracle._truth(map)
    assert np.argwhere(missing[0]).tolist() == [[3, 2]]
    inside = np.zeros((6, 6), bool)
    inside[1:5, 1:5] = True
    assert np.argwhere(walls & inside).tolist() == [[1, 4], [3, 2]] and walls[~inside].all()


@pytest.mark.parametrize("reward", ["cov", "obs", "sem", "view"])
def test_it_walks_and_finds(reward):
    sim = Simulator(load_scene("dev-0"), Intrinsics.from_fov(32, 32), rgb=False)
    walk = explore(sim, f"oracle-{reward}", 60, progress=False)
    assert walk.meta["path_m"][-1] > 2 and walk.meta["explored_m2"][-1] > walk.meta["explored_m2"][10] > 0


def test_it_refuses_to_act_without_the_map_of_the_scene():
    oracle, map = Oracle("obs"), empty_map(planar_pose(0, 0, 0))
    map.explored[:] = True
    with pytest.raises(PolicyError, match="set_visible_map"):
        oracle.choose(map)
