"""Episodes in Habitat's format: files in and out, and success and SPL of policies whose path is known."""

import gzip
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from toy_habitat import block, room, write_glb

from autonerf_lab.data.episodes import Episode, read_episodes, write_episodes
from autonerf_lab.errors import DataError, UnknownNameError
from autonerf_lab.evaluators import episodes as module
from autonerf_lab.evaluators.episodes import Goal, evaluate_episodes, sample_episodes, start_of, to_scene
from autonerf_lab.scenes import Scene, import_scene

FORWARD, LEFT, STOP = 0, 1, 3
pytestmark = pytest.mark.filterwarnings("ignore:.*no object has a name:UserWarning")  # a room alone


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """Return a room of 6 x 5 m with z up; in Habitat's world x is 0 to 6 and z is -5 to 0."""
    return import_scene(write_glb(tmp_path_factory.mktemp("room") / "room.glb", room()), up="z")


class Script:
    """Policy that performs a list of actions and then stops."""

    def __init__(self, *actions: int) -> None:
        self.actions = list(actions)
        self.goal: Goal | None = None

    def reset(self, goal: Goal, observation: Any, seed: int) -> None:
        self.goal, self.left = goal, iter(self.actions)

    def act(self, observation: Any) -> int:
        return next(self.left, STOP)


def towards_x(goal: tuple[float, float, float], category: str = "") -> Episode:
    """Start at (1, 0, -2.5) of Habitat's world, looking along +x: a turn of -90 degrees about y."""
    half = np.sqrt(0.5)
    return Episode("7", "room.glb", (1.0, 0.0, -2.5), (0.0, -half, 0.0, half), (goal,), category)


def test_the_start_is_that_of_the_file(scene: Scene) -> None:
    episode = towards_x((3, 0, -2.5))
    x, y, heading = start_of(episode, scene)
    assert np.allclose((x, y, heading), (1 - 3, 2.5 - 2.5, 0), atol=1e-6)  # the scene has its centre at the origin
    assert np.allclose(to_scene((3, 0.5, -1), scene), (0, -1.5, 0.5), atol=1e-6)


@pytest.mark.parametrize(
    ("actions", "success", "path"),
    [
        pytest.param([FORWARD] * 8, 1, 2.0, id="straight"),
        pytest.param([FORWARD] * 7, 0, 1.75, id="stops 25 cm too early"),
        pytest.param([FORWARD] * 10 + [LEFT] * 6 + [FORWARD] * 2, 1, 3.0, id="detour"),
        pytest.param([FORWARD] * 8 + [LEFT] * 100, 0, 2.0, id="does not stop"),
    ],
)
def test_success_and_spl(scene: Scene, actions: list[int], success: int, path: float) -> None:
    policy = Script(*actions)
    scores = evaluate_episodes(policy, [towards_x((3, 0, -2.5))], scene, size=8, max_steps=50, progress=False)
    values = {score.metric: score.value for score in scores}
    row = scores.artifacts["episodes"]["rows"][0]
    assert values["success"] == 100 * success and row["path"] == pytest.approx(path, abs=0.01)
    assert row["shortest"] == pytest.approx(2, abs=0.06)
    assert values["spl"] == pytest.approx(100 * success * row["shortest"] / max(path, row["shortest"]), abs=1)
    assert policy.goal is not None and policy.goal.position is not None
    assert np.allclose(policy.goal.position, (0, 0), atol=1e-6)


def test_objectnav_succeeds_at_a_view_point(scene: Scene) -> None:
    policy = Script(*[FORWARD] * 8)
    scores = evaluate_episodes(policy, [towards_x((3, 0, -2.5), "sofa")], scene, size=8, progress=False)
    assert scores[0].value == 100 and scores[0].task == "objectnav"
    assert policy.goal is not None and policy.goal.position is None and policy.goal.category == "couch"


def test_episodes_that_cannot_be_run_are_counted(scene: Scene) -> None:
    episodes = [towards_x((3, 0, -2.5)), towards_x((30, 0, -2.5))]
    scores = evaluate_episodes(Script(), episodes, scene, size=8, progress=False)
    assert scores[0].n == 1 and scores[0].status.startswith("1 episodes left out: start or goal")
    with pytest.raises(DataError, match="no episode belongs to scene 'room'; the episodes have the scenes other"):
        evaluate_episodes(Script(), [Episode("1", "x/other.glb", (0, 0, 0), (0, 0, 0, 1), ((1, 0, 0),))], scene)
    with pytest.raises(UnknownNameError, match="fast-marching"):
        evaluate_episodes("fast", episodes, scene)


def test_episodes_of_another_floor_are_left_out(scene: Scene) -> None:
    """Their x and y lie on the navigable floor, 3 m above which they begin or end."""
    upstairs = replace(towards_x((3, 0, -2.5)), start_position=(1.0, 3.0, -2.5))
    beds = replace(towards_x((3, 3, -2.5), "bed"), goals=((3, 3, -2.5), (4, 0, -2.5)))
    for episodes, count in (([upstairs, towards_x((3, 3, -2.5)), towards_x((3, 0, -2.5))], 1), ([beds], 1)):
        scores = evaluate_episodes(Script(*[FORWARD] * 12), episodes, scene, size=8, progress=False)
        assert scores[0].n == count
    assert scores[0].value == 100, "the bed on the robot's floor, not the one above"
    left_out = evaluate_episodes(Script(), [upstairs], scene, size=8, progress=False)[0]
    assert left_out.value is None and "1 episodes left out: start or goal is on another floor" in left_out.status


