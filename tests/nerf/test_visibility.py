"""Space seen by the training views: limits of the grid."""

import numpy as np
import pytest

from autonerf_lab.nerf import visibility
from autonerf_lab.nerf.visibility import LEAST_REACH, VOXEL, carve

ORIGINS, DIRECTIONS = np.zeros((4, 3), np.float32), np.float32([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0.6, 0.8]])


def test_rays_through_a_hole_to_the_sky_end_nearer_to_the_cameras(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(visibility, "MAX_VOXELS", 1 << 23)
    depth = np.float32([2, 3, 1000, 1000])
    grid = carve(ORIGINS, DIRECTIONS, depth)
    assert grid.seen.size <= 1 << 23 and grid.voxel == VOXEL and grid.origin.dtype == np.float64
    points = np.array([[2, 0, 0], [2.2, 0, 0], [0, 0, 2], [0, 0, LEAST_REACH - 0.5], [0, 0, 900]])
    assert grid(points).tolist() == [True, False, True, True, False]


def test_cameras_that_are_far_apart_have_larger_voxels(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(visibility, "MAX_VOXELS", 1 << 16)
    origins = ORIGINS + np.float32([[0, 0, 0], [500, 0, 0], [0, 500, 0], [0, 0, 500]])
    grid = carve(origins, DIRECTIONS, np.full(4, 2, np.float32))
    assert grid.seen.size <= 1 << 16 and grid.voxel > 10
    assert grid(origins).all() and not grid(np.array([[250.0, 250.0, 250.0]])).any()


def test_a_ray_that_leaves_the_grid_marks_nothing_outside() -> None:
    """Far from the origin, float32 rounds the march and the end of a ray differently: it may leave the grid."""
    around = np.zeros((9, 9, 9), np.bool_)
    centre = np.full((4, 3), 1.5, np.float32)
    visibility._march(centre, np.concatenate([DIRECTIONS[:2], -DIRECTIONS[:2]]), np.full(4, 4), around[3:6, 3:6, 3:6])
    assert np.argwhere(around).tolist() == [[3, 4, 4], [4, 3, 4], [4, 4, 4], [4, 5, 4], [5, 4, 4]]


def test_a_grid_within_the_limit_is_not_changed(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = carve(ORIGINS, DIRECTIONS, np.float32([2, 3, 12, 12]))
    monkeypatch.setattr(visibility, "MAX_VOXELS", whole.seen.size)
    again = carve(ORIGINS, DIRECTIONS, np.float32([2, 3, 12, 12]))
    np.testing.assert_array_equal(again.seen, whole.seen)
    monkeypatch.setattr(visibility, "MAX_VOXELS", whole.seen.size - 1)
    assert carve(ORIGINS, DIRECTIONS, np.float32([2, 3, 12, 12])).seen.size < whole.seen.size
