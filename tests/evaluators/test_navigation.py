"""Navigation in a mesh: the true mesh, meshes with extra walls and obstacles, and meshes that are not navigable."""

import numpy as np
import pytest
import toy_scene
import trimesh

from autonerf_lab.errors import UnknownNameError
from autonerf_lab.evaluators import DEFAULT_TASKS, TrueField, evaluate
from autonerf_lab.evaluators.navigation import (
    NavigationEpisode,
    add_floor,
    evaluate_navigation,
    mesh_scene,
    navigate,
    sample_navigation_episodes,
)
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.simulator import Simulator
from autonerf_lab.simulator.navigation import build_navigation
from autonerf_lab.viz.figures.navigation import navigation_paths

CAMERA = Intrinsics.from_fov(64, 64)


@pytest.fixture(scope="module")
def sim():
    return Simulator(toy_scene.two_rooms(), CAMERA, supersample=1, rgb=False)


def as_mesh(*boxes, scene=None):
    """The toy scene with boxes (low, high) put into it."""
    scene = scene or toy_scene.two_rooms()
    mesh = trimesh.Trimesh(scene.vertices, scene.faces, process=False)
    return trimesh.util.concatenate([mesh, *(trimesh.creation.box(bounds=bounds) for bounds in boxes)])


def test_spl_by_hand():
    corner = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 4.0]])
    assert NavigationEpisode(corner[-1], corner, 5.0, "").spl == pytest.approx(5 / 7)
    assert NavigationEpisode(corner[-1], corner, 8.0, "").spl == 1, "it may stop before the goal"
    assert NavigationEpisode(corner[-1], corner, 5.0, "stuck").spl == 0
    assert NavigationEpisode(corner[-1], corner, np.inf, "no path").spl == 0, "no path exists"


def test_an_imported_mesh_keeps_its_position(sim):
    scene = mesh_scene(as_mesh())
    np.testing.assert_allclose(scene.bounds, sim.scene.bounds, atol=1e-5)
    shifted = as_mesh().apply_translation([10.0, -20.0, 0.0])
    np.testing.assert_allclose(mesh_scene(shifted).bounds, sim.scene.bounds + np.array([10, -20, 0]), atol=1e-4)


def test_floor_is_added_where_training_rays_reached_it(sim):
    """A room without a floor, with a pit, a bump and a stool: floor is added where it was seen; the stool is kept."""
    bump, stool = ([1.0, 1.0, 0.0], [1.2, 1.2, 0.15]), ([2.0, 1.2, 0.0], [2.3, 1.5, 0.4])
    pit, other_room = ([3.0, 0.2, -0.5], [3.5, 0.7, -0.4]), ([4.1, 0.0, -0.1], [8.0, 3.0, 0.0])
    bare = as_mesh()
    bare.update_faces(np.abs(bare.triangles_center[:, 2]) > 1e-3)
    mesh = as_mesh(bump, stool, pit, other_room, scene=bare)

    class Seen:
        def seen(self, points):
            np.testing.assert_array_equal(points[:, 2], 0)
            return (points[:, 0] > 0) & (points[:, 0] < 3.8) & (points[:, 1] > 0) & (points[:, 1] < 2.5)

    floored = add_floor(mesh, Seen())
    np.testing.assert_allclose(floored.bounds, mesh.bounds, err_msg="no floor outside the mesh")
    low = np.abs(floored.vertices[:, 2]) < 0.2
    assert (floored.vertices[low, 2] == 0).all() and low.any()
    positions = {"bump": (1.1, 1.1), "pit": (3.25, 0.45), "stool": (2.15, 1.35), "unseen": (3.2, 2.8)}
    assert fits(sim.scene, positions) == {"bump", "pit", "stool", "unseen"}
    assert fits(mesh_scene(mesh), positions) == set()
    assert fits(mesh_scene(floored), positions) == {"bump", "pit"}


def fits(scene, positions):
    ground = build_navigation(scene)
    return {name for name, position in positions.items() if ground.is_navigable(*position)}


def test_episodes_are_seeded_and_the_robot_fits_in_both_scenes(sim):
    other = Simulator(mesh_scene(as_mesh(([1.5, 0.5, 0], [2.5, 1.5, 2]))), CAMERA, supersample=1, rgb=False)
    episodes = sample_navigation_episodes(sim, other, 12, seed=3)
    assert len(episodes) == 12
    for start, goal in episodes:
        for position in (start, goal):
            assert sim.navigation.is_navigable(*position) and other.navigation.is_navigable(*position)
        assert np.linalg.norm(start - goal) < 10 and shortest_path(sim, start, goal) >= 2
    np.testing.assert_array_equal(episodes, sample_navigation_episodes(sim, other, 12, seed=3))
    assert not np.array_equal(episodes, sample_navigation_episodes(sim, other, 12, seed=4))


