from dataclasses import replace

import numpy as np
import pytest
from toy_scene import two_rooms

from autonerf_lab.errors import UnknownNameError
from autonerf_lab.exploration import explore
from autonerf_lab.geometry import Intrinsics, planar_pose
from autonerf_lab.mapping import empty_map
from autonerf_lab.policies import Frontier, make_policy, weights_sha256
from autonerf_lab.policies.egocentric import EgocentricInterface, egocentric_shares
from autonerf_lab.policies.information_gain import RAYS, new_views, unknown_area
from autonerf_lab.policies.interfaces import pooled
from autonerf_lab.policies.waypoints import WaypointPolicy
from autonerf_lab.simulator import Simulator
from autonerf_lab.types import Action, Observation

CAMERA = Intrinsics.from_fov(48, 48)


@pytest.fixture(scope="module")
def sim():
    return Simulator(two_rooms(), CAMERA, rgb=False)


def test_unknown_names_list_the_valid_ones():
    with pytest.raises(UnknownNameError, match=r"valid names: .*frontier, .*modular-obs, .*random, random-waypoints"):
        make_policy("best")


def test_random_actions_are_equally_likely():
    policy = make_policy("random")
    policy.reset(np.random.default_rng(0))
    counts = np.bincount([policy.act(None, None) for _ in range(3000)], minlength=3)
    assert (np.abs(counts - 1000) < 100).all()


@pytest.mark.parametrize("seed", range(4))
def test_frontier_finds_the_other_room_and_does_not_stop(sim, seed):
    trajectory = explore(sim, "frontier", steps=250, seed=seed, progress=False)
    explored = np.array(trajectory.meta["explored_m2"])
    assert explored[-1] > 23.0  # 8 x 3 m, minus the area hidden by furniture
    assert (np.diff(explored) >= 0).all()
    first = int(np.argmax(explored > 0.95 * explored[-1]))
    assert first < 100
    assert trajectory.meta["path_m"][-1] - trajectory.meta["path_m"][first] > 5  # continues to look from new positions
    assert sum(trajectory.meta["collided"]) < 15


def test_frontier_beats_random(sim):
    area = {
        name: np.mean([explore(sim, name, 120, seed, progress=False).meta["explored_m2"] for seed in range(3)])
        for name in ("frontier", "random")
    }
    assert area["frontier"] > 1.1 * area["random"]


def test_a_waypoint_policy_needs_only_its_choice(sim):
    """Waypoints a metre ahead are within reach before 25 actions; a waypoint in a wall ends after them."""

    class Ahead(WaypointPolicy):
        metres, chosen = 1.0, 0

        def choose(self, map):
            self.chosen += 1
            return map.pose[:2, 3] - self.metres * map.pose[:2, 2]

    near, far = Ahead(), Ahead()
    far.metres = 50.0
    for policy in (near, far):
        explore(sim, policy, steps=50, seed=0, progress=False)
    assert near.chosen > 5 and far.chosen == 2


def test_frontier_goes_where_more_is_unknown():
    """A corridor whose west end is a wall and whose east end is open."""
    state = empty_map(planar_pose(0.01, 0.01, 0.0), size=200)
    row, col = 100, 100
    state.explored[row - 12 : row + 13, col - 40 : col + 41] = True
    state.occupied[[row - 12, row + 12], col - 40 : col + 41] = True
    state.occupied[row - 12 : row + 13, col - 40] = True
    policy = Frontier()
    policy.reset(np.random.default_rng(0))
    actions = [policy.act(state, None) for _ in range(12)]
    assert actions == [Action.TURN_LEFT] * 11 + [Action.FORWARD]  # the initial turns, then east
    assert policy.waypoint[0] > 1.5


