"""Task 7, fine-tuning: training a policy in the reconstruction, for use in the true scene.

The task follows section 5.2 of the paper, "Autonomous adaptation to a new scene". A PointGoal policy observes depth and
the direction of the goal. It was pre-trained in the training apartments; its weights are part of the package. PPO
fine-tunes it in the mesh of the field, with the floor of task 6, and, as an upper bound, in the true scene. All three
policies run the same episodes in the true scene (64 x 64 pixels, at most 500 actions). An episode succeeds if the robot
stops within 0.36 m of the goal. ``SPL = mean of S l / max(p, l)`` with success S, path length p and shortest path
length l. If one of the three stages fails, the others still have scores.

The paper fine-tunes for ten million frames, with a learning rate of 2.5e-6 in the mesh and ten times that in the true
scene. The preset ``paper`` does the same. ``fast`` has a fortieth of the frames, and learning rates of 2.5e-5 and 1e-4.
Frames, hours and learning rates are saved with the scores (``scores.details``).
"""

import hashlib
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from autonerf_lab.errors import DataError
from autonerf_lab.evaluators.metrics import FINETUNING_STAGES, metrics_of
from autonerf_lab.evaluators.navigation import mesh_scene
from autonerf_lab.evaluators.task import Task, TaskFigure, TaskResult, failure
from autonerf_lab.policies import WEIGHTS, weights_sha256
from autonerf_lab.scenes.scene import Scene
from autonerf_lab.simulator.navigation import build_navigation

if TYPE_CHECKING:
    import trimesh

    from autonerf_lab.evaluators.context import EvaluationContext

PRETRAINED = WEIGHTS / "pointgoal" / "pretrained.safetensors"  # by `autonerf-lab train-policy --policy pointgoal`
_NAMES = tuple(metric.name for metric in metrics_of("finetuning"))


def evaluate_finetuning(
    mesh: "trimesh.Trimesh",
    scene: Scene,
    frames: int,
    count: int,
    seed: int = 0,
    folder: str | Path | None = None,
    rates: Mapping[str, float] | None = None,
) -> TaskResult:
    """Fine-tune in a reconstruction and in its scene, and run all policies in the scene.

    Args:
        mesh: world frame, metres.
        scene: the ground truth.
        frames: number of frames of each of the two trainings.
        count: number of episodes of each of the three policies.
        seed: random seed of trainings and episodes.
        folder: folder of the training checkpoints; interrupted trainings continue there. Default: a temporary folder.
        rates: learning rates of ``finetuned`` and ``finetuned_true_mesh``; default: 1e-4.
    """
    from autonerf_lab.evaluators.goal_policy import load_goal_policy, reach_goals  # imports torch
    from autonerf_lab.policies.weights import read_meta

    if folder is None:
        with tempfile.TemporaryDirectory() as made:
            return evaluate_finetuning(mesh, scene, frames, count, seed, made, rates)
    values: dict[str, float | None] = dict.fromkeys(_NAMES)
    artifact: dict[str, Any] = {}
    details: dict[str, Any] = {}
    status: dict[str, str] = {}  # by stage
    scenes = {"finetuned_true_mesh": scene}
    try:
        scenes["finetuned"] = mesh_scene(mesh)
        build_navigation(
            scenes["finetuned"]
        )  # fail now, not after hours of training, if the robot does not fit anywhere
    except DataError as error:
        failure(error)
        status["finetuned"] = f"not walkable: {error}"
    for stage in FINETUNING_STAGES:
        if stage in status:
            continue
        rate = (rates or {}).get(stage, 1e-4) if stage in scenes else None
        try:
            weights = _finetune(scenes[stage], frames, rate, seed, Path(folder) / stage) if rate else PRETRAINED
            episodes = reach_goals(load_goal_policy(weights), scene, count, seed)
        except Exception as error:  # the other stages keep their scores
            status[stage] = failure(error)
            continue
        values[f"success_{stage}"] = 100 * float(np.mean([episode["success"] for episode in episodes]))
        values[f"spl_{stage}"] = 100 * float(np.mean([episode["spl"] for episode in episodes]))
        meta = read_meta(weights)
        details[stage] = {"frames": meta["frames"], "hours": meta["hours"], "learning_rate": rate}
        artifact[stage] = {"episodes": episodes, **{key: meta[key] for key in ("frames", "hours", "curve")}}
    statuses = {name: status[stage] for name in _NAMES if (stage := name.partition("_")[2]) in status}
    return TaskResult(values, {name: 0 if name in statuses else count for name in _NAMES}, statuses, artifact, details)


def _finetune(scene: Scene, frames: int, rate: float, seed: int, folder: Path) -> Path:
    # Imported here because torch and stable-baselines3 take seconds to import.
    import torch

    from autonerf_lab.training.settings import POINTGOAL, settings_of
    from autonerf_lab.training.train import train_policy

    settings = settings_of(POINTGOAL, seed=seed, frames=frames, lr=rate)
    # Another mesh, budget or start is another training, also in the same folder.
    training = f"{scene.sha256} {frames} {rate} {seed} {weights_sha256(str(PRETRAINED))}"
    folder = folder / hashlib.sha256(training.encode()).hexdigest()[:12]
    workers = torch.get_num_threads()  # number of threads of this process
    return train_policy(POINTGOAL, folder, settings, None, workers, False, scenes=[scene], start=PRETRAINED)


class FinetuningTask(Task):
    """Task 7: fine-tuning in the mesh."""

    name, metrics, title = "finetuning", metrics_of("finetuning"), "Fine-tuning in the mesh"
    optional = True
    text = (
        "A pre-trained PointGoal policy, which observes depth only, is fine-tuned in the reconstructed mesh and, as an "
        "upper bound, in the true scene. All policies are then evaluated in the true scene."
    )
    figures = (
        TaskFigure(
            "finetuning",
            "finetuning_results",
            title="Success during and after fine-tuning",
            caption="Left: success rate during the training, each policy in its own scene. Right: success rate and "
            "SPL of all policies in the true scene.",
            alt="Curves of the success rate over training frames, and bars of success rate and SPL in the true scene",
        ),
    )

    def run(self, context: "EvaluationContext") -> TaskResult:
        """Fine-tune with the settings of the preset."""
        preset = context.preset
        rates = {"finetuned": preset.finetuning_lr, "finetuned_true_mesh": preset.finetuning_lr_true_mesh}
        frames, episodes = preset.finetuning_frames, preset.finetuning_episodes
        return evaluate_finetuning(
            context.surface_with_floor, context.scene, frames, episodes, context.seed, context.checkpoint, rates
        )
