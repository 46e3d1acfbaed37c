import json

import numpy as np
import pytest
from toy_scene import two_rooms

from autonerf_lab.data.trajectory import load_trajectory
from autonerf_lab.errors import SceneError, UnknownNameError, WrongTypeError
from autonerf_lab.exploration import explore
from autonerf_lab.geometry import Intrinsics, planar_pose
from autonerf_lab.simulator import MotionNoise, Simulator
from autonerf_lab.types import Action

CAMERA = Intrinsics.from_fov(24, 24)


class Square:
    """Policy that moves along a square without using the map."""

    waypoint = None

    def reset(self, rng):
        self.step = 0

    def act(self, map, observation):
        self.step += 1
        return Action.TURN_LEFT if self.step % 5 in (3, 4, 0) else Action.FORWARD


def test_frames_are_the_observations_before_each_action():
    sim = Simulator(two_rooms(), CAMERA)
    trajectory = explore(sim, Square(), steps=12, pose=planar_pose(2, 1, 0.0), progress=False)
    sim.reset(pose=planar_pose(2, 1, 0.0))
    for t, action in enumerate(trajectory.meta["actions"]):
        observation = sim.observe()
        np.testing.assert_array_equal(trajectory.poses[t], observation.pose)
        np.testing.assert_array_equal(trajectory.rgb[t], observation.rgb)
        np.testing.assert_array_equal(trajectory.depth[t], observation.depth)
        np.testing.assert_array_equal(trajectory.semantics[t], observation.semantics)
        assert sim.move(action) == trajectory.meta["collided"][t]
    assert trajectory.meta["actions"][:6] == [0, 0, 1, 1, 1, 0]
    assert trajectory.meta["path_m"][:4] == [0.0, 0.25, 0.5, 0.5]
    assert trajectory.meta["policy"] == "Square"


def test_a_trajectory_is_saved_and_loaded(tmp_path):
    sim = Simulator(two_rooms(), CAMERA)
    trajectory = explore(sim, "frontier", steps=8, seed=2, progress=False)
    trajectory.save(tmp_path)
    loaded = load_trajectory(tmp_path)
    assert loaded.meta == trajectory.meta == json.loads(json.dumps(trajectory.meta))
    np.testing.assert_array_equal(loaded.poses, trajectory.poses)
    np.testing.assert_allclose(loaded.depth, trajectory.depth, atol=0.0006)
    assert loaded.meta["scene_sha256"] == sim.scene.sha256


def test_equal_seeds_give_equal_trajectories():
    sim = Simulator(two_rooms(), CAMERA, noise=MotionNoise())
    first, again, other = (explore(sim, "frontier", 30, seed, progress=False) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first.rgb, again.rgb)
    assert first.meta == again.meta
    assert not np.array_equal(first.poses, other.poses)
    drift = np.linalg.norm(first.poses[:, :2, 3] - np.array(first.meta["true_poses"])[:, :2], axis=1)
    assert drift[0] == 0 and drift[-1] > 1e-3


def test_the_hash_depends_on_the_scene():
    scene = two_rooms()
    vertices = scene.vertices.copy()
    vertices[0, 0] += 1e-3
    moved = type(scene)("toy", vertices, scene.faces, scene.face_class, scene.face_instance, scene.uv, scene.texture)
    assert scene.sha256 == two_rooms().sha256 != moved.sha256


def test_invalid_arguments_are_refused():
    sim = Simulator(two_rooms(), CAMERA)
    with pytest.raises(UnknownNameError, match="frontire"):
        explore(sim, "frontire", steps=3)
    with pytest.raises(ValueError, match="at least 1"):
        explore(sim, steps=0)
    with pytest.raises(SceneError, match="cannot stand"):
        explore(sim, steps=3, pose=planar_pose(0.7, 2.5, 0.0), progress=False)
    with pytest.raises(
        SceneError, match=r"its map ends at 1.0 m; use a larger map \(map_size=, --map-size; now 40 cells\)"
    ):
        explore(sim, Square(), steps=3, pose=planar_pose(2, 1, 0.0), progress=False, map_size=40)
    with pytest.raises(WrongTypeError, match="it is a class; pass an instance"):
        explore(sim, Square, steps=3, progress=False)
