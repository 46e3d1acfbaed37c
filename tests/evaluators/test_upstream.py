"""Definitions of the released code: computed by hand on 5 x 5 maps, and compared with the standard ones."""

import numpy as np
import pytest
import toy_scene

from autonerf_lab.errors import UnknownNameError
from autonerf_lab.evaluators import TrueField, upstream_scores
from autonerf_lab.evaluators.ground_truth import MapGrid, TrueMap, true_map
from autonerf_lab.evaluators.planning import EpisodeSet
from autonerf_lab.evaluators.upstream import maps, planning, pose_refinement
from autonerf_lab.geometry import Intrinsics, planar_pose, so3_exp
from autonerf_lab.simulator import Simulator


@pytest.fixture(scope="module")
def sim():
    return Simulator(toy_scene.two_rooms(), Intrinsics.from_fov(48, 48), supersample=1)


@pytest.fixture(scope="module")
def truth(sim):
    return true_map(sim)


def mask(*rows: str) -> np.ndarray:
    return np.array([[letter == "#" for letter in row] for row in rows])


def test_camera_unit_is_the_farthest_coordinate_from_the_mean():
    cameras = np.stack([planar_pose(x, y, 0.0) for x, y in ((1.0, 0.0), (3.0, 1.0), (8.0, -1.0))])
    assert maps.camera_unit(cameras) == 4.0, "x = 8, and 4 is the mean"
    assert maps.camera_unit(cameras[:1]) == 1.0, "one camera says nothing"


def test_small_pieces_by_hand():
    cells = mask("##..#", "#....", "..#..", "....#", "...##")
    assert (maps.large_components(cells, 3) == mask("##...", "#....", ".....", "....#", "...##")).all(), (
        "not by corners"
    )
    assert (maps.large_components(cells, 4) == 0).all()


def test_closing_by_hand():
    ring = mask("#####", "#...#", "#.#.#", "#...#", "#####")
    assert maps.close_gaps(ring, min_hole=9, radius=0).all(), "8 cells around the middle are a small hole"
    ring[2, 2] = False
    assert (
        maps.close_gaps(ring | mask(".....", ".....", "..#..", ".....", "....."), min_hole=8, radius=0) == ring
    ).all()
    gap = mask(".....", ".....", "##.##", ".....", ".....")
    assert (maps.close_gaps(gap, min_hole=5, radius=1.5) == mask(".....", ".....", "#####", ".....", ".....")).all()


def test_map_scores_by_hand():
    blocks = np.ones((100, 100), bool)  # a cell by hand is a square metre: holes and gaps are small beside it
    free = np.kron(mask(".....", ".###.", ".###.", ".###.", "....."), blocks)
    occupied = np.kron(mask("#####", "#..##", "#...#", "#...#", "##.##"), blocks)
    semantics = np.zeros((15, *free.shape), bool)
    semantics[3, :100, :200] = True
    truth = TrueMap(MapGrid(np.zeros(2), free.shape), ~free, ~free, free, semantics)
    class_cells = np.zeros_like(semantics)
    class_cells[3, :100, :100] = class_cells[3, 200:300, 200:300] = True  # points in free cells do not count
    class_cells[3, 40:60, 40:60] = False  # a small hole
    values = maps.map_scores(occupied, class_cells, truth)
    # 9 predicted free, 8 of the 9 that are; 16 others, 15 of them right
    assert values["free_accuracy"] == pytest.approx(100 * 23 / 25)
    assert values["free_precision"] == values["free_recall"] == pytest.approx(100 * 8 / 9)
    assert values["semantic_accuracy"] == pytest.approx(100 * (14 + 24 / 25) / 15)
    assert values["semantic_precision"] == pytest.approx(100 / 15), "absent classes score 0"
    assert values["semantic_recall"] == pytest.approx(50 / 15)


def test_hits_are_counted_for_each_waypoint():
    passable = ~mask(".....", "...#.", ".....", ".....", ".....")
    path = np.array([[2, 1], [2, 2], [1, 2]])
    assert planning.obstacle_hits(path, passable) == 2, "the same cell beside two waypoints"
    assert planning.obstacle_hits(np.array([[0, 0]]), passable) == 5, "five of nine are outside of the map"


def corridor(width: int = 400) -> tuple[np.ndarray, EpisodeSet]:
    """A wall of 30 cells across a strip; one start and one goal on either side of it."""
    free = np.ones((101, width), bool)
    free[:, 185:215] = False
    starts, goals = np.array([[50, 40]]), np.array([[50, 360]])
    return free, EpisodeSet(free, starts, goals, np.array([3.2]), (), np.zeros((16, 1)))


def test_a_wall_beside_the_start_is_cleared_and_then_crossed():
    free, episode_set = corridor()
    (far,) = planning.plan_points(free, episode_set, 0.01)
    assert far.reason == "no path" and far.spl == 0
    near = EpisodeSet(free, np.array([[50, 180]]), episode_set.goals, np.array([1.8]), (), np.zeros((16, 1)))
    (through,) = planning.plan_points(free, near, 0.01)
    assert through.reason == "through an obstacle", "every waypoint in the wall counts nine times"
    thin = EpisodeSet(np.ones_like(free), near.starts, near.goals, near.shortest, (), np.zeros((16, 1)))
    (free_there,) = planning.plan_points(free, thin, 0.01)
    assert free_there.success and free_there.spl == pytest.approx(1, abs=0.01)


