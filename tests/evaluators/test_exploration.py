"""Scores of a trajectory: summed rewards, and a cached visible map."""

import numpy as np
import pytest

from autonerf_lab.errors import DataError
from autonerf_lab.evaluators import exploration
from autonerf_lab.evaluators.exploration import SUMMED, cached_visible_map, summed_rewards, trajectory_scores
from autonerf_lab.exploration import explore
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.mapping import empty_map, update
from autonerf_lab.presets import preset
from autonerf_lab.rewards import REWARDS
from autonerf_lab.scenes import load_scene
from autonerf_lab.simulator import Simulator
from autonerf_lab.types import Observation, Transition


@pytest.fixture(scope="module")
def sim():
    return Simulator(load_scene("dev-0"), Intrinsics.from_fov(24, 24), supersample=1, rgb=False)


@pytest.fixture(scope="module")
def trajectory(sim):
    return explore(sim, "random", steps=12, seed=3, progress=False)


def test_summed_rewards_equal_the_sum_over_steps(trajectory):
    known, sums = empty_map(trajectory.poses[0], exploration.MAP_SIZE), dict.fromkeys(SUMMED, 0.0)
    for t, pose in enumerate(trajectory.poses):
        observation = Observation(trajectory.rgb[t], trajectory.depth[t], trajectory.semantics[t], pose, step=t)
        after = update(known, observation, trajectory.intrinsics)
        if t:
            for name in SUMMED:
                sums[name] += REWARDS[name](Transition(known, after, observation, trajectory.meta["actions"][t]))
        known = after
    assert summed_rewards(trajectory) == pytest.approx(sums)
    assert sums["cov"] > 0


def test_the_visible_map_is_cached(sim, tmp_path, monkeypatch):
    first = cached_visible_map(sim, 5, tmp_path)
    monkeypatch.setattr(exploration, "visible_map", None)
    again = cached_visible_map(sim, 5, tmp_path)
    for name in ("occupied", "explored", "visited", "semantics", "viewpoints", "pose", "origin", "cell"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    assert again.explored.dtype == bool and first.explored.any()
    (path,) = tmp_path.iterdir()
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(DataError, match=path.name):
        cached_visible_map(sim, 5, tmp_path)


def test_scores_have_the_names_of_the_protocol(sim, trajectory, tmp_path):
    rows, curves = trajectory_scores(trajectory, sim.scene, preset("smoke"), tmp_path)
    values = {(row.task, row.metric): row.value for row in rows}
    shares = [f"{kind}coverage" for kind in ("", "obstacle_", "semantic_", "viewpoint_")]
    expected = [name + end for name in shares for end in ("", "_auc")]
    expected += ["explored_area_m2", "collisions", "path_length_m"]
    assert [metric for task, metric in values if task == "exploration"] == expected
    assert [metric for task, metric in values if task == "reward"] == list(SUMMED)
    assert values["exploration", "collisions"] == sum(trajectory.meta["collided"])
    for name in shares:
        assert curves[name][-1] == pytest.approx(values["exploration", name], abs=0.01)