def test_unknown_area_of_an_open_half_plane():
    explored = np.zeros((101, 101), bool)
    explored[:, :51] = True
    occupied = np.zeros_like(explored)
    area = unknown_area(explored, occupied, 50, 50, 1.0, 20.0)
    assert area.shape == (RAYS,)
    assert area.sum() == pytest.approx(np.pi * 20**2 / 2, rel=0.08)  # half a disc
    assert area[RAYS // 2 - 10 : RAYS // 2 + 10].sum() == 0  # nothing to the west
    occupied[:, 55] = True
    strip = unknown_area(explored, occupied, 50, 50, 1.0, 20.0).sum()
    assert strip == pytest.approx(4 * 40, rel=0.15)  # columns 51 to 54, 20 cells each way


def test_new_views_are_those_of_unused_bins():
    explored, occupied = np.ones((61, 61), bool), np.zeros((61, 61), bool)
    viewpoints = np.zeros((12, 61, 61), bool)
    full = new_views(explored, occupied, viewpoints, 30, 30, 1.0, 15.0).sum()
    viewpoints[6:9] = True  # obs from 180 to 270 degrees: what lies at 0 to 90 degrees is known
    area = new_views(explored, occupied, viewpoints, 30, 30, 1.0, 15.0)
    assert area[: RAYS // 4].sum() == 0
    assert area.sum() == pytest.approx(0.75 * full)


@pytest.mark.parametrize("heading", [0.0, 1.1, 4.0])
def test_egocentric_shares_are_those_of_a_rotated_image(heading):
    rng = np.random.default_rng(0)
    channels = np.kron(rng.random((2, 6, 6)) < 0.5, np.ones((1, 10, 10), bool))
    x, y, grid, width, samples = 28.3, 33.9, 8, 24.0, 5
    shares = egocentric_shares(channels, x, y, heading, grid, width, samples)
    # each sample separately: up is ahead of the robot, left is its left
    offsets = ((np.arange(grid * samples) + 0.5) / (grid * samples) - 0.5) * width
    ahead, left = np.meshgrid(-offsets, -offsets, indexing="ij")
    cols = np.floor(x + np.cos(heading) * ahead - np.sin(heading) * left).astype(int)
    rows = np.floor(y + np.sin(heading) * ahead + np.cos(heading) * left).astype(int)
    values = channels[:, rows, cols].reshape(2, grid, samples, grid, samples).sum(axis=(2, 4))
    np.testing.assert_array_equal(shares, values * 255 // samples**2)


def test_a_finer_map_gives_the_observation_of_the_coarse_map_of_the_training():
    pose = planar_pose(0.4, -0.3, 0.7)
    coarse = empty_map(pose, 240, 0.1)
    rng = np.random.default_rng(0)
    explored = np.zeros((240, 240), bool)
    explored[90:150, 95:140] = rng.random((60, 45)) < 0.6
    occupied = explored & (rng.random((240, 240)) < 0.2)
    coarse = replace(coarse, explored=explored, occupied=occupied)
    finer = replace(
        empty_map(pose, 480, 0.05),
        origin=coarse.origin,
        explored=explored.repeat(2, 0).repeat(2, 1),
        occupied=occupied.repeat(2, 0).repeat(2, 1),
    )
    image = Observation(np.zeros((84, 84, 3), np.uint8), np.zeros((84, 84)), np.zeros((84, 84)), pose)
    obs = [EgocentricInterface().observe(map, image, None) for map in (coarse, finer)]
    assert obs[0]["near"].any() and obs[0]["far"].any()
    for name in ("near", "far"):
        np.testing.assert_array_equal(obs[0][name], obs[1][name])


@pytest.mark.parametrize("cell", [0.05, 0.1, 0.12, 0.2])
def test_the_maps_of_the_end_to_end_policies_are_around_the_robot_for_every_cell_size(cell):
    """Ground is explored up to 3 m from the robot, and the fine map shows 2 m."""
    pose = planar_pose(2.3, -1.7, 0.7)
    size = 2 * round(12 / cell)
    state = empty_map(planar_pose(0.0, 0.0, 0.0), size, cell)
    centres = (np.arange(size) + 0.5) * cell
    x, y = state.origin[0] + centres, state.origin[1] + centres
    explored = np.hypot(x[None] - 2.3, y[:, None] + 1.7) < 3
    image = Observation(np.zeros((84, 84, 3), np.uint8), np.zeros((84, 84)), np.zeros((84, 84)), pose)
    obs = EgocentricInterface().observe(replace(state, explored=explored, pose=pose), image, None)
    assert (obs["near"][1] == 255).all() and 0.08 < obs["far"][1].mean() / 255 < 0.14  # of 16 m x 16 m: 0.11


def test_pooling_is_the_maximum_of_blocks_and_false_outside_the_map():
    rng = np.random.default_rng(0)
    for _ in range(200):
        size, factor, side = rng.integers(1, (30, 4, 12))
        top, left = rng.integers(-40, 40, 2)
        channels = rng.random((2, size, size)) < 0.1
        around = np.zeros((2, 160, 160), bool)
        around[:, 60 : 60 + size, 60 : 60 + size] = channels
        window = around[:, 60 + top : 60 + top + side * factor, 60 + left : 60 + left + side * factor]
        want = window.reshape(2, side, factor, side, factor).any(axis=(2, 4))
        np.testing.assert_array_equal(pooled(channels, top, left, side, factor), want)


def test_the_hash_of_weights_depends_on_their_content(tmp_path):
    path = tmp_path / "policy.safetensors"
    assert weights_sha256(str(path)) is None and weights_sha256("frontier") is None
    path.write_bytes(b"abc")
    assert weights_sha256(str(path)) == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
