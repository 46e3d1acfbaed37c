"""Every built-in segmenter passes the checks that a plug-in must pass, and labels what a robot sees."""

import numpy as np
import pytest
from toy_scene import two_rooms

from autonerf_lab.exploration import explore
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.segmentation import SEGMENTERS, check_segmenter
from autonerf_lab.simulator import Simulator

WITHOUT_FILE = [name for name in SEGMENTERS if name != "mask-rcnn"]


@pytest.mark.parametrize("name", WITHOUT_FILE)
def test_every_built_in_segmenter_conforms(name: str) -> None:
    check_segmenter(SEGMENTERS[name])


@pytest.mark.parametrize("name", WITHOUT_FILE)
def test_the_robot_sees_the_labels_and_the_trajectory_keeps_them(name: str) -> None:
    sim = Simulator(two_rooms(), Intrinsics.from_fov(32, 32), supersample=1, semantics=name)
    first, again = (explore(sim, "frontier", 8, seed=2, progress=False) for _ in range(2))
    np.testing.assert_array_equal(first.semantics, again.semantics)
    if name == "true":  # the same folder as without the argument
        assert first.confidence is None and "semantics" not in first.meta
    else:
        assert first.meta["semantics"] == name
        assert first.confidence.shape == first.semantics.shape and first.confidence.max() > 100
        np.testing.assert_array_equal(first.confidence, again.confidence)