def test_small_objects_are_dropped_and_large_ones_found():
    free, episode_set = corridor()
    free = np.ones_like(free)
    semantics = np.zeros((15, *free.shape), bool)
    semantics[0, 40:60, 300:315] = semantics[1, 40:60, 300:314] = True  # 300 cells, and 280
    truth = TrueMap(MapGrid(np.zeros(2), free.shape), ~free, ~free, free, semantics)
    episode_set = EpisodeSet(
        free, episode_set.starts, episode_set.goals, episode_set.shortest, (1, 2), np.full((16, 1), 2.35)
    )
    large, small = planning.plan_objects(free, semantics, truth, episode_set)
    assert large.success and large.length == pytest.approx((300 - 25 - 40) * 0.01, abs=0.06)
    assert small.reason == "class not predicted"


def test_leaving_a_cleared_square_equals_planning_on_the_cleared_map(truth):
    from autonerf_lab.evaluators.planning import dilate_obstacles
    from autonerf_lab.planning import path_length
    from autonerf_lab.planning.fast_marching import descend, travel_distance

    cell, free = truth.grid.cell, dilate_obstacles(truth.free, 0.2, truth.grid.cell)
    goal = np.argwhere(free)[[1000]]
    distance = travel_distance(free, goal, cell)
    for start in np.argwhere(truth.free)[:: truth.free.sum() // 7]:
        clear = free.copy()
        clear[planning._square(start, free.shape)] = True
        path = descend(travel_distance(clear, goal, cell), start, cell)
        found = planning._out_of_square(distance, start, cell)
        assert path_length(found, cell) == pytest.approx(path_length(path, cell), rel=0.02, abs=0.02)


def test_starts_are_farther_away_the_farther_from_the_origin():
    near, far = planar_pose(0.0, 0.0, 0.3), planar_pose(8.0, 6.0, 0.3)
    rotation, translation = pose_refinement.pose_errors(
        pose_refinement.perturb(np.stack([near, far])), np.stack([near, far])
    )
    assert translation[0] < 0.2 and translation[1] > 0.7
    np.testing.assert_allclose(rotation, 15, atol=1.5)  # three times 5 degrees, nearly


def test_euler_errors_are_summed_around_the_circle():
    quarter = np.array([0, 0, np.pi / 2])
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[0, :3, :3] = so3_exp(np.radians([1, 0, 0]))
    poses[1, :3, :3] = so3_exp(2 * quarter - np.radians([0, 0, 1]))
    truth = np.tile(np.eye(4), (2, 1, 1))
    truth[1, :3, :3] = so3_exp(-2 * quarter + np.radians([0, 0, 1]))
    poses[0, 0, 3] = 0.01
    rotation, translation = pose_refinement.pose_errors(poses, truth)
    np.testing.assert_allclose(rotation, [1, 2], atol=1e-9)
    np.testing.assert_allclose(translation, [0.01, 0], atol=1e-12)


def test_a_screw_is_a_rigid_motion():
    import torch

    w = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64)
    motion = pose_refinement._screw(w, torch.tensor([[0.0, 0, 2]], dtype=torch.float64), torch.tensor([0.3]))[0].numpy()
    np.testing.assert_allclose(motion[:3, :3], so3_exp(np.array([0, 0, 0.3])), atol=1e-7)
    np.testing.assert_allclose(motion[:3, 3], [0, 0, 0.6], atol=1e-7)


class Slope:
    """A field whose colour depends on the ray origin only: the position can be refined, the rotation cannot."""

    def ray_gradients(self, rays_o, rays_d, target):
        error = 0.1 * rays_o + 0.5 - target
        return (error**2).mean(axis=1), 2 / 3 * 0.1 * error, np.zeros_like(rays_d)


def test_the_descent_finds_a_position():
    truth = np.stack([planar_pose(0.5, -0.5, 0.0), planar_pose(0.2, 0.3, 1.0)])
    colors = np.round(255 * (0.1 * truth[:, :3, 3] + 0.5)).astype(np.uint8)
    targets = np.broadcast_to(colors[:, None, None], (2, 4, 4, 3))
    starts = pose_refinement.perturb(truth)
    found = pose_refinement.refine(Slope(), starts, targets, Intrinsics.from_fov(4, 4), 400, 8)
    before, after = (pose_refinement.pose_errors(poses, truth)[1] for poses in (starts, found))
    assert (after < 0.25 * before).all() and (before > 0.05).all()


def test_scores_of_the_true_geometry(sim, truth):
    scores = upstream_scores(TrueField(sim.scene, sim, views=100), sim.scene, "smoke", tasks=["maps", "planning"])
    assert [row.metric for row in scores if row.status != "ok"] == []
    assert scores["maps", "free_recall"] > 99.9, "what is free is free"
    outside = (~truth.scored).mean()
    assert 100 - scores["maps", "free_accuracy"] == pytest.approx(100 * outside, abs=1), "what is ignored counts here"
    assert scores["maps", "semantic_recall"] <= 100 * len(truth.classes) / 15
    assert scores["planning", "pointgoal_success"] == 100
    assert scores["planning", "objectgoal_success"] < 100, "a vase has less than 300 cells"
    with pytest.raises(UnknownNameError, match="maps, mesh, planning, pose_refinement"):
        upstream_scores(TrueField(sim.scene, sim, views=1), sim.scene, "smoke", tasks=["rendering"])
