"""Alignment and trajectory errors."""

import numpy as np
import pytest

from autonerf_lab.localization.se2 import compose, to_matrices, to_planar
from autonerf_lab.localization.trajectory_alignment import align, motion_matrix, trajectory_errors, transformed


def spiral(count: int = 60) -> np.ndarray:
    t = np.linspace(0, 6, count)
    return np.column_stack([t * np.cos(t), t * np.sin(t), t])


@pytest.mark.parametrize("motion", [(1.0, -2.0, 0.3), (0.0, 0.0, -3.0), (5.0, 5.0, 2.0)])
def test_a_rigid_motion_is_no_error_after_alignment(motion):
    true = spiral()
    errors = trajectory_errors(compose(np.array(motion), true), true)
    assert errors.ate_m < 1e-9 and errors.heading_error_deg < 1e-6
    assert errors.error_per_metre < 1e-9 and errors.error_per_degree < 1e-9
    assert errors.ate_unaligned_m > 0.5


def test_alignment_is_the_best_of_all_motions():
    rng, true = np.random.default_rng(0), spiral()
    estimated = true + rng.normal(0, 0.2, true.shape)
    best = align(estimated, true)

    def cost(motion):
        return np.square(compose(motion, estimated)[:, :2] - true[:, :2]).sum()

    assert all(cost(best) <= cost(best + change) for change in rng.normal(0, 0.02, (50, 3)))


def test_a_robot_that_only_turned_is_aligned_by_its_headings():
    true = np.column_stack([np.ones(4), np.ones(4), np.arange(4.0)])
    other = true + np.array([1, 2, 0.5])
    np.testing.assert_allclose(compose(align(other, true), other), true, atol=1e-12)


def test_relative_errors_by_hand():
    """Odometry that measures 3 % too long, and 2 degrees too much for each quarter turn."""
    headings = np.radians([0, 0, 0, 0, 0, 90, 180, 270])
    x = np.array([0, 0.5, 1, 1.5, 2, 2, 2, 2.0])
    true = np.column_stack([x, 0 * x, headings])
    errors = trajectory_errors(true * [1.03, 1, 92 / 90], true)
    assert errors.error_per_metre == pytest.approx(0.03)
    assert errors.error_per_degree == pytest.approx(2 / 90)


def test_matrices_move_like_planar_poses():
    motion, poses = np.array([1.0, -2.0, 0.7]), spiral(5)
    np.testing.assert_allclose(to_planar(transformed(to_matrices(poses), motion))[:, :2], compose(motion, poses)[:, :2])
    np.testing.assert_allclose(motion_matrix(motion)[:3, :3] @ motion_matrix(motion)[:3, :3].T, np.eye(3), atol=1e-12)
