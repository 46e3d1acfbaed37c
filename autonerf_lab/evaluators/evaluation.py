"""``evaluate``: every task of the protocol for one field in one scene. A task that fails gives rows that say so.

A field of photographs, of which no truth is known, is scored on those that it was not trained on.
"""

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from tqdm import tqdm

from autonerf_lab.config import Preset
from autonerf_lab.config import preset as get_preset
from autonerf_lab.dataset import Dataset
from autonerf_lab.errors import DataError, UnknownNameError
from autonerf_lab.evaluators.ceiling import TrueField
from autonerf_lab.evaluators.field import Field
from autonerf_lab.evaluators.lpips import Lpips
from autonerf_lab.evaluators.maps import free_scores, occupancy_scores, predict_states
from autonerf_lab.evaluators.mesh import extract_mesh
from autonerf_lab.evaluators.mesh_metrics import evaluate_mesh
from autonerf_lab.evaluators.nearest_view import NearestView
from autonerf_lab.evaluators.planning import evaluate_planning, scene_tasks
from autonerf_lab.evaluators.pose_refinement import Refinement, evaluate_pose_refinement
from autonerf_lab.evaluators.rendering import (
    evaluate_rendering,
    photographed_views,
    sample_test_poses,
    simulated_views,
)
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

    def __init__(
        self, field: Field, scene: "Scene", preset: Preset, seed: int, tick: Callable[[], Any], lpips: Lpips | None
    ) -> None:
        self.field, self.scene, self.preset, self.seed, self.tick, self.lpips = field, scene, preset, seed, tick, lpips

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
        return evaluate_rendering(self.field, simulated_views(self.sim, poses), self.tick, self.lpips)

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
    scene: "Scene | Dataset",
    preset: str | Preset | None = None,
    seed: int = 0,
    tasks: Iterable[str] | None = None,
    progress: bool = True,
    trajectory: "Trajectory | Dataset | None" = None,
    lpips_weights: "str | Path | Lpips | None" = None,
) -> Scores:
    """Score a field in its scene, or on photographs that were held out.

    Args:
        nerf: a trained NeRF, or anything that answers the methods of :class:`~autonerf_lab.evaluators.Field`.
        scene: the truth; the one the field was trained in. Or the held-out half of :meth:`Dataset.split`: the task is
            ``held_out`` then, the only one, with PSNR, SSIM, LPIPS and FLIP, and where there are labels, accuracy and
            IoU of the classes, means over the photographs; ``preset`` and ``seed`` do not matter.
        preset: sizes of the tasks.
        seed: of test poses, planning episodes, random pixels and mesh samples.
        tasks: names out of ``METRICS``; all without.
        progress: show a bar.
        trajectory: what the field was trained on. When given, ``scores.yardsticks["nearest_view"]`` says what showing
            its nearest image instead of a rendering would score.
        lpips_weights: the file of :mod:`autonerf_lab.evaluators.lpips`, or an ``Lpips`` that has read (and checked)
            it; ``scores.weights["lpips"]`` keeps its SHA-256. Without, LPIPS has no value (of photographs: no row).

    Returns:
        One row a metric, in the order of the protocol. A value that cannot be computed is None and its ``status`` says
        why; a task that fails does so alone. ``scores.artifacts`` holds the raw material of the pictures by task, and
        the values of each photograph: ``scores.artifacts["held_out"]["psnr"]``, in the order of its ``"names"``.

    Raises:
        UnknownNameError: a task or preset that does not exist.
        DataError: the field shows another scene; tasks that need the truth, where there are only photographs; the
            file of ``lpips_weights`` is missing or not as it should be.

    Example::

        train, held_out = lab.load_dataset("photographs").split()
        print(lab.evaluate(lab.fit(train), held_out, trajectory=train).table())
    """
    lpips = Lpips(lpips_weights) if isinstance(lpips_weights, str | Path) else lpips_weights
    if isinstance(scene, Dataset):
        if tasks is not None:
            raise DataError("photographs hold no truth for tasks: leave tasks out, or give the scene")
        return _held_out(nerf, scene, progress, trajectory, lpips)
    size = get_preset(preset)
    names = list(METRICS) if tasks is None else list(tasks)
    for name in names:
        if name not in METRICS:
            raise UnknownNameError("task", name, METRICS)
    _check_scene(nerf, scene)
    steps = {"rendering": size.test_poses, "pose_refinement": size.refine_iterations}
    scores = Scores()
    scores.weights = _weights(lpips)
    with tqdm(total=sum(steps.get(name, 1) for name in names), disable=not progress, leave=False) as bar:
        run = _Run(nerf, scene, size, seed, bar.update, lpips)
        for name in names:
            bar.set_description(name.replace("_", " "))
            scores.extend(_run_task(run, name, scores.artifacts))
            if name not in steps:
                bar.update()
    if trajectory is not None and "rendering" in names:
        nearest: Any = NearestView(trajectory)  # it renders, and this task asks nothing else
        scores.yardsticks["nearest_view"] = evaluate(
            nearest, scene, size, seed, ["rendering"], False, lpips_weights=lpips
        )
    return scores


