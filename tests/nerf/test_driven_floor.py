"""Depth of the floor that the robot drove over: true where it is given, and used only where a robot drove."""

from dataclasses import replace

import numpy as np
import pytest

import autonerf_lab as lab
from autonerf_lab.data.dataset import Dataset
from autonerf_lab.geometry import AGENT_RADIUS, Intrinsics, planar_pose
from autonerf_lab.nerf.driven_floor import driven_floor_depth, drove_here


@pytest.fixture(scope="module")
def episode():
    sim = lab.Simulator(lab.load_scene("dev-4"), Intrinsics.from_fov(64, 64), supersample=1)
    return lab.explore(sim, "frontier", steps=250, progress=False)


def test_it_is_the_depth_that_the_simulator_measures(episode):
    depth = np.stack(driven_floor_depth(Dataset.from_trajectory(episode)))
    known = depth > 0
    assert known.mean() > 0.02
    assert np.percentile(np.abs(depth - episode.depth)[known], 99) < 0.02  # rugs are a centimetre thick
    assert depth.max() < 7


def test_robot_that_turned_on_the_spot_knows_only_the_floor_under_its_body():
    poses = np.stack([planar_pose(0, 0, angle) for angle in np.linspace(0, 6, 20)])
    steep = Intrinsics.from_fov(64, 64, 165)  # sees the floor from 12 cm ahead
    trajectory = lab.Trajectory(poses, np.zeros((20, 64, 64, 3), np.uint8), None, None, steep)
    depth = np.stack(driven_floor_depth(Dataset.from_trajectory(trajectory)))
    rays = steep.directions()
    ahead = depth * np.linalg.norm(rays[..., [0, 2]], axis=-1)
    assert 0.11 < ahead.max() < AGENT_RADIUS
    np.testing.assert_allclose((depth * -rays[..., 1])[depth > 0], poses[0, 2, 3], rtol=1e-6)


def test_only_the_episode_of_a_robot_on_a_plane_counts(episode):
    data = Dataset.from_trajectory(episode)
    assert drove_here(data)
    assert not drove_here(replace(data, metric=False))
    assert not drove_here(replace(data, meta={}))  # images of a person or of a benchmark, not of a robot
    down = np.eye(4)
    down[1:3, 1:3] = [[np.cos(0.1), np.sin(0.1)], [-np.sin(0.1), np.cos(0.1)]]
    assert not drove_here(replace(data, poses=data.poses @ down))  # a camera that is not level
    climbing = data.poses.copy()
    climbing[:, 2, 3] += np.linspace(0, 0.1, len(data))
    assert not drove_here(replace(data, poses=climbing))


def losses_of(episode, weight):
    settings = replace(lab.nerf.MODELS["semantic-nerfacto"].settings["smoke"], steps=2, floor_weight=weight)
    found = {}
    lab.fit(episode, settings=settings, progress=False, callback=lambda step, model: found.update(model.losses))
    return found


def test_fit_uses_it_unless_its_weight_is_zero(episode):
    assert losses_of(episode, 2.25)["depth"] > 0
    assert "depth" not in losses_of(episode, 0.0)
