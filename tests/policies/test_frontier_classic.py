"""The paper's frontier baseline: a random target on one of the three longest contours, chosen again by four rules."""

from dataclasses import replace

import numpy as np
import pytest
from toy_scene import two_rooms

from autonerf_lab.exploration import explore
from autonerf_lab.geometry import Intrinsics, planar_pose, world_to_cell
from autonerf_lab.mapping import empty_map
from autonerf_lab.policies import FrontierClassic
from autonerf_lab.simulator import Simulator

LOW, HIGH = 60, 140  # explored square of 4 x 4 m around the robot, which stands at cell 100, 100


def state():
    """A square room, closed but for one opening in each wall: 40 cells east, 30 north, 20 west, 9 south."""
    made = empty_map(planar_pose(0.01, 0.01, 0.0), size=200)
    made.explored[LOW:HIGH, LOW:HIGH] = True
    border = made.explored.copy()
    border[LOW + 1 : HIGH - 1, LOW + 1 : HIGH - 1] = False
    made.occupied[border] = True
    made.occupied[80:120, HIGH - 1] = False
    made.occupied[HIGH - 1, 85:115] = False
    made.occupied[90:110, LOW] = False
    made.occupied[LOW, 96:105] = False
    return made


def test_targets_lie_on_the_three_longest_contours():
    sides = []
    for seed in range(60):
        policy = FrontierClassic()
        policy.reset(np.random.default_rng(seed))
        map = state()
        policy.act(map, None)
        row, col = world_to_cell(policy.waypoint, map.origin, map.cell)
        # The standing place nearest to a frontier cell; explored ground ends at the frontier.
        sides += [name for name, there in (("east", col == HIGH - 1), ("north", row == HIGH - 1), ("west", col == LOW),
                                           ("south", row == LOW)) if there]  # fmt: skip
    assert len(sides) == 60 and {*sides} == {"east", "north", "west"}
    assert all(8 <= sides.count(side) <= 32 for side in {*sides})  # 20 each on average


@pytest.mark.parametrize("why", ["nothing", "reached", "occupied", "old", "blocked"])
def test_a_target_is_chosen_again_by_four_rules(why):
    policy = FrontierClassic()
    policy.reset(np.random.default_rng(0))
    map = state()
    policy.act(map, None)
    target = policy.waypoint
    if why == "reached":
        map = replace(map, pose=planar_pose(*(0.93 * target), 0.0))
    elif why == "occupied":
        map.occupied[tuple(world_to_cell(target, map.origin, map.cell))] = True
    elif why == "old":
        for _ in range(199):
            policy.act(map, None)
        assert np.array_equal(policy.waypoint, target)
    elif why == "blocked":  # obstacles enclose the robot: no path for two steps
        map.occupied[90:111, [90, 110]] = map.occupied[[90, 110], 90:111] = True
        policy.act(map, None)
        policy.act(map, None)
        assert np.array_equal(policy.waypoint, target)
    policy.act(map, None)
    assert np.array_equal(policy.waypoint, target) == (why == "nothing")


def test_it_explores_all_rooms_and_goes_on():
    sim = Simulator(two_rooms(), Intrinsics.from_fov(48, 48), rgb=False)
    trajectory = explore(sim, "frontier-classic", steps=400, seed=0, progress=False)
    assert trajectory.meta["explored_m2"][-1] > 23.0  # 8 x 3 m, minus the area hidden by furniture
    assert trajectory.meta["path_m"][-1] - trajectory.meta["path_m"][200] > 5