def test_episodes_find_their_scene_by_its_file(tmp_path: Path) -> None:
    for file in ("TEE.basis.glb", "home.v2.glb"):
        scene = import_scene(write_glb(tmp_path / file, room()), up="z")
        episode = replace(towards_x((3, 0, -2.5)), scene_id=f"hm3d/val/{file}")
        assert evaluate_episodes(Script(), [episode], scene, size=8, progress=False)[0].n == 1
        made = read_episodes(write_episodes(sample_episodes(scene, 1), tmp_path / "e.json"))
        assert evaluate_episodes(Script(), made, scene, size=8, progress=False)[0].n == 1


def test_a_file_that_refers_to_those_of_the_scenes(tmp_path: Path) -> None:
    """``val.json.gz`` of HM3D is empty: each scene has a file of its own."""
    (tmp_path / "content").mkdir()
    (tmp_path / "val.json.gz").write_bytes(gzip.compress(b'{"episodes": []}'))
    with pytest.raises(DataError, match=r"val\.json\.gz holds no episodes; give .*content/SCENE\.json\.gz"):
        read_episodes(tmp_path / "val.json.gz")


@pytest.mark.parametrize("name", ["e.json.gz", "e.json"])
def test_sampled_episodes_survive_a_file(tmp_path: Path, name: str) -> None:
    chair = block((0.5, 0.5, 0.9), (4, 2, 0), (9, 9, 9))
    import trimesh

    both = trimesh.Scene()
    both.add_geometry(room(), node_name="walls")
    both.add_geometry(chair, node_name="chair_1")
    (tmp_path / "room.glb").write_bytes(trimesh.exchange.gltf.export_glb(both))
    scene = import_scene(tmp_path / "room.glb", up="z")
    for kind, category in (("pointnav", ""), ("objectnav", "chair")):
        made = sample_episodes(scene, 3, kind=kind)
        assert read_episodes(write_episodes(made, tmp_path / name)) == made
        assert {episode.category for episode in made} == {category}
        assert all(episode.shortest is not None and episode.shortest >= 1 for episode in made)
    content = json.loads(gzip.decompress((tmp_path / name).read_bytes()) if name.endswith("gz") else
                         (tmp_path / name).read_bytes())  # fmt: skip
    assert list(content["goals_by_category"]) == ["room_chair"] and content["episodes"][0]["goals"] == []
    # habitat-lab refuses a file of ObjectNav without these
    assert (
        content["category_to_task_category_id"] == content["category_to_scene_annotation_category_id"] == {"chair": 0}
    )
    (goal,) = content["goals_by_category"]["room_chair"]
    assert goal["object_id"] is not None and set(goal["view_points"][0]) == {"agent_state", "iou"}


def test_a_file_of_habitat_is_read(tmp_path: Path) -> None:
    """Keys as in the PointNav and ObjectNav archives, with those that are not used."""
    entry = {"episode_id": 3, "scene_id": "hm3d/val/00800-TEE/TEE.basis.glb", "start_position": [1, 2, 3], "info": {
        "geodesic_distance": 6.5, "difficulty": "easy"}, "start_rotation": [0, 1, 0, 0], "start_room": None,
        "shortest_paths": None, "goals": [], "object_category": "bed"}  # fmt: skip
    view = {"agent_state": {"position": [4, 2, 1], "rotation": [0, 0, 0, 1]}, "iou": 0.1}
    goal = {"position": [4, 2.5, 0], "radius": None, "object_id": 5, "object_name": "bed_5", "view_points": [view]}
    content = {
        "episodes": [entry],
        "goals_by_category": {"TEE.basis.glb_bed": [goal]},
        "category_to_task_category_id": {},
    }
    (tmp_path / "e.json.gz").write_bytes(gzip.compress(json.dumps(content).encode()))
    (episode,) = read_episodes(tmp_path / "e.json.gz")
    assert (episode.scene, episode.category, episode.goals, episode.shortest) == ("TEE", "bed", ((4, 2, 1),), 6.5)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"goals": []}, r"episodes\[0\] \(1\) has no goal"),
        ({"start_rotation": [0, 0, 0, 0]}, r"episodes\[0\]: 'start_rotation' must be a unit"),
        ({"start_position": [1e9, 0, 0]}, r"episodes\[0\] has a position beyond"),
        ({"scene_id": None}, r"Expected `str`, got `null`"),
    ],
)
def test_damaged_episodes_are_refused(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    entry = {"episode_id": "1", "scene_id": "a.glb", "start_position": [0, 0, 0], "start_rotation": [0, 0, 0, 1]}
    entry |= {"goals": [{"position": [1, 0, 0]}]}
    (tmp_path / "e.json").write_text(json.dumps({"episodes": [entry | change]}))
    with pytest.raises(DataError, match=message):
        read_episodes(tmp_path / "e.json")


def test_a_gzip_bomb_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("autonerf_lab.data.episodes.MAX_BYTES", 1000)
    (tmp_path / "e.json.gz").write_bytes(gzip.compress(b" " * 100_000))
    with pytest.raises(DataError, match="more than 1000 bytes when decompressed"):
        read_episodes(tmp_path / "e.json.gz")
    (tmp_path / "e.json.gz").write_bytes(gzip.compress(b"{}")[:-6])
    with pytest.raises(DataError, match="is cut off"):
        read_episodes(tmp_path / "e.json.gz")


def test_built_in_policies_reach_a_goal(scene: Scene) -> None:
    scores = evaluate_episodes("fast-marching", [towards_x((3, 0, -2.5))], scene, size=32, progress=False)
    assert scores[0].value == 100 and scores[1].value is not None and scores[1].value > 80
    assert set(module.GOAL_POLICIES) == {"fast-marching", "random"}
