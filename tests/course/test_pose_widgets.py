"""Slider over the iterations of a pose refinement, without a browser, in a field with known output."""

import numpy as np
import pytest

from autonerf_lab.course.widgets.pose import PoseRefinement
from autonerf_lab.evaluators.oracle import TrueField
from autonerf_lab.geometry import Intrinsics, planar_pose
from autonerf_lab.scenes import load_scene
from autonerf_lab.simulator import Simulator

TRUTH = planar_pose(1.5, 1.0, 0.0)


@pytest.fixture
def refining():
    """Return a refinement from 10 degrees and 8 cm: two steps that halve the error, and one to the true pose."""
    sim = Simulator(load_scene("dev-0"), Intrinsics.from_fov(24, 24))
    trace = np.stack([planar_pose(1.5 + 0.08 * share, 1.0, np.radians(10 * share)) for share in (1, 0.5, 0.25, 0)])
    return PoseRefinement(TrueField(sim.scene, sim, views=1), trace, TRUTH, sim.render(TRUTH).rgb, sim.intrinsics)


def test_the_figure_follows_the_slider(refining):
    images, errors = set(), []
    for k in range(4):
        refining.iteration.value = k
        images.add(refining.png)
        errors.append(refining.errors)
    assert len(images) == 4
    np.testing.assert_allclose(errors, [[10, 0.08], [5, 0.04], [2.5, 0.02], [0, 0]], atol=1e-6)


def test_the_panels(refining):
    target, rendering, difference, rotation, position = refining.figure().axes
    assert [ax.get_title() for ax in (rendering, rotation, position)] == [
        "rendering, iteration 0",
        "rotation: 10.00°",
        "position: 80 mm",
    ]
    np.testing.assert_allclose(rotation.lines[0].get_ydata(), [10, 5, 2.5, 1e-3], atol=1e-6)
    np.testing.assert_allclose(position.lines[0].get_ydata(), [80, 40, 20, 1e-3], atol=1e-6)
    assert np.asarray(difference.images[0].get_array()).mean() > 0.01
    refining.iteration.value = 3
    target, rendering, difference, *_ = refining.figure().axes
    np.testing.assert_allclose(rendering.images[0].get_array(), target.images[0].get_array())
    assert not np.asarray(difference.images[0].get_array()).any()
    assert refining.static_image().data == refining.png
