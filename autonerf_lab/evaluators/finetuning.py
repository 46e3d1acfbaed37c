"""Task 7, fine-tuning: does practice in the reconstruction help a robot in the real apartment?

After section 5.2 of the paper, "Autonomous adaptation to a new scene". A PointGoal policy sees depth and where the goal
lies. It was trained in the training apartments, and its weights ship. PPO goes on with it in the mesh of the field, the
floor laid as for task 6, and, as a bound that a real robot could not have, in the true scene. All three walk the same
episodes in the true scene (64 x 64 pixels, at most 500 actions): success S is to stop within 0.36 m of the goal,
``SPL = mean of S l / max(p, l)`` with p the way that was walked and l the shortest. Each of the three is judged alone:
one that fails takes nothing from the others.

The paper fine-tuned for ten million frames, at a learning rate of 2.5e-6 in the mesh and ten times that in the true
scene. So does the preset ``paper``; ``fast`` has a tenth of the frames, and larger steps: 1e-4. Frames, hours and
learning rates are kept with the scores (``scores.details``).
"""

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from autonerf_lab.envs.pointgoal import PointGoalEnv
from autonerf_lab.errors import DataError
from autonerf_lab.evaluators.navigation import mesh_scene
from autonerf_lab.evaluators.scores import FINETUNED
from autonerf_lab.evaluators.task_result import TaskResult, failure
from autonerf_lab.policies import WEIGHTS
from autonerf_lab.policies.networks import RecurrentNetwork, batched, draw, make_network
from autonerf_lab.policies.weights import load_weights, read_meta
from autonerf_lab.scenes.scene import Scene
from autonerf_lab.simulator.navigation import build_navigation

if TYPE_CHECKING:
    import trimesh

PRETRAINED = WEIGHTS / "pointgoal" / "pretrained.safetensors"  # by `autonerf-lab train-policy --policy pointgoal`
METRICS = tuple(f"{metric}_{stage}" for stage in FINETUNED for metric in ("success", "spl"))
_AT_ONCE = 25  # episodes, so that the network looks at as many images at a time


def load_goal_policy(path: str | Path) -> RecurrentNetwork:
    """The network of a PointGoal policy.

    Raises:
        DataError: missing, damaged, or the weights of another kind of policy.
    """
    settings = read_meta(path)["network"]
    if settings["kind"] != "goal":
        raise DataError(f"{path} holds a policy that explores, not one that goes to a place")
    network = make_network(settings)[1]
    assert isinstance(network, RecurrentNetwork)
    load_weights(path, network)
    return network.eval()


def reach_goals(network: RecurrentNetwork, scene: Scene, count: int, seed: int = 0) -> list[dict[str, Any]]:
    """Let a policy walk seeded PointGoal episodes; actions are drawn, as in training.

    Args:
        network: of the policy.
        scene: where it walks.
        count: episodes.
        seed: of starts, goals and actions.

    Returns:
        What the environment said at the end of each episode: ``success``, ``spl``, ``distance_to_goal`` (metres).
    """
    words = np.random.SeedSequence([seed, 8]).generate_state(count)
    rngs = [np.random.default_rng([seed, 9, episode]) for episode in range(count)]
    ends: list[dict[str, Any]] = [{}] * count
    for first in range(0, count, _AT_ONCE):
        live = list(range(first, min(first + _AT_ONCE, count)))
        envs = {k: PointGoalEnv(scene=scene) for k in live}
        seen = {k: env.reset(seed=int(words[k]))[0] for k, env in envs.items()}
        memory, starts = network.nothing(len(live)), torch.ones(len(live))
        while live:
            with torch.inference_mode():
                chances, _, memory = network(batched([seen[k] for k in live]), memory, starts)
            going = []
            for row, k in enumerate(live):
                seen[k], _, terminated, truncated, ends[k] = envs[k].step(draw(chances, rngs[k], row))
                if not (terminated or truncated):
                    going.append(row)
            live, starts = [live[row] for row in going], torch.zeros(len(going))
            memory = (memory[0][:, going], memory[1][:, going])
    return ends


def evaluate_finetuning(
    mesh: "trimesh.Trimesh",
    scene: Scene,
    frames: int,
    count: int,
    seed: int = 0,
    folder: str | Path | None = None,
    rates: Mapping[str, float] | None = None,
) -> TaskResult:
    """Fine-tune in a reconstruction and in the scene it shows, and walk in the scene.

    Args:
        mesh: world frame, metres.
        scene: the truth.
        frames: of each of the two trainings.
        count: episodes of each of the three policies.
        seed: of trainings and episodes.
        folder: of the trainings, which go on there after an interruption; without it they begin anew.
        rates: learning rates of ``finetuned`` and ``finetuned_true_mesh``; 1e-4 without.
    """
    if folder is None:
        with tempfile.TemporaryDirectory() as made:
            return evaluate_finetuning(mesh, scene, frames, count, seed, made, rates)
    values: dict[str, float | None] = dict.fromkeys(METRICS)
    artifact: dict[str, Any] = {}
    details: dict[str, Any] = {}
    status: dict[str, str] = {}  # by stage
    places = {"finetuned_true_mesh": scene}
    try:
        places["finetuned"] = mesh_scene(mesh)
        build_navigation(places["finetuned"])  # a floor with nowhere to stand: said now, not hours into a training
    except DataError as error:
        failure(error)
        status["finetuned"] = f"not walkable: {error}"
    for stage in FINETUNED:
        if stage in status:
            continue
        rate = (rates or {}).get(stage, 1e-4) if stage in places else None
        try:
            weights = _practise(places[stage], frames, rate, seed, Path(folder) / stage) if rate else PRETRAINED
            ends = reach_goals(load_goal_policy(weights), scene, count, seed)
        except Exception as error:  # what the others have learned in hours stays
            status[stage] = failure(error)
            continue
        values[f"success_{stage}"] = 100 * float(np.mean([end["success"] for end in ends]))
        values[f"spl_{stage}"] = 100 * float(np.mean([end["spl"] for end in ends]))
        meta = read_meta(weights)
        details[stage] = {"frames": meta["frames"], "hours": meta["hours"], "learning_rate": rate}
        artifact[stage] = {"episodes": ends, "frames": meta["frames"], "hours": meta["hours"], "curve": meta["curve"]}
    said = {name: status[stage] for name in METRICS if (stage := name.partition("_")[2]) in status}
    return TaskResult(values, {name: 0 if name in said else count for name in METRICS}, said, artifact, details)


def _practise(place: Scene, frames: int, rate: float, seed: int, folder: Path) -> Path:
    # stable-baselines3 takes seconds to import: only for those who train
    from autonerf_lab.training.settings import POINTGOAL, settings_of
    from autonerf_lab.training.train import train_policy

    settings = settings_of(POINTGOAL, seed=seed, frames=frames, lr=rate)
    workers = torch.get_num_threads()  # as many as this process may use
    return train_policy(POINTGOAL, folder, settings, None, workers, False, scenes=[place], start=PRETRAINED)
