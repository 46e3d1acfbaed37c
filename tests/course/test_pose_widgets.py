"""The scrubber of a pose refinement is driven without a browser, in a field that is known by heart."""

import numpy as np
import pytest

from autonerf_lab.course.widgets.pose import Refining
from autonerf_lab.evaluators.oracle import TrueField
from autonerf_lab.geometry import Intrinsics, planar_pose
from autonerf_lab.scenes import load_scene
from autonerf_lab.simulator import Simulator

TRUTH = planar_pose(1.5, 1.0, 0.0)


@pytest.fixture
def refining():
    """Two steps that halve what is left of 10 degrees and 8 cm, and a last one that arrives."""
    sim = Simulator(load_scene("dev-0"), Intrinsics.from_fov(24, 24))
    trace = np.stack([planar_pose(1.5 + 0.08 * share, 1.0, np.radians(10 * share)) for share in (1, 0.5, 0.25, 0)])
    return Refining(TrueField(sim.scene, sim, views=1), trace, TRUTH, sim.render(TRUTH).rgb, sim.intrinsics)


def test_the_picture_follows_the_slider(refining):
    pictures, errors = set(), []
    for k in range(4):
        refining.iteration.value = k
        pictures.add(refining.picture)
        errors.append(refining.errors)
    assert len(pictures) == 4
    np.testing.assert_allclose(errors, [[10, 0.08], [5, 0.04], [2.5, 0.02], [0, 0]], atol=1e-6)


def test_what_is_drawn(refining):
    saw, shown, difference, turned, off = refining.figure().axes
    assert [ax.get_title() for ax in (shown, turned, off)] == [
        "the field, iteration 0",
        "rotation: 10.00°",
        "position: 80 mm",
    ]
    np.testing.assert_allclose(turned.lines[0].get_ydata(), [10, 5, 2.5, 1e-3], atol=1e-6)
    np.testing.assert_allclose(off.lines[0].get_ydata(), [80, 40, 20, 1e-3], atol=1e-6)
    assert np.asarray(difference.images[0].get_array()).mean() > 0.01
    refining.iteration.value = 3
    saw, shown, difference, *_ = refining.figure().axes
    np.testing.assert_allclose(shown.images[0].get_array(), saw.images[0].get_array())
    assert not np.asarray(difference.images[0].get_array()).any()
    assert refining.still().data == refining.picture
