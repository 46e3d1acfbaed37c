"""Figures of pose sources: readable axes of small and large errors, and depth points where they are."""

import numpy as np
import pytest

from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.localization.se2 import to_matrices
from autonerf_lab.viz import figures

CAMERA = Intrinsics.from_fov(8, 8)


def trajectory(error: float) -> Trajectory:
    """Three steps along x before a wall at x = 3, measured with an error that grows along y, metres."""
    true = np.array([[0.0, 0, 0], [0.5, 0, 0], [1, 0, 0]])
    measured = true + np.arange(3)[:, None] / 2 * [0, error, 0]
    rgb, depth = np.zeros((3, 8, 8, 3), np.uint8), np.ones((3, 8, 8), np.float32) * [[[3.0]], [[2.5]], [[2.0]]]
    exact = Trajectory(to_matrices(true), rgb, depth.astype(np.float32), None, CAMERA, {})
    return exact.with_poses("odometry", to_matrices(measured))


@pytest.mark.parametrize(("error", "scale"), [(0.02, "linear"), (2.0, "symlog")])
def test_error_axes_are_labelled_with_plain_numbers(error, scale):
    figure = figures.pose_drift(trajectory(error))
    figure.canvas.draw()
    axis = figure.axes[1]
    assert axis.get_yscale() == scale
    top = axis.get_ylim()[1]
    assert 100 * error <= top < 1000 * error
    labels = [label for label in axis.get_yticklabels() if 0 <= label.get_position()[1] <= top]
    assert len(labels) >= 3 and all(0 <= float(label.get_text()) <= top for label in labels)


def test_depth_points_lie_on_the_wall_at_the_poses_of_each_source():
    moved = trajectory(1.0)
    figure = figures.pose_maps(moved)
    (ax,) = figure.axes
    assert ax.get_title() == "odometry"
    points, path, true = (np.array(line.get_data()).T for line in ax.get_lines())
    np.testing.assert_allclose(points[:, 0], 3.0, atol=1e-6)
    assert points[:, 1].max() == pytest.approx(2 * 7 / 8 + 1.0)  # pixels span 7/8 of the field of view on either side
    np.testing.assert_allclose(path[:, 1], [0, 0.5, 1])
    np.testing.assert_allclose(true[:, 1], 0)
