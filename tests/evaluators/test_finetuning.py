"""Fine-tuning of a PointGoal policy: expert, training in a mesh, evaluation in the true scene."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import toy_scene
import trimesh

from autonerf_lab import cli
from autonerf_lab.envs.pointgoal import PointGoalEnv
from autonerf_lab.errors import DataError, RunFolderError, TrainingError
from autonerf_lab.evaluators import Scores, finetuning
from autonerf_lab.evaluators.finetuning import evaluate_finetuning
from autonerf_lab.evaluators.goal_policy import load_goal_policy, reach_goals
from autonerf_lab.evaluators.metrics import metrics_of
from autonerf_lab.policies import load_policy
from autonerf_lab.policies.networks import GoalNetwork
from autonerf_lab.policies.pointgoal import STOP
from autonerf_lab.policies.spec import SPECS, make_network
from autonerf_lab.policies.weights import read_meta, save_weights
from autonerf_lab.presets import preset
from autonerf_lab.training import shortest_path_expert
from autonerf_lab.training.settings import POINTGOAL, settings_of
from autonerf_lab.training.train import train_policy
from autonerf_lab.types import Score
from autonerf_lab.viz.figures.finetuning import finetuning_results

NAMES = [metric.name for metric in metrics_of("finetuning")]
SMALL = settings_of(POINTGOAL, frames=128, demonstrations=0, environments=2, rollout=32, batch=32, epochs=1, episode=40)


@pytest.fixture(scope="module")
def scene():
    return toy_scene.to_scene(toy_scene.two_rooms())


@pytest.fixture
def weights(tmp_path):
    torch.manual_seed(0)
    path = tmp_path / "start"
    save_weights(path, GoalNetwork(), {"network": {"kind": "goal"}, "frames": 0, "hours": 0.0, "curve": []})
    return path.with_suffix(".safetensors")


@pytest.mark.parametrize("name", ["dev-1", "train-00"])
def test_the_expert_follows_nearly_shortest_paths(name):
    env = PointGoalEnv(scene=name, size=8)
    ends = []
    for seed in range(12):
        env.reset(seed=seed)
        over = False
        while not over:
            _, _, terminated, truncated, info = env.step(np.int64(env.expert_action()))
            over = terminated or truncated
        ends.append(info)
    assert all(end["success"] for end in ends)
    assert np.mean([end["spl"] for end in ends]) > 0.93


@pytest.mark.parametrize("kind", ["egocentric", "goal"])
def test_episodes_in_a_sequence_are_as_episodes_alone(kind):
    torch.manual_seed(1)
    interface, network = make_network({"kind": kind, "memory": 16})
    space = interface.observation_space
    seen = {name: torch.from_numpy(np.stack([space[name].sample() for _ in range(12)])) for name in space}
    starts = torch.tensor([0, 0, 1, 0, 0, 0, 1.0, 0, 0, 1, 1, 0])  # two sequences of six steps
    before = (torch.randn(1, 2, 16), torch.randn(1, 2, 16))
    chances, values, after = network(seen, before, starts)
    for sequence in range(2):
        memory = tuple(part[:, sequence : sequence + 1] for part in before)
        for step in range(6 * sequence, 6 * sequence + 6):
            memory = network.initial_state(1) if starts[step] else memory
            one = {name: value[step : step + 1] for name, value in seen.items()}
            alone, value, memory = network(one, memory, torch.zeros(1))
            torch.testing.assert_close(alone.probs[0], chances.probs[step])
            torch.testing.assert_close(value[0], values[step])
        torch.testing.assert_close(memory[0][0, 0], after[0][0, sequence])


def test_imitation_of_shortest_paths_improves_the_policy(tmp_path, monkeypatch):
    scene = toy_scene.to_scene(toy_scene.empty_room(3.0, 3.0))
    monkeypatch.setattr(shortest_path_expert, "PASSES", 10)  # over few episodes
    torch.manual_seed(0)
    network = GoalNetwork().to(memory_format=torch.channels_last)  # as in a training: half the time
    lost = reach_goals(network, scene, 20)
    settings = settings_of(POINTGOAL, demonstrations=120, environments=4)
    shortest_path_expert.imitate_shortest_paths(
        network, lambda: PointGoalEnv(scene=scene, max_steps=60), settings, tmp_path / "imitation", {}
    )
    led = reach_goals(network, scene, 20)
    assert sum(end["distance_to_goal"] for end in led) < sum(end["distance_to_goal"] for end in lost) / 2
    assert sum(end["success"] for end in led) > 5 + sum(end["success"] for end in lost)


def test_the_same_seeds_are_the_same_episodes(scene, weights):
    network = load_goal_policy(weights)
    ends = reach_goals(network, scene, 30)
    assert len(ends) == 30 and ends == reach_goals(network, scene, 30) != reach_goals(network, scene, 30, seed=1)
    assert ends[:26][25] == reach_goals(network, scene, 26)[25], "an episode does not depend on how many there are"
    with torch.no_grad():
        network.actor.bias[STOP] = 100.0  # whoever stops at once has not moved
    at_once = reach_goals(network, scene, 4)
    assert [end["success"] for end in at_once] == [False] * 4 and all(end["spl"] == 0 for end in at_once)


def test_training_in_the_mesh_and_evaluation_in_the_true_scene(scene, weights, tmp_path, monkeypatch):
    monkeypatch.setattr(finetuning, "PRETRAINED", weights)
    small = {name: getattr(SMALL, name) for name in ("environments", "rollout", "batch", "epochs", "episode")}
    monkeypatch.setitem(SPECS, "goal", replace(SPECS["goal"], settings={**SPECS["goal"].settings, **small}))
    mesh = trimesh.Trimesh(scene.vertices, scene.faces, process=False)
    result = evaluate_finetuning(mesh, scene, 64, 3, folder=tmp_path)
    assert set(result.values) == set(NAMES) and not result.status
    assert all(0 <= result.values[name] <= 100 for name in NAMES)
    assert result.artifact["finetuned"]["frames"] >= 64 > result.artifact["pretrained"]["frames"]
    for stage in ("finetuned", "finetuned_true_mesh"):
        (path,) = (tmp_path / stage).glob("*/policy.safetensors")
        policy = load_goal_policy(path)
        assert result.artifact[stage]["episodes"] == reach_goals(policy, scene, 3)

    moved = trimesh.Trimesh(np.add(scene.vertices, 0.01), scene.faces, process=False)
    assert not evaluate_finetuning(moved, scene, 64, 3, folder=tmp_path).status, "another mesh, in the same folder"
    assert [len([*(tmp_path / stage).iterdir()]) for stage in ("finetuned", "finetuned_true_mesh")] == [2, 1]

    assert len(finetuning_results(result.artifact).axes[1].patches) == 6
    scores = Scores(Score("finetuning", name, value) for name, value in result.values.items())
    scores.details["finetuning"] = result.details
    header, *rows = scores.details_table("finetuning")
    assert header == ("fine-tuning", "success %", "SPL %", "frames", "hours")
    assert [row[0] for row in rows] == ["pre-trained", "fine-tuned in the mesh", "fine-tuned in the true scene"]
    assert rows[1][3] == f"{result.details['finetuned']['frames']:,}" and rows[0][3] == "0"
    assert scores.table().splitlines()[-3:] and "fine-tuned in the true scene" in scores.table()


@pytest.mark.parametrize("mesh", ["nothing", "nowhere to stand"])
def test_a_mesh_that_is_not_navigable_does_not_affect_the_other_stages(scene, weights, tmp_path, monkeypatch, mesh):
    """In the second mesh, a table covers the whole floor: the import succeeds, but the robot does not fit."""
    trained = []

    def finetune(scene, frames, rate, seed, folder):
        trained.append((scene.name, rate))
        return weights

    monkeypatch.setattr(finetuning, "PRETRAINED", weights)
    monkeypatch.setattr(finetuning, "_finetune", finetune)
    table = trimesh.creation.box(bounds=([-1, -1, 0.3], [9, 4, 0.4]))
    room = trimesh.Trimesh(scene.vertices, scene.faces, process=False)
    found = trimesh.Trimesh() if mesh == "nothing" else trimesh.util.concatenate([room, table])
    result = evaluate_finetuning(found, scene, 1, 2, 0, tmp_path, {"finetuned_true_mesh": 2.5e-5})
    assert trained == [(scene.name, 2.5e-5)]
    assert result.values["success_finetuned"] is None and result.n["success_finetuned"] == 0
    assert result.status["spl_finetuned"].startswith("not walkable: ") and str(tmp_path) not in str(result.status)
    assert set(result.status) == {"success_finetuned", "spl_finetuned"}
    assert result.values["success_finetuned_true_mesh"] is not None and result.values["spl_pretrained"] is not None


def test_a_failed_training_does_not_affect_the_other_stages(scene, weights, tmp_path, monkeypatch):
    errors = {"mesh": TrainingError("a loss is not finite"), scene.name: MemoryError()}

    def finetune(scene, frames, rate, seed, folder):
        raise errors[scene.name]

    monkeypatch.setattr(finetuning, "PRETRAINED", weights)
    monkeypatch.setattr(finetuning, "_finetune", finetune)
    mesh = trimesh.Trimesh(scene.vertices, scene.faces, process=False)
    with pytest.raises(MemoryError):  # stops the whole evaluation
        evaluate_finetuning(mesh, scene, 1, 2, folder=tmp_path)
    errors[scene.name] = TrainingError("nor is this one")
    result = evaluate_finetuning(mesh, scene, 1, 2, folder=tmp_path)
    assert result.values["success_pretrained"] is not None
    assert result.status["success_finetuned"] == "failed: TrainingError: a loss is not finite"
    assert result.status["spl_finetuned_true_mesh"] == "failed: TrainingError: nor is this one"


def test_the_paper_has_two_learning_rates():
    size = preset("paper")
    assert (size.finetuning_frames, size.finetuning_lr, size.finetuning_lr_true_mesh) == (10_000_000, 2.5e-6, 2.5e-5)


def test_a_training_continues_from_its_checkpoint_with_the_same_settings(scene, weights, tmp_path, capsys):
    made = train_policy(POINTGOAL, tmp_path, SMALL, workers=1, progress=False, scenes=[scene], start=weights)
    meta = read_meta(made)
    assert meta["command"] is None and meta["frames"] >= 128
    assert {"success", "spl", "reward", "return", "frames"} == set(meta["curve"][0])
    more = replace(SMALL, frames=2 * SMALL.frames)
    train_policy(POINTGOAL, tmp_path, more, workers=1, progress=False, scenes=[scene], start=weights)
    assert read_meta(made)["curve"][: len(meta["curve"])] == meta["curve"], "what is finished can be given more"
    with pytest.raises(RunFolderError, match=r"training_scenes differ"):
        train_policy(POINTGOAL, tmp_path, SMALL, workers=1, progress=False, scenes=["train-00"], start=weights)
    assert (
        cli.main(["train-policy", "--policy", "pointgoal", "--start", "nowhere", "--out", str(tmp_path / "new")]) == 1
    )
    assert "nowhere.safetensors does not exist; start from a built-in policy" in capsys.readouterr().err
    with pytest.raises(RunFolderError, match=r"start differ"):
        train_policy(POINTGOAL, tmp_path, SMALL, workers=1, progress=False, scenes=[scene])


def test_policies_are_not_mistaken_for_each_other(weights):
    exploring = weights.with_name("exploring.safetensors")
    save_weights(exploring, GoalNetwork(), {"network": {"kind": "compact"}})
    with pytest.raises(DataError, match="does not explore"):
        load_policy(weights)
    with pytest.raises(DataError, match="not a PointGoal policy"):
        load_goal_policy(exploring)
