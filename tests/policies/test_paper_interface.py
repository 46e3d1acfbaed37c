"""The paper's policy at any size of the map: its interface, and a training and a rollout of its network."""

from dataclasses import replace

import numpy as np
import pytest

from autonerf_lab.exploration import explore
from autonerf_lab.geometry import Intrinsics, planar_pose, world_to_cell
from autonerf_lab.mapping import empty_map
from autonerf_lab.policies.interfaces import PaperInterface
from autonerf_lab.policies.networks import batched
from autonerf_lab.policies.spec import make_network
from autonerf_lab.policies.weights import read_meta
from autonerf_lab.scenes import load_scene
from autonerf_lab.simulator import Simulator
from autonerf_lab.training.settings import settings_of
from autonerf_lab.training.train import train_policy


@pytest.mark.parametrize("size", [720, 640, 201, 90])
def test_the_paper_interface_sees_the_same_in_finer_maps(size):
    """A window of 48 cells of 25 cm: the same on a map with such cells and on finer ones, apart from their border."""
    interface = PaperInterface(48)
    coarse, fine = empty_map(np.eye(4), 144, 0.25), empty_map(np.eye(4), size, 0.05)
    for map in (coarse, fine):
        for name in ("occupied", "explored"):
            row, col = world_to_cell(np.array([1.12, -0.87]), map.origin, map.cell)
            getattr(map, name)[row, col] = True
    known = interface.observe(fine)["map"]
    assert interface.observation_space["map"].contains(known)
    found, wanted = (np.argwhere(image[0]) for image in (known, interface.observe(coarse)["map"]))
    assert len(found) == len(wanted) == 1 and np.abs(found - wanted).max() <= 1
    for action in ([-1.0, 0.5], [0.0, 0.0], [0.3, 1.0]):
        point = interface.to_waypoint(np.array(action), fine)
        np.testing.assert_allclose(interface.to_action(point, fine), action, atol=1e-6)
        np.testing.assert_allclose(point, 6 * np.array(action), atol=0.3)  # metres from the robot, 12 m across


def test_the_network_of_the_paper_trains_and_explores_on_maps_of_any_size(tmp_path):
    network = {"kind": "paper", "window": 48}  # 25 cm: the cells of the training and five cells of a rollout
    few = {"demonstrations": 0, "environments": 2, "episode": 2, "rollout": 2, "batch": 4, "sensor": 16}
    settings = settings_of("modular-cov", frames=2 * 2 * 2 * 25, scenes=("train-00",), network=network, **few)
    weights = train_policy("modular-cov", tmp_path, settings, workers=1, progress=False)
    assert read_meta(weights)["frames"] == 2 * 2 * 2 * 25
    sim = Simulator(load_scene("train-00"), Intrinsics.from_fov(32, 32), rgb=False)
    for size in (640, 500, 333):
        trajectory = explore(sim, f"{weights}.safetensors", steps=50, progress=False, map_size=size)
        assert trajectory.meta["explored_m2"][-1] > trajectory.meta["explored_m2"][0]
        points = np.array(trajectory.meta["waypoints"][25:])
        assert np.abs(points - trajectory.poses[25, :2, 3]).max() < 12  # metres, the width of the window


def test_policies_with_the_network_of_the_paper_are_trained_like_the_modular_ones():
    for reward in ("cov", "obs", "sem", "view"):
        settings, modular = settings_of(f"paper-{reward}"), settings_of(f"modular-{reward}")
        assert replace(settings, network=modular.network) == modular
        interface, network = make_network(settings.network)
        assert interface.cell == 0.1 and interface.channels == 24 + 24 * (reward == "view")
        assert network(batched([interface.observe(empty_map(planar_pose(0, 0, 0)))]))[1].shape == (1,)