def ceiling(
    scene: "Scene",
    preset: str | Preset | None = None,
    seed: int = 0,
    tasks: Iterable[str] | None = None,
    lpips_weights: "str | Path | Lpips | None" = None,
) -> Scores:
    """What the true geometry scores in the same tasks: no field can be expected to do better."""
    size = get_preset(preset)
    from autonerf_lab.simulator import Simulator

    sim = Simulator(scene, Intrinsics.from_fov(size.width, size.height), supersample=size.supersample)
    return evaluate(TrueField(scene, sim), scene, size, seed, tasks, False, lpips_weights=lpips_weights)


def _run_task(run: _Run, name: str, artifacts: dict[str, Any]) -> list[Score]:
    start = time.perf_counter()
    try:
        result: TaskResult = getattr(run, name)()
    except Exception as error:  # a grid of runs must survive one odd field: the row carries the reason
        text = f"failed: {type(error).__name__}: {error}"
        result = TaskResult(dict.fromkeys(METRICS[name]), {}, dict.fromkeys(METRICS[name], text))
    seconds = time.perf_counter() - start
    artifacts[name] = result.artifact
    where = {"scene": run.scene.name, "preset": run.preset.name, "seed": run.seed}
    return _rows(name, METRICS[name], result, run.field.meta, {"seconds": seconds, **where})


def _weights(lpips: Lpips | None) -> dict[str, str]:
    return {"lpips": lpips.sha256} if lpips else {}


def _held_out(
    nerf: Field, data: Dataset, progress: bool, trained_on: "Trajectory | Dataset | None", lpips: Lpips | None
) -> Scores:
    start = time.perf_counter()
    with tqdm(total=len(data), disable=not progress, leave=False, desc="held out") as bar:
        result = evaluate_rendering(nerf, photographed_views(data), bar.update, lpips)
    seconds = time.perf_counter() - start
    classes = () if result.status.get("miou") == "no labels" else ("per_class_accuracy", "miou")
    names = ("psnr", "ssim", *(("lpips",) if lpips else ()), "flip", *classes)
    units = {name: METRICS["rendering"][name] for name in names}
    where = {key: nerf.meta.get(key) or default for key, default in (("scene", ""), ("preset", ""), ("seed", 0))}
    scores = Scores(
        _rows("held_out", units, result, nerf.meta, {"seconds": seconds, **where}),
        {"held_out": {**result.artifact, "names": data.names}},
    )
    scores.weights = _weights(lpips)
    if trained_on is not None:
        nearest: Any = NearestView(trained_on)
        scores.yardsticks["nearest_view"] = _held_out(nearest, data, False, None, lpips)
    return scores


def _rows(
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
