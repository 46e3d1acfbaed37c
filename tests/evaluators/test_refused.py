"""Invalid input: an error before any computation, or a score without a value and with a status."""

import errno
from dataclasses import replace

import numpy as np
import pytest
import toy_scene

from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.errors import DataError
from autonerf_lab.evaluators import DEFAULT_TASKS, TASKS, Rendering, TrueField, evaluate, ground_truth
from autonerf_lab.evaluators.ground_truth import MapGrid, TrueMap
from autonerf_lab.evaluators.planning import evaluate_planning, sample_episodes
from autonerf_lab.geometry import Intrinsics, planar_pose
from autonerf_lab.nerf.field_frame import FieldFrame
from autonerf_lab.presets import preset
from autonerf_lab.simulator import Simulator

CAMERA = Intrinsics.from_fov(16, 16)


class Air:
    """An empty field that was seen everywhere."""

    intrinsics, frame, classes = CAMERA, FieldFrame(), 16

    def __init__(self, place, **meta):
        self.poses = np.stack([planar_pose(*place.bounds.mean(axis=0)[:2], 0.0)] * 2)
        self.meta = {"scene": place.name, **meta}

    def render(self, c2w, intrinsics):
        flat = np.zeros((intrinsics.height, intrinsics.width), np.float32)
        return Rendering(np.zeros((*flat.shape, 3), np.float32), flat, flat.astype(np.uint8), flat)

    def density(self, points):
        return np.zeros(len(points), np.float32)

    def color(self, points, directions=None):
        return np.zeros((len(points), 3), np.float32)

    def semantics(self, points):
        return np.eye(16, dtype=np.float32)[np.zeros(len(points), int)]

    def seen(self, points):
        return np.ones(len(points), bool)

    def ray_gradients(self, rays_o, rays_d, target):
        return (target**2).mean(axis=1), np.zeros_like(rays_o), np.zeros_like(rays_d)


class Untouched(Air):
    """A field that must be refused before any of its methods is called."""

    def render(self, c2w, intrinsics):
        raise AssertionError("the field must be refused before")

    density = render


def scored(field, scene, **options):
    return evaluate(field, scene, "smoke", progress=False, **options)


def statuses(scores, task):
    return {row.metric: row.status for row in scores if row.task == task and row.value is None}


@pytest.fixture(scope="module")
def scene():
    return toy_scene.two_rooms()


def test_a_field_of_another_scene_is_refused(scene):
    with pytest.raises(DataError, match=r"this field belongs to scene 'elsewhere', not 'toy'"):
        scored(Untouched(scene, scene="elsewhere"), scene)
    with pytest.raises(DataError, match=r"another version of scene 'toy'"):
        scored(Untouched(scene, scene_sha256="0" * 64), scene)
    assert scored(Air(scene, scene_sha256=scene.sha256), scene, tasks=["mesh"])


def test_a_field_of_photographs_is_refused(scene):
    field = Untouched(scene)
    field.frame = FieldFrame(np.zeros(3), 2.5)
    with pytest.raises(DataError, match="not in metres"):
        scored(field, scene)


def test_poses_outside_the_bounds_are_refused(scene):
    field = Untouched(scene)
    field.poses = field.poses + 0.0
    field.poses[:, 0, 3] += 100
    with pytest.raises(DataError, match=r"100 % of the poses of this field lie outside the bounds of scene 'toy'"):
        scored(field, scene)


@pytest.mark.parametrize("tasks", [None, ["mesh"], iter(["maps"])])
def test_a_trajectory_of_another_scene_is_refused_before_anything_else(scene, tasks):
    image = np.zeros((1, 16, 16, 3), np.uint8)
    trajectory = Trajectory(
        planar_pose(1.0, 1.0, 0.0)[None], image, image[..., 0] + 1.0, None, CAMERA, {"scene": "away"}
    )
    with pytest.raises(DataError, match="this trajectory belongs to scene 'away'"):
        scored(Untouched(scene), scene, tasks=tasks, trajectory=trajectory)


def test_an_empty_field_goes_through_all_tasks(scene):
    scores = scored(Air(scene), scene, tasks=(name for name in [*DEFAULT_TASKS, "navigation"]))
    assert not [row.status for row in scores if row.status.startswith("failed")]
    assert {row.task for row in scores} == {*DEFAULT_TASKS, "navigation"}, "names may be a generator"
    assert scores["maps", "occupancy_recall"] == scores["maps", "semantic_recall_5cm"] == 0
    assert scores["planning", "objectgoal_success"] == scores["pose_refinement", "convergence_rate"] == 0
    assert set(statuses(scores, "mesh").values()) == set(statuses(scores, "navigation").values()) == {"empty mesh"}
    assert set(scores.details["planning"]["reasons"]["ObjectGoal: bed"]) == {"class not predicted"}


