import json
import signal
import subprocess
import sys
import tempfile

import numpy as np
import pytest
from toy_scene import empty_room, two_rooms

from autonerf_lab.data.trajectory import load_trajectory
from autonerf_lab.errors import PolicyError, SceneError, UnknownNameError, WrongTypeError
from autonerf_lab.exploration import explore
from autonerf_lab.geometry import Intrinsics, planar_pose
from autonerf_lab.scenes import load_scene
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


class Faulty(Square):
    """Policy that fails at step 2, or in reset."""

    def __init__(self, fault, in_reset=False):
        self.fault, self.in_reset = fault, in_reset

    def reset(self, rng):
        super().reset(rng)
        if self.in_reset:
            raise self.fault

    def act(self, map, observation):
        if self.step == 2 and isinstance(self.fault, BaseException):
            raise self.fault
        return self.fault if self.step == 2 else super().act(map, observation)


@pytest.mark.parametrize(
    ("policy", "message"),
    [
        (Faulty(KeyError("map")), "policy 'Faulty' failed at step 2: KeyError: 'map'"),
        (Faulty(KeyError("map"), in_reset=True), "policy 'Faulty' failed in reset: KeyError: 'map'"),
        (Faulty(7), "policy 'Faulty' failed at step 2: ValueError: 7 is not a valid Action"),
        (Faulty(None), "policy 'Faulty' failed at step 2: ValueError: None is not a valid Action"),
    ],
)
def test_a_policy_that_fails_is_named(policy, message):
    with pytest.raises(PolicyError, match=message):
        explore(Simulator(two_rooms(), CAMERA), policy, steps=5, progress=False)


def test_ctrl_c_in_a_policy_that_hangs_names_it():
    code = (
        "import sys; from autonerf_lab import cli, policies\n"
        "class Hangs:\n"
        "    waypoint = None\n"
        "    def reset(self, rng): pass\n"
        "    def act(self, map, observation):\n"
        "        print('hangs', flush=True)\n"
        "        while True: pass\n"
        "policies.POLICIES['hangs'] = Hangs\n"
        "words = 'explore --scene dev-0 --policy hangs --preset smoke --out'.split()\n"
        "sys.exit(cli.main([*words, sys.argv[1]]))"
    )
    with tempfile.TemporaryDirectory() as folder:
        before = signal.signal(signal.SIGINT, signal.default_int_handler)  # background processes ignore SIGINT
        command = [sys.executable, "-c", code, folder + "/run"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
            signal.signal(signal.SIGINT, before)
            assert process.stdout is not None
            assert any("hangs" in line for line in process.stdout)
            process.send_signal(signal.SIGINT)
            _, error = process.communicate(timeout=60)
    assert process.returncode == 130
    assert error.strip().endswith(
        "interrupted (policy 'hangs' was interrupted at step 0): run the same command again to continue"
    )


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
    assert first.pose_source == "odometry"
    drift = np.linalg.norm((first.poses - first.other_poses["true"])[:, :2, 3], axis=1)
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
    with pytest.raises(WrongTypeError, match="it is a class; pass an instance"):
        explore(sim, Square, steps=3, progress=False)


def test_the_map_grows_with_the_scene():
    """On a map of 32 m, the robot explores a room of 40 m as well as on one that contains it."""
    sim = Simulator(empty_room(40.0, 2.0), CAMERA, rgb=False)
    small, large = (
        explore(sim, "frontier", steps=90, pose=planar_pose(2.0, 1.0, 0.0), progress=False, map_size=size)
        for size in (640, 960)
    )
    assert min(run.poses[:, 0, 3].max() for run in (small, large)) > 18
    assert small.meta["explored_m2"][-1] == pytest.approx(large.meta["explored_m2"][-1], rel=0.05)


@pytest.mark.parametrize("policy", ["frontier", "frontier-classic", "random-waypoints", "modular-obs", "e2e-cov"])
def test_every_kind_of_policy_goes_on_when_its_map_grows(policy):
    sim = Simulator(empty_room(20.0, 20.0), CAMERA, rgb=False)
    trajectory = explore(sim, policy, steps=60, pose=planar_pose(10, 10, 0.0), progress=False, map_size=200)
    assert len(trajectory) == 60 and trajectory.meta["path_m"][-1] > 2
    assert policy == "e2e-cov" or np.abs(trajectory.poses[:, :2, 3] - 10).max() + 5 > 6.5  # it has seen the border


def test_a_map_that_grows_keeps_the_estimated_poses():
    """With noise, the poses estimated on a map of 10 m, which grows, are those on one of 32 m."""
    sim = Simulator(load_scene("dev-0"), CAMERA, rgb=False, noise="ans", depth_noise="redwood")
    small, large = (
        explore(sim, "frontier", steps=130, poses="estimated", progress=False, map_size=size) for size in (200, 640)
    )
    assert np.linalg.norm(small.poses[:, :2, 3] - small.poses[0, :2, 3], axis=1).max() > 4.0  # the map ended at 5 m
    np.testing.assert_allclose(small.poses, large.poses, atol=1e-6)
    with pytest.raises(UnknownNameError, match="noise"):
        Simulator(two_rooms(), CAMERA, noise="anz")
