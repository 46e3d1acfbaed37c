"""``evaluate``: every task of the protocol for one field in one scene. A task that fails gives rows that say so."""

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from tqdm import tqdm

from autonerf_lab.config import Preset
from autonerf_lab.config import preset as get_preset
from autonerf_lab.errors import DataError, UnknownNameError
from autonerf_lab.evaluators.ceiling import TrueField
from autonerf_lab.evaluators.field import Field
from autonerf_lab.evaluators.maps import free_scores, occupancy_scores, predict_states
from autonerf_lab.evaluators.mesh import extract_mesh
from autonerf_lab.evaluators.mesh_metrics import evaluate_mesh
from autonerf_lab.evaluators.nearest_view import NearestView
from autonerf_lab.evaluators.planning import evaluate_planning, scene_tasks
from autonerf_lab.evaluators.pose_refinement import Refinement, evaluate_pose_refinement
from autonerf_lab.evaluators.rendering import evaluate_rendering, sample_test_poses
from autonerf_lab.evaluators.result import TaskResult
from autonerf_lab.evaluators.scores import Scores
from autonerf_lab.evaluators.semantic_maps import point_cloud, semantic_columns, semantic_scores
from autonerf_lab.evaluators.truth import TrueMap, true_map
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.types import Score

if TYPE_CHECKING:
    from autonerf_lab.scenes.scene import Scene
    from autonerf_lab.simulator import Simulator
    from autonerf_lab.trajectory import Trajectory

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


class _Run:
    """What the tasks of one evaluation share."""

    def __init__(self, field: Field, scene: "Scene", preset: Preset, seed: int, tick: Callable[[], Any]) -> None:
        self.field, self.scene, self.preset, self.seed, self.tick = field, scene, preset, seed, tick

    @cached_property
    def sim(self) -> "Simulator":
        from autonerf_lab.simulator import Simulator

        camera = Intrinsics.from_fov(self.preset.width, self.preset.height)
        return Simulator(self.scene, camera, supersample=self.preset.supersample)

    @cached_property
    def truth(self) -> TrueMap:
        return true_map(self.sim)

    @cached_property
    def states(self) -> np.ndarray:
        return predict_states(self.field, self.truth.grid)

    @cached_property
    def labels(self) -> np.ndarray:
        return semantic_columns(*point_cloud(self.field), self.truth.grid)

    def rendering(self) -> TaskResult:
        poses = sample_test_poses(self.sim, self.preset.test_poses, self.seed)
        return evaluate_rendering(self.field, self.sim, poses, self.tick)

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
        settings = Refinement(self.preset.refine_iterations, self.preset.refine_rays)
        return evaluate_pose_refinement(self.field, poses, targets, self.sim.intrinsics, settings, self.seed, self.tick)

    def mesh(self) -> TaskResult:
        field = self.field
        mesh = field.mesh() if isinstance(field, TrueField) else extract_mesh(field, self.preset.mesh_voxel)
        return evaluate_mesh(mesh, field, self.scene, self.seed)


def _check_scene(field: Field, scene: "Scene") -> None:
    name = field.meta.get("scene")
    if name and name != scene.name:
        raise DataError(
            f"this field shows scene {name!r}, not {scene.name!r}; evaluate it in the scene it was trained in"
        )


def evaluate(
    nerf: Field,
    scene: "Scene",
    preset: str | Preset | None = None,
    seed: int = 0,
    tasks: Iterable[str] | None = None,
    progress: bool = True,
    trajectory: "Trajectory | None" = None,
) -> Scores:
    """Score a field in its scene.

    Args:
        nerf: a trained NeRF, or anything that answers the methods of :class:`~autonerf_lab.evaluators.Field`.
        scene: the truth; the one the field was trained in.
        preset: sizes of the tasks.
        seed: of test poses, planning episodes, random pixels and mesh samples.
        tasks: names out of ``METRICS``; all without.
        progress: show a bar.
        trajectory: the walk. When given, ``scores.yardsticks["nearest_view"]`` says what showing its nearest image
            instead of a rendering would score.

    Returns:
        One row a metric, in the order of the protocol. A value that cannot be computed is None and its ``status`` says
        why; a task that fails does so alone. ``scores.artifacts`` holds the raw material of the pictures by task.

    Raises:
        UnknownNameError: a task or preset that does not exist.
        DataError: the field shows another scene.
    """
    size = get_preset(preset)
    names = list(METRICS) if tasks is None else list(tasks)
    for name in names:
        if name not in METRICS:
            raise UnknownNameError("task", name, METRICS)
    _check_scene(nerf, scene)
    steps = {"rendering": size.test_poses, "pose_refinement": size.refine_iterations}
    scores = Scores()
    with tqdm(total=sum(steps.get(name, 1) for name in names), disable=not progress, leave=False) as bar:
        run = _Run(nerf, scene, size, seed, bar.update)
        for name in names:
            bar.set_description(name.replace("_", " "))
            scores.extend(_run_task(run, name, scores.artifacts))
            if name not in steps:
                bar.update()
    if trajectory is not None and "rendering" in names:
        nearest: Any = NearestView(trajectory)  # it renders, and this task asks nothing else
        scores.yardsticks["nearest_view"] = evaluate(nearest, scene, size, seed, ["rendering"], False)
    return scores


def ceiling(
    scene: "Scene", preset: str | Preset | None = None, seed: int = 0, tasks: Iterable[str] | None = None
) -> Scores:
    """What the true geometry scores in the same tasks: no field can be expected to do better."""
    size = get_preset(preset)
    from autonerf_lab.simulator import Simulator

    sim = Simulator(scene, Intrinsics.from_fov(size.width, size.height), supersample=size.supersample)
    return evaluate(TrueField(scene, sim), scene, size, seed, tasks, progress=False)


def _run_task(run: _Run, name: str, artifacts: dict[str, Any]) -> list[Score]:
    start = time.perf_counter()
    try:
        result: TaskResult = getattr(run, name)()
    except Exception as error:  # a grid of runs must survive one odd field: the row carries the reason
        text = f"failed: {type(error).__name__}: {error}"
        result = TaskResult(dict.fromkeys(METRICS[name]), {}, dict.fromkeys(METRICS[name], text))
    seconds = time.perf_counter() - start
    artifacts[name] = result.artifact
    meta = run.field.meta
    rows = []
    for metric, unit in METRICS[name].items():
        value, status = result.values[metric], result.status.get(metric, "ok")
        if value is not None and not math.isfinite(value):
            value, status = None, f"not finite: {value}"
        rows.append(
            Score(
                task=name,
                metric=metric,
                value=value,
                unit=unit,
                status=status,
                n=result.n.get(metric, 0),
                seconds=seconds,
                scene=run.scene.name,
                start=int(meta.get("start") or 0),
                policy=str(meta.get("policy") or ""),
                reward=str(meta.get("reward") or ""),
                model=str(meta.get("model") or ""),
                preset=run.preset.name,
                seed=run.seed,
            )
        )
    return rows