def test_a_scene_without_objects_has_a_status():
    room = toy_scene.empty_room()
    scores = scored(TrueField(room, views=40), room)
    assert {row.status for row in scores if row.value is None} == {
        "weights_missing", "no object in the scene", "no object in the test images",
    }  # fmt: skip
    assert set(statuses(scores, "planning")) == {"objectgoal_success", "objectgoal_spl"}
    assert scores["planning", "pointgoal_success"] == 100


def test_a_scene_too_small_for_a_goal_or_for_the_robot(scene):
    small = toy_scene.empty_room(1.2, 1.2)
    assert set(statuses(scored(TrueField(small, views=4), small, tasks=["planning"]), "planning").values()) == {
        "no goal within reach", "no object in the scene",
    }  # fmt: skip
    closet = toy_scene.closet()
    scores = scored(Air(closet), closet)
    said = {row.status for row in scores if row.task != "mesh"}
    assert len(said) == 1 and "no floor area for a robot" in said.pop(), "each row has the reason"


def test_a_map_without_free_ground_has_no_tasks():
    none = np.zeros((5, 5), bool)
    known = TrueMap(MapGrid(np.zeros(2), none.shape), ~none, ~none, none, np.zeros((15, 5, 5), bool))
    episode_set = sample_episodes(known, 10)
    assert len(episode_set.starts) == 0 and episode_set.classes == ()
    result = evaluate_planning(np.ones((5, 5), np.uint8), np.zeros((5, 5), np.uint8), known, episode_set)
    assert result.status["pointgoal_success"] == "no goal within reach" and set(result.values.values()) == {None}


def test_a_scene_too_large_for_a_map_has_the_other_scores(monkeypatch):
    room = toy_scene.empty_room()
    monkeypatch.setattr(ground_truth, "MAX_CELLS", 100_000)
    field = Air(room)
    scores = scored(field, room)
    for task in ("maps", "planning"):
        assert all("SceneError" in text and "map cells" in text for text in statuses(scores, task).values())
        assert len(statuses(scores, task)) == len(TASKS[task].metrics)
    assert scores["rendering", "psnr"] > 0 and set(statuses(scores, "mesh").values()) == {"empty mesh"}


@pytest.mark.parametrize("error", [MemoryError(), OSError(errno.ENOSPC, "No space left on device")])
def test_full_memory_or_disk_stops_the_evaluation(scene, error):
    class Greedy(Air):
        def render(self, c2w, intrinsics):
            raise error

    with pytest.raises(type(error)):
        scored(Greedy(scene), scene, tasks=["rendering"])


def test_rows_name_the_changed_settings(scene):
    size = replace(preset("smoke"), refine_poses=1, refine_iterations=1, refine_interest=True)
    scores = evaluate(Air(scene), scene, size, tasks=["pose_refinement"], progress=False)
    assert {row.preset for row in scores} == {"smoke, refine_poses=1, refine_iterations=1, refine_interest=True"}


def test_a_start_beside_the_object_is_no_episode(scene):
    known = ground_truth.true_map(Simulator(scene, CAMERA, supersample=1))
    episode_set = sample_episodes(known, 40, seed=2)
    beside = {k: int(np.sum(episode_set.shortest_object[k] == 0)) for k in episode_set.classes}
    assert sum(beside.values()) > 0
    states = np.where(known.free, 1, 2).astype(np.uint8)
    episodes = evaluate_planning(states, np.zeros_like(states), known, episode_set).artifact["objects"]
    assert {k: 40 - sum(e.class_id == k for e in episodes) for k in episode_set.classes} == beside
    assert all(e.shortest > 0 for e in episodes)


def test_details_that_are_damaged_are_one_error(tmp_path):
    from autonerf_lab.evaluators import Scores

    for bad in ("[1]", '{"planning": 3}', '{"planning": {"reasons": {"PointGoal": [1]}}}', '{"planning": null}'):
        (tmp_path / "scores.json").write_text(f'{{"scores": [], "details": {bad}}}')
        with pytest.raises(DataError, match=r"scores\.json.*details"):
            Scores.load(tmp_path / "scores.json")


def test_details_are_saved_with_the_scores(scene, tmp_path):
    from autonerf_lab.evaluators import Scores
    from autonerf_lab.evaluators.rendering import sample_test_poses

    size = preset("smoke")
    scores = scored(Air(scene), scene, tasks=["rendering", "planning"])
    scores.save(tmp_path / "scores.json")
    again = Scores.load(tmp_path / "scores.json")
    poses = sample_test_poses(Simulator(scene, CAMERA), size.test_poses)
    stored = np.stack([planar_pose(*pose) for pose in again.details["rendering"]["test_poses_x_y_heading"]])
    np.testing.assert_allclose(stored, poses, atol=1e-12)
    header, *rows = again.details_table("planning")
    assert header[0] == "episodes" and [row[0] for row in rows][:2] == ["PointGoal", "ObjectGoal"]
    assert sum(map(int, rows[0][1:])) == size.planning_starts
