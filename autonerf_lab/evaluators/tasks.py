"""The tasks of the protocol, one method each, and their rows. A task that fails gives rows that say so."""

import math
import time
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from autonerf_lab.config import Preset
from autonerf_lab.evaluators import finetuning
from autonerf_lab.evaluators.ground_truth import TrueMap, true_map
from autonerf_lab.evaluators.lpips import Lpips
from autonerf_lab.evaluators.maps import free_scores, occupancy_scores, predict_states
from autonerf_lab.evaluators.mesh import extract_mesh
from autonerf_lab.evaluators.mesh_metrics import evaluate_mesh
from autonerf_lab.evaluators.navigation import evaluate_navigation, lay_floor
from autonerf_lab.evaluators.oracle import TrueField
from autonerf_lab.evaluators.planning import evaluate_planning, scene_tasks
from autonerf_lab.evaluators.pose_refinement import Refinement, evaluate_pose_refinement
from autonerf_lab.evaluators.radiance_field import Field
from autonerf_lab.evaluators.rendering import evaluate_rendering, sample_test_poses, simulated_views
from autonerf_lab.evaluators.semantic_maps import point_cloud, semantic_columns, semantic_scores
from autonerf_lab.evaluators.task_result import TaskResult, failure
from autonerf_lab.geometry import planar_from_pose
from autonerf_lab.types import Score

if TYPE_CHECKING:
    import trimesh

    from autonerf_lab.scenes.scene import Scene
    from autonerf_lab.simulator import Simulator

METRICS: dict[str, dict[str, str]] = {  # task -> metric -> unit
    "rendering": {
        "psnr": "dB",
        "ssim": "",
        "lpips": "",
        "flip": "",
        "per_class_accuracy": "%",
        "miou": "%",
        "miou_objects": "%",
        "depth_median_error_m": "m",
    },
    "maps": {
        "free_accuracy": "%",
        "free_precision": "%",
        "free_recall": "%",
        "occupancy_precision": "%",
        "occupancy_recall": "%",
        "semantic_accuracy": "%",
        "semantic_precision": "%",
        "semantic_recall": "%",
        "semantic_precision_5cm": "%",
        "semantic_recall_5cm": "%",
    },
    "planning": {"pointgoal_success": "%", "pointgoal_spl": "%", "objectgoal_success": "%", "objectgoal_spl": "%"},
    "pose_refinement": {
        "convergence_rate": "%",
        "rotation_convergence_rate": "%",
        "translation_convergence_rate": "%",
        "rotation_error_deg": "deg",
        "translation_error_m": "m",
    },
    "mesh": {
        "accuracy_m": "m",
        "completion_m": "m",
        "completion_ratio": "%",
        "normal_consistency": "",
        "completion_m_all": "m",
        "completion_ratio_all": "%",
        "normal_consistency_all": "",
    },
}

OPTIONAL: dict[str, dict[str, str]] = {  # tasks that take long: only by name
    "navigation": {"success": "%", "spl": "%", "success_true_mesh": "%", "spl_true_mesh": "%"},
    "finetuning": dict.fromkeys(finetuning.METRICS, "%"),
}