def shortest_path(sim, start, goal):
    return navigate(sim, start, goal, 0.0, max_steps=0).shortest


def test_an_episode_through_the_doorway(sim):
    start, goal = np.array([1.0, 1.0]), np.array([7.0, 1.8])
    episode = navigate(sim, start, goal, heading=np.pi / 2)
    assert episode.success and episode.spl > 0.9
    np.testing.assert_allclose(episode.path[0], start)
    assert np.linalg.norm(episode.path[-1] - goal) <= 0.36 < np.linalg.norm(episode.path[-2] - goal)
    assert np.linalg.norm(np.diff(episode.path, axis=0), axis=1).max() <= 0.25 + 1e-9, "a step is a step"
    assert episode.shortest == pytest.approx(np.hypot(6.0, 0.8), rel=0.03)
    short = navigate(sim, start, goal, np.pi / 2, max_steps=5)
    assert short.reason == "out of steps" and short.spl == 0 and len(short.path) == 6


def test_the_true_mesh_gives_the_episodes_of_the_true_scene(sim):
    result = evaluate_navigation(as_mesh(), sim.scene, 10, seed=1)
    assert result.values["success"] == result.values["success_true_mesh"] == 100
    assert result.values["spl"] == pytest.approx(result.values["spl_true_mesh"]) and result.values["spl"] > 95
    for ours, theirs in zip(result.artifact["episodes"], result.artifact["episodes_true_mesh"], strict=True):
        np.testing.assert_allclose(ours.path, theirs.path, atol=1e-6)


def test_a_phantom_wall_restricts_episodes_to_one_room(sim):
    result = evaluate_navigation(as_mesh(([3.9, 0.9, 0], [4.2, 2.1, 2.5])), sim.scene, 10, seed=1)
    sides = {tuple(episode.path[0] > 4) + tuple(episode.goal > 4) for episode in result.artifact["episodes"]}
    assert len({(a, c) for a, _, c, _ in sides}) == 1, "the navigable area of both is one room"


def test_an_invisible_obstacle_blocks_the_robot(sim):
    """A sill of 20 cm is too low for the map of obstacles and too high for the robot."""
    start, goal = np.array([1.0, 1.5]), np.array([3.2, 1.5])
    sill = Simulator(mesh_scene(as_mesh(([2.0, -0.5, 0], [2.1, 3.5, 0.2]))), CAMERA, supersample=1, rgb=False)
    episode = navigate(sill, start, goal, 0.0, max_steps=120)
    assert not episode.success and episode.reason in ("no path", "stuck", "out of steps")
    assert episode.path[:, 0].max() < 2.0


def test_a_mesh_that_is_not_navigable_has_a_status(sim):
    def statuses(mesh):
        return set(evaluate_navigation(mesh, sim.scene, 3).status.values())

    assert statuses(trimesh.Trimesh(process=False)) == {"empty mesh"}
    walls = as_mesh()
    walls.update_faces(np.abs(walls.face_normals[:, 2]) < 0.5)
    (said,) = statuses(walls)
    assert said.startswith("not walkable: ") and "no floor" in said


def test_navigation_runs_only_by_name(sim):
    field = TrueField(sim.scene, views=1)
    scores = evaluate(field, sim.scene, "smoke", tasks=["navigation"], progress=False)
    assert [(row.metric, row.unit, row.n) for row in scores] == [
        (name, "%", 10) for name in ("success", "spl", "success_true_mesh", "spl_true_mesh")
    ]
    assert scores["navigation", "success"] == 100 and "navigation" not in DEFAULT_TASKS
    with pytest.raises(UnknownNameError, match="navigation"):
        evaluate(field, sim.scene, "smoke", tasks=["navigate"])


def test_the_figure_shows_both_scenes(sim):
    result = evaluate_navigation(as_mesh(([1.5, 0.5, 0], [2.5, 1.5, 2])), sim.scene, 4)
    figure = navigation_paths(result.artifact)
    assert [ax.get_title().split(":")[0] for ax in figure.axes] == ["In the reconstructed mesh", "In the true scene"]
    assert navigation_paths({}).texts, "a failed task gives a figure with a text"
