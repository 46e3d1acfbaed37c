import json

import numpy as np
import pytest
from toy_scene import two_rooms

from autonerf_lab.data.trajectory import load_trajectory
from autonerf_lab.errors import SceneError, UnknownNameError
from autonerf_lab.exploration import explore
from autonerf_lab.geometry import Intrinsics, planar_pose
from autonerf_lab.simulator import Noise, Simulator
from autonerf_lab.types import Action

CAMERA = Intrinsics.from_fov(24, 24)


class Square:
    """A policy that walks a square, and needs no map to do so."""

    waypoint = None

    def reset(self, rng):
        self.step = 0

    def act(self, map, observation):
        self.step += 1
        return Action.TURN_LEFT if self.step % 5 in (3, 4, 0) else Action.FORWARD


def test_frames_are_what_the_robot_saw_before_each_action():
    sim = Simulator(two_rooms(), CAMERA)
    walk = explore(sim, Square(), steps=12, pose=planar_pose(2, 1, 0.0), progress=False)
    sim.reset(pose=planar_pose(2, 1, 0.0))
    for t, action in enumerate(walk.meta["actions"]):
        seen = sim.observe()
        np.testing.assert_array_equal(walk.poses[t], seen.pose)
        np.testing.assert_array_equal(walk.rgb[t], seen.rgb)
        np.testing.assert_array_equal(walk.depth[t], seen.depth)
        np.testing.assert_array_equal(walk.semantics[t], seen.semantics)
        assert sim.move(action) == walk.meta["collided"][t]
    assert walk.meta["actions"][:6] == [0, 0, 1, 1, 1, 0]
    assert walk.meta["path_m"][:4] == [0.0, 0.25, 0.5, 0.5]
    assert walk.meta["policy"] == "Square"


def test_a_walk_survives_its_folder(tmp_path):
    sim = Simulator(two_rooms(), CAMERA)
    walk = explore(sim, "frontier", steps=8, seed=2, progress=False)
    walk.save(tmp_path)
    again = load_trajectory(tmp_path)
    assert again.meta == walk.meta == json.loads(json.dumps(walk.meta))
    np.testing.assert_array_equal(again.poses, walk.poses)
    np.testing.assert_allclose(again.depth, walk.depth, atol=0.0006)
    assert again.meta["scene_sha256"] == sim.scene.sha256


def test_the_same_seed_is_the_same_walk_and_another_is_not():
    sim = Simulator(two_rooms(), CAMERA, noise=Noise())
    first, again, other = (explore(sim, "frontier", 30, seed, progress=False) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first.rgb, again.rgb)
    assert first.meta == again.meta
    assert not np.array_equal(first.poses, other.poses)
    drift = np.linalg.norm(first.poses[:, :2, 3] - np.array(first.meta["true_poses"])[:, :2], axis=1)
    assert drift[0] == 0 and drift[-1] > 1e-3


def test_another_scene_has_another_fingerprint():
    scene = two_rooms()
    vertices = scene.vertices.copy()
    vertices[0, 0] += 1e-3
    moved = type(scene)("toy", vertices, scene.faces, scene.face_class, scene.face_instance, scene.uv, scene.texture)
    assert scene.sha256 == two_rooms().sha256 != moved.sha256


def test_bad_requests_are_refused():
    sim = Simulator(two_rooms(), CAMERA)
    with pytest.raises(UnknownNameError, match="frontire"):
        explore(sim, "frontire", steps=3)
    with pytest.raises(ValueError, match="at least 1"):
        explore(sim, steps=0)
    with pytest.raises(SceneError, match="cannot stand"):
        explore(sim, steps=3, pose=planar_pose(0.7, 2.5, 0.0), progress=False)