class Run:
    """What the tasks of one evaluation share: a method each."""

    metrics: ClassVar = METRICS | OPTIONAL

    def __init__(
        self,
        field: Field,
        scene: "Scene",
        preset: Preset,
        seed: int,
        tick: Callable[[], Any],
        lpips: Lpips | None,
        keep: str | Path | None = None,
    ) -> None:
        self.field, self.scene, self.preset, self.seed, self.tick, self.lpips = field, scene, preset, seed, tick, lpips
        self.keep = keep

    @cached_property
    def sim(self) -> "Simulator":
        from autonerf_lab.simulator import Simulator

        return Simulator.of_preset(self.scene, self.preset)

    @cached_property
    def truth(self) -> TrueMap:
        return true_map(self.sim)

    @cached_property
    def states(self) -> np.ndarray:
        return predict_states(self.field, self.truth.grid)

    @cached_property
    def labels(self) -> np.ndarray:
        return semantic_columns(*point_cloud(self.field), self.truth.grid)

    @cached_property
    def surface(self) -> "trimesh.Trimesh":
        field = self.field
        return field.mesh() if isinstance(field, TrueField) else extract_mesh(field, self.preset.mesh_voxel)

    @cached_property
    def walkable(self) -> "trimesh.Trimesh":
        return lay_floor(self.surface, self.field)

    def rendering(self) -> TaskResult:
        poses = sample_test_poses(self.sim, self.preset.test_poses, self.seed)
        result = evaluate_rendering(self.field, simulated_views(self.sim, poses), self.tick, self.lpips)
        # the first of them are those of pose refinement
        return replace(result, details={"test_poses_x_y_heading": [planar_from_pose(c2w) for c2w in poses]})

    def maps(self) -> TaskResult:
        values = free_scores(self.states, self.truth) | occupancy_scores(self.states, self.truth)
        values |= semantic_scores(self.labels, self.truth)
        missing = {"semantic": "no object in the scene"}
        status = {
            name: missing.get(name.split("_")[0], "no such cell") for name, value in values.items() if value is None
        }
        artifact = {"states": self.states, "labels": self.labels, "truth": self.truth}
        return TaskResult(values, dict.fromkeys(values, int(self.truth.scored.sum())), status, artifact)

    def planning(self) -> TaskResult:
        tasks = scene_tasks(self.truth, self.preset.planning_starts, self.seed)
        result = evaluate_planning(self.states, self.labels, self.truth, tasks)
        return replace(result, artifact=result.artifact | {"truth": self.truth, "tasks": tasks})

    def pose_refinement(self) -> TaskResult:
        poses = sample_test_poses(self.sim, self.preset.refine_poses, self.seed)
        targets = np.stack([self.sim.render(c2w).rgb for c2w in poses])
        size = self.preset
        settings = Refinement(size.refine_iterations, size.refine_rays, interest=size.refine_interest)
        return evaluate_pose_refinement(self.field, poses, targets, self.sim.intrinsics, settings, self.seed, self.tick)

    def mesh(self) -> TaskResult:
        return evaluate_mesh(self.surface, self.field, self.scene, self.seed)

    def navigation(self) -> TaskResult:
        return evaluate_navigation(self.walkable, self.scene, self.preset.planning_starts, self.seed)

    def finetuning(self) -> TaskResult:
        size = self.preset
        rates = {"finetuned": size.finetuning_lr, "finetuned_true_mesh": size.finetuning_lr_true_mesh}
        frames, episodes = size.finetuning_frames, size.finetuning_episodes
        return finetuning.evaluate_finetuning(self.walkable, self.scene, frames, episodes, self.seed, self.keep, rates)


def run_task(run: Run, name: str) -> tuple[list[Score], TaskResult]:
    """The rows of a task, and what it handed back.

    Raises:
        Exception: memory or the disk is full, see :func:`~autonerf_lab.evaluators.task_result.failure`.
    """
    start = time.perf_counter()
    try:
        result: TaskResult = getattr(run, name)()
    except Exception as error:  # a grid of runs must survive one odd field: the row carries the reason
        names = run.metrics[name]
        result = TaskResult(dict.fromkeys(names), {}, dict.fromkeys(names, failure(error)))
    seconds = time.perf_counter() - start
    where = {"scene": run.scene.name, "preset": run.preset.label, "seed": run.seed}
    return rows_of(name, run.metrics[name], result, run.field.meta, {"seconds": seconds, **where}), result


def rows_of(
    task: str, units: dict[str, str], result: TaskResult, meta: dict[str, Any], where: dict[str, Any]
) -> list[Score]:
    """A score for each of the metrics; ``where`` are those of its fields that are the same in all."""
    rows = []
    for metric, unit in units.items():
        value, status = result.values[metric], result.status.get(metric, "ok")
        if value is not None and not math.isfinite(value):
            value, status = None, f"not finite: {value}"
        rows.append(
            Score(
                task=task,
                metric=metric,
                value=value,
                unit=unit,
                status=status,
                n=result.n.get(metric, 0),
                start=int(meta.get("start") or 0),
                policy=str(meta.get("policy") or ""),
                reward=str(meta.get("reward") or ""),
                model=str(meta.get("model") or ""),
                **where,
            )
        )
    return rows
