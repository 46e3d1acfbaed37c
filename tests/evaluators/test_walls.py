"""An inner wall of the true geometry is displaced by 1, 2, 5 and 10 cm: the scores decrease."""

import runpy
from pathlib import Path

import numpy as np
import pytest
import toy_scene

from autonerf_lab.evaluators import evaluate
from autonerf_lab.presets import preset

SHIFTS = (0.0, 0.01, 0.02, 0.05, 0.10)
walls = runpy.run_path(str(Path(__file__).parents[2] / "benchmarks" / "walls.py"))


@pytest.fixture(scope="module")
def scene():
    return toy_scene.to_scene(toy_scene.two_rooms())


def test_the_wall_between_the_rooms_moves_and_nothing_else(scene):
    axis, low, high = walls["inner_wall"](scene)
    assert axis == 0 and (low, high) == pytest.approx((4.0, 4.1))
    there = walls["move_wall"](scene, (axis, low, high), 0.05)
    change = there.vertices - scene.vertices
    wall = np.abs(scene.vertices[:, 0] - 4.05) < 0.06
    np.testing.assert_allclose(change[wall], [[0.05, 0, 0]] * wall.sum(), atol=1e-6)
    assert 0 < wall.sum() < len(wall) and not change[~wall].any()
    assert there.texture is scene.texture


def test_scores_decrease_with_the_displacement(scene):
    wall, size = walls["inner_wall"](scene), preset("smoke")
    rows = []
    for metres in SHIFTS:
        field = walls["displaced"](scene, wall, metres, size)
        scores = evaluate(field, scene, size, tasks=["rendering", "maps", "mesh"], progress=False)
        assert not [row.status for row in scores if row.status.startswith("failed")]
        rows.append({(row.task, row.metric): row.value for row in scores})
    series = {key: [row[key] for row in rows] for key in rows[0]}
    for key in (("rendering", "psnr"), ("maps", "free_recall"), ("mesh", "completion_ratio")):
        assert series[key] == sorted(series[key], reverse=True) and series[key][-1] < series[key][0], key
    for key in (("mesh", "accuracy_m"), ("mesh", "completion_m")):
        assert series[key] == sorted(series[key]) and series[key][-1] > series[key][0], key
    recall = series["maps", "occupancy_recall"]
    assert recall[:3] == [100.0] * 3, "2 cm are within the tolerance of 5 cm"
    assert recall[-1] < recall[0], "10 cm are not"
