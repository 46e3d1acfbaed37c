import numpy as np
import pytest
from toy_scene import empty_room, two_rooms

from autonerf_lab.errors import SceneError
from autonerf_lab.geometry import Intrinsics, planar_pose, world_to_cell
from autonerf_lab.mapping import Mapper, empty_map, semantic_map, update
from autonerf_lab.mapping.semantic_map import (
    AGENT_RADIUS,
    FAR,
    GROWTH,
    NEAR,
    OBSTACLE_MIN,
    OBSTACLE_OVER_CAMERA,
    VIEWPOINT_BINS,
)
from autonerf_lab.scenes import load_scene
from autonerf_lab.simulator import Simulator
from autonerf_lab.types import Observation

CAMERA = Intrinsics.from_fov(64, 64)


def _observe(sim, *planar):
    return sim.reset(pose=planar_pose(*planar))


def _at(state, x, y):
    return tuple(world_to_cell(np.array([x, y]), state.origin, state.cell))


def _one_pixel(depth, row, label=0, size=65):
    """Observation of a camera at the origin, looking along +x, with depth in one pixel of the middle column."""
    depths, labels = np.zeros((size, size), np.float32), np.zeros((size, size), np.uint8)
    depths[row, size // 2], labels[row, size // 2] = depth, label
    return Observation(np.zeros((size, size, 3), np.uint8), depths, labels, planar_pose(0.01, 0.01, 0.0))


@pytest.mark.parametrize(
    ("depth", "up", "explored", "occupied"),
    [
        (2.02, 0.0, True, True),  # at the height of the camera
        (2.02, -0.3, True, True),  # 0.88 - 0.606 = 0.274 m
        (2.02, -0.33, True, False),  # 0.213 m: too low for an obstacle, but explored
        (2.02, 0.01, True, False),  # 0.900 m: more than 1 cm above the camera
        (0.4, 0.0, False, False),  # too near
        (5.2, 0.0, False, False),  # too far
        (0.0, 0.0, False, False),  # no measurement
    ],
)
def test_cells_of_one_depth_measurement(depth, up, explored, occupied):
    focal = 1000.0  # the middle row is the horizon; one row is 1/1000
    row = 400 - round(up * focal)
    camera = Intrinsics(1, 801, focal, focal, 0.5, 400.5)
    depths = np.zeros((801, 1), np.float32)
    depths[row, 0] = depth
    labels = np.full((801, 1), 3, np.uint8)
    seen = Observation(np.zeros((801, 1, 3), np.uint8), depths, labels, planar_pose(0.01, 0.01, 0.0))
    after = update(empty_map(seen.pose), seen, camera)
    cell = _at(after, 0.01 + depth, 0.01)
    assert after.explored[cell] == explored or depth < 0.2
    assert after.occupied.sum() == after.semantics.sum() == int(occupied)
    assert after.occupied[cell] == occupied and after.semantics[2][cell] == occupied


def test_a_pixel_is_projected_with_both_focal_lengths_and_the_principal_point():
    """Pixel (row 3, column 5) of a camera at (0.01, 0.01, 0.88), looking along +x, its right is -y.

    Right by 2 * (5.5 - 3) / 10 = 0.5 m and down by 2 * (3.5 - 2) / 20 = 0.15 m: an obstacle at (2.01, -0.49, 0.73).
    """
    depths, labels = np.zeros((6, 8), np.float32), np.zeros((6, 8), np.uint8)
    depths[3, 5], labels[3, 5] = 2.0, 15
    camera = Intrinsics(8, 6, 10.0, 20.0, 3.0, 2.0)
    seen = Observation(np.zeros((6, 8, 3), np.uint8), depths, labels, planar_pose(0.01, 0.01, 0.0))
    after = update(empty_map(seen.pose), seen, camera)
    assert np.argwhere(after.occupied).tolist() == [list(_at(after, 2.01, -0.49))]
    assert np.argwhere(after.semantics)[:, 0].tolist() == [14]


def _naive_update(start, seen, camera):
    """Update the channels of a map cell by cell, without the box that limits the work of the kernel."""
    found = {name: getattr(start, name).copy() for name in ("occupied", "explored", "visited", "semantics")}
    found["viewpoints"], size = start.viewpoints.copy(), len(start.explored)
    eye, ahead, right = seen.pose[:3, 3], -seen.pose[:2, 2], seen.pose[:2, 0]
    hit, reach = set(), np.zeros(camera.width)
    for v, u in np.ndindex(seen.depth.shape):
        d, up = float(seen.depth[v, u]), (camera.cy - v - 0.5) / camera.fl_y
        if d >= NEAR and up <= 0:
            reach[u] = max(reach[u], min(d, FAR))
        point = eye[:2] + d * ahead + d * (u + 0.5 - camera.cx) / camera.fl_x * right
        col, row = np.floor((point - start.origin) / start.cell).astype(int)
        if NEAR <= d <= FAR and min(row, col) >= 0 and max(row, col) < size:
            hit.add((row, col))
            if OBSTACLE_MIN <= eye[2] + d * up <= eye[2] + OBSTACLE_OVER_CAMERA:
                found["occupied"][row, col] = True
                if seen.semantics[v, u]:
                    found["semantics"][seen.semantics[v, u] - 1, row, col] = True
    for row, col in np.ndindex(size, size):
        offset = start.origin + (np.array([col, row]) + 0.5) * start.cell - eye[:2]
        if offset @ offset <= AGENT_RADIUS**2:
            found["visited"][row, col] = found["explored"][row, col] = True
        forward = offset @ ahead
        u = camera.fl_x * (offset @ right) / forward + camera.cx - 0.5
        between = 0 < forward <= FAR and 0 <= u < camera.width - 1 and forward <= reach[int(u) : int(u) + 2].min()
        if between or (row, col) in hit:
            found["explored"][row, col] = True
            angle = np.arctan2(-offset[1], -offset[0]) % (2 * np.pi)
            found["viewpoints"][int(angle / (2 * np.pi) * VIEWPOINT_BINS), row, col] = True
    return found


@pytest.mark.parametrize("heading", [0.3, 1.4, 2.6, 3.5, 4.7, 6.1])
def test_an_update_equals_a_naive_one(heading):
    """A camera that is not symmetric, any depths, and a map of 4 m whose border they cross."""
    rng = np.random.default_rng(int(10 * heading))
    camera = Intrinsics(20, 40, 12.0, 14.0, 7.0, 22.0)
    depth = rng.uniform(0.4, 6.0, (40, 20)).astype(np.float32) * (rng.random((40, 20)) < 0.9)
    labels = rng.integers(0, 16, (40, 20), dtype=np.uint8)
    pose = planar_pose(0.52, -0.33, heading)
    seen = Observation(np.zeros((40, 20, 3), np.uint8), depth, labels, pose)
    start = empty_map(planar_pose(0.3, -0.1, 0.0), size=80)
    found = update(start, seen, camera)
    for name, wanted in _naive_update(start, seen, camera).items():
        np.testing.assert_array_equal(getattr(found, name), wanted, err_msg=name)


@pytest.mark.parametrize("heading", [0.0, np.pi / 2, np.pi, -np.pi / 2])
def test_a_view_over_the_border_of_the_map_does_not_reach_its_other_side(heading):
    """A map of 1 m around the robot, which sees 1.5 m or more: the cells behind it stay unknown."""
    sim = Simulator(empty_room(), CAMERA, rgb=False)
    observation = _observe(sim, 2.0, 1.5, heading)
    after = update(empty_map(observation.pose, size=20), observation, CAMERA)
    ahead = np.round([np.cos(heading), np.sin(heading)]).astype(int)
    edges = {(1, 0): np.s_[:, 0], (-1, 0): np.s_[:, -1], (0, 1): np.s_[0], (0, -1): np.s_[-1]}
    behind, front = after.explored[edges[tuple(ahead)]], after.explored[edges[tuple(-ahead)]]
    assert front.any() and not behind.any()


def test_ground_is_explored_up_to_the_wall():
    camera = Intrinsics.from_fov(128, 128)
    sim = Simulator(empty_room(), camera, rgb=False)
    observation = _observe(sim, 1.02, 1.52, 0.0)
    after = update(empty_map(observation.pose), observation, camera)
    for x, y, seen in [(1.6, 1.5, True), (3.9, 1.5, True), (2.6, 2.9, True), (1.6, 2.3, False), (0.5, 1.5, False)]:
        assert after.explored[_at(after, x, y)] == seen, (x, y)
    columns = np.flatnonzero(after.explored.any(axis=0))
    assert columns.max() == _at(after, 4.0, 1.5)[1]  # the cells of the wall are the last ones
    wall = after.occupied[:, columns.max()]
    assert wall.sum() * after.cell == pytest.approx(3.0, abs=0.15)  # 3 m of wall without gaps
    # 90 degrees from about (1, 1.5) in a room of 4 x 3 m: a triangle up to the side walls, then a rectangle.
    area = 1.5 * 1.5 + (3.0 - 1.5) * 3.0
    assert after.explored.sum() * after.cell**2 == pytest.approx(area, rel=0.08)


def test_only_tall_furniture_hides_the_floor_behind_it():
    sim = Simulator(two_rooms(), CAMERA, rgb=False)
    observation = _observe(sim, 7.62, 2.03, -np.pi / 2)  # towards the refrigerator
    after = update(empty_map(observation.pose), observation, CAMERA)
    front = _at(after, 7.7, 0.5999)
    assert after.occupied[front] and after.semantics[9][front]
    assert not after.occupied[_at(after, 7.7, 0.3)]
    assert not after.explored[_at(after, 7.7, 0.45)]
    bed = _observe(sim, 0.75, 1.0, np.pi / 2)
    after = update(empty_map(bed.pose), bed, CAMERA)
    assert after.semantics[3][_at(after, 0.4, 2.4)] and after.explored[_at(after, 0.4, 2.9)]


def test_explored_cells_are_visible_in_the_scene():
    """A ray to an explored cell at the height of the camera does not hit a surface of the scene before it."""
    sim = Simulator(two_rooms(), CAMERA, rgb=False)
    rng = np.random.default_rng(0)
    for _ in range(5):
        observation = sim.reset(pose=sim.sample_pose(rng))
        after = update(empty_map(observation.pose), observation, CAMERA)
        cells = np.argwhere(after.explored & ~after.visited)
        targets = (cells[:, ::-1] + 0.5) * after.cell + after.origin
        eye = observation.pose[:3, 3]
        flat = np.c_[targets, np.full(len(targets), eye[2])] - eye
        t = sim.cast(np.broadcast_to(eye, flat.shape), flat).t
        beyond = (1 - t) * np.linalg.norm(flat, axis=1)  # metres past the first surface
        # Exceptions are cells seen above the refrigerator, and a few at the edge of the doorway.
        assert (beyond > 0.15).sum() <= 0.015 * max(len(beyond), 1)


def test_updates_do_not_modify_their_input_and_never_clear_cells():
    sim = Simulator(two_rooms(), CAMERA, rgb=False)
    state = empty_map(sim.reset(seed=1).pose)
    rng = np.random.default_rng(0)
    for _ in range(20):
        observation = sim.step(rng.integers(3))
        names = ("occupied", "explored", "visited", "semantics", "viewpoints")
        copies = {name: getattr(state, name).copy() for name in names}
        after = update(state, observation, CAMERA)
        for name, copy in copies.items():
            np.testing.assert_array_equal(getattr(state, name), copy)
            assert not (copy & ~getattr(after, name)).any()
        again = update(after, observation, CAMERA)
        for name in names:
            np.testing.assert_array_equal(getattr(again, name), getattr(after, name))
        assert not (after.visited & ~after.explored).any()
        assert not (after.semantics.any(axis=0) & ~after.occupied).any()
        state = after


def test_viewpoints_are_directions_from_the_cell_to_the_camera():
    sim = Simulator(empty_room(), CAMERA, rgb=False)
    # Seen from the west: the camera lies at 180 degrees, bin 6 = [180, 210) or bin 5 = [150, 180).
    west = _observe(sim, 0.5, 1.45, 0.0)
    after = update(empty_map(west.pose), west, CAMERA)
    cell = _at(after, 2.0, 1.6)
    assert np.flatnonzero(after.viewpoints[(slice(None), *cell)]).tolist() == [6]
    south = _observe(sim, 2.1, 0.5, np.pi / 2)
    after = update(after, south, CAMERA)
    assert np.flatnonzero(after.viewpoints[(slice(None), *cell)]).tolist() == [6, 9]  # 275 degrees
    seen = after.viewpoints.any(axis=0)
    np.testing.assert_array_equal(seen | after.visited, after.explored)  # every seen cell, obstacle or not


def test_visited_is_the_disc_of_the_body():
    sim = Simulator(empty_room(), CAMERA, rgb=False)
    observation = _observe(sim, 2.0, 1.5, 0.0)
    after = update(empty_map(observation.pose), observation, CAMERA)
    assert after.visited.sum() * after.cell**2 == pytest.approx(np.pi * 0.18**2, rel=0.15)


def test_points_outside_the_map_are_ignored():
    sim = Simulator(two_rooms(), CAMERA, rgb=False)
    observation = _observe(sim, 1.0, 1.5, 0.0)
    after = update(empty_map(observation.pose, size=20), observation, CAMERA)
    assert after.explored.any()
    moved = _observe(sim, 6.5, 1.5, 0.0)
    np.testing.assert_array_equal(update(after, moved, CAMERA).explored, after.explored)


def test_mismatched_and_tilted_cameras_are_refused():
    sim = Simulator(empty_room(), CAMERA, rgb=False)
    observation = _observe(sim, 2.0, 1.5, 0.0)
    state = empty_map(observation.pose)
    with pytest.raises(ValueError, match="do not match"):
        update(state, observation, CAMERA.resized(32, 32))
    tilted = observation.pose.copy()
    tilted[:3, :3] = tilted[:3, :3] @ np.array([[1, 0, 0], [0, 0.8, -0.6], [0, 0.6, 0.8]])
    with pytest.raises(ValueError, match="level camera"):
        update(state, Observation(observation.rgb, observation.depth, observation.semantics, tilted), CAMERA)


def test_the_mapper_equals_update():
    sim = Simulator(load_scene("train-01"), Intrinsics.from_fov(24, 24), rgb=False)
    observation = sim.reset(seed=3)
    start = empty_map(observation.pose, 200, 0.1)
    mapper, known = Mapper(start, sim.intrinsics), start
    for action in [0, 1, 1, 0, 0, 2, 0, 0, 2, 2, 0]:
        before, known = known, update(known, observation, sim.intrinsics)
        for wanted, found in zip((before, known), mapper.add(observation), strict=True):
            for name in ("occupied", "explored", "visited", "semantics", "viewpoints", "pose"):
                np.testing.assert_array_equal(getattr(found, name), getattr(wanted, name))
        observation = sim.step(action)
    assert not start.explored.any() and known.explored.sum() > 500


@pytest.mark.parametrize(("depth", "cells"), [(2.9, 60), (3.1, 60 + 2 * GROWTH)])
def test_a_map_grows_for_points_farther_than_its_border(depth, cells):
    """The map ends 1.5 m before the camera; it grows for points more than 1.5 m beyond."""
    observation = _one_pixel(depth, 32, label=1)
    mapper = Mapper(empty_map(planar_pose(0, 0, 0), 60), Intrinsics.from_fov(65, 65), grows=True)
    before, after = mapper.add(observation)
    assert before.explored.shape == after.explored.shape == (cells, cells)
    np.testing.assert_allclose(after.origin, -cells * after.cell / 2)
    assert after.semantics[0].sum() == (cells > 60)


def test_a_grown_map_equals_a_large_one():
    sim = Simulator(load_scene("train-01"), Intrinsics.from_fov(24, 24), rgb=False)
    observation = sim.reset(seed=3)
    maps = [Mapper(empty_map(observation.pose, size), sim.intrinsics, grows=True) for size in (80, 80 + 2 * GROWTH)]
    for action in [0, 1, 1, 0, 0, 2, 0, 0, 2, 2, 0, 0, 0, 0, 1, 0, 0]:
        small, large = (mapper.add(observation)[1] for mapper in maps)
        observation = sim.step(action)
    assert small.explored.shape == large.explored.shape
    first = np.s_[..., GROWTH:-GROWTH, GROWTH:-GROWTH]  # only points outside of it may be missing, until seen again
    for name in ("occupied", "explored", "visited", "semantics", "viewpoints"):
        np.testing.assert_array_equal(getattr(small, name)[first], getattr(large, name)[first])
        assert not (getattr(small, name) & ~getattr(large, name)).any()


def test_a_map_does_not_grow_without_end(monkeypatch):
    monkeypatch.setattr(semantic_map, "LIMIT", 300)
    mapper = Mapper(empty_map(planar_pose(0, 0, 0), 60), Intrinsics.from_fov(65, 65), grows=True)
    with pytest.raises(SceneError, match="would exceed 15 m a side; check the scale of the scene"):
        mapper.add(_one_pixel(3.1, 32))
