"""Registry of the tasks, and the function that runs one and returns its rows."""

import math
import time
from collections.abc import Iterable, Mapping
from typing import Any

from autonerf_lab.evaluators.conformance import check_task
from autonerf_lab.evaluators.context import EvaluationContext
from autonerf_lab.evaluators.finetuning import FinetuningTask
from autonerf_lab.evaluators.mesh_metrics import MeshTask
from autonerf_lab.evaluators.metrics import METRICS, Metric
from autonerf_lab.evaluators.navigation import NavigationTask
from autonerf_lab.evaluators.planning import PlanningTask
from autonerf_lab.evaluators.pose_refinement import PoseRefinementTask
from autonerf_lab.evaluators.rendering import RenderingTask
from autonerf_lab.evaluators.segmentation import SegmentationTask
from autonerf_lab.evaluators.semantic_maps import MapsTask
from autonerf_lab.evaluators.task import Task, TaskResult, failure
from autonerf_lab.evaluators.trajectory import TrajectoryTask
from autonerf_lab.segmentation import TRUE
from autonerf_lab.types import Score
from autonerf_lab.utils.plugins import load_plugins

TASKS: dict[str, Task] = {
    "rendering": RenderingTask(),
    "maps": MapsTask(),
    "planning": PlanningTask(),
    "pose_refinement": PoseRefinementTask(),
    "mesh": MeshTask(),
    "navigation": NavigationTask(),
    "finetuning": FinetuningTask(),
    "trajectory": TrajectoryTask(),
    "segmentation": SegmentationTask(),
}
# Names of the built-in tasks that run for every field, in the order of the protocol.
DEFAULT_TASKS = tuple(name for name, task in TASKS.items() if not task.optional)


def default_tasks(meta: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the tasks that run by default for a field with this metadata.

    They are ``DEFAULT_TASKS``, ``trajectory`` if the field was trained on poses that are not the true ones, and
    ``segmentation`` if it was trained on predicted labels.

    Example:
        >>> default_tasks({}) == DEFAULT_TASKS, default_tasks({"pose_source": "estimated"})[-1]
        (True, 'trajectory')
        >>> default_tasks({"semantics": "predicted"})[-1]
        'segmentation'
    """
    poses = () if meta.get("pose_source", "true") == "true" else ("trajectory",)
    return (*DEFAULT_TASKS, *poses, *(() if meta.get("semantics", TRUE) == TRUE else ("segmentation",)))


def available() -> dict[str, Task]:
    """Built-in tasks and those of installed packages, by name.

    A plug-in that cannot be imported, fails :func:`~autonerf_lab.evaluators.conformance.check_task` or takes a
    built-in name is left out with a :class:`~autonerf_lab.utils.plugins.PluginWarning`.
    """
    found = load_plugins("evaluators", TASKS, Task, check_task)
    return {task.name: task for task in found.values()} | TASKS


def optional_tasks() -> dict[str, Task]:
    """Tasks that run only if they are named: long ones, and those of installed packages."""
    return {name: task for name, task in available().items() if name not in DEFAULT_TASKS}


def metric_of(row: Score) -> Metric:
    """Return the metric of a row; a generic one if no task has it.

    Example:
        >>> metric_of(Score("rendering", "psnr", 20.0)).label
        'PSNR'
    """
    key = (row.task, row.metric)
    if key in METRICS:
        return METRICS[key]
    task = None if row.task in TASKS else available().get(row.task)
    known = {metric.key: metric for metric in task.metrics} if task else {}
    return known.get(key) or Metric(row.task, row.metric, row.unit, row.metric.replace("_", " "), 0, 3)


def run_task(context: EvaluationContext, task: Task) -> tuple[list[Score], TaskResult]:
    """Run a task. If it fails, its rows have no value and give the reason.

    Returns:
        The rows of the task, and its result.

    Raises:
        Exception: memory or disk is full, see :func:`~autonerf_lab.evaluators.task.failure`.
    """
    start = time.perf_counter()
    try:
        result = task.run(context)
        lacking = [metric.name for metric in task.metrics if metric.name not in result.values]
        if lacking:
            raise ValueError(f"task {task.name!r} returned no value for {', '.join(lacking)}")
    except Exception as error:  # one bad field must not stop a grid: its rows give the reason
        names = [metric.name for metric in task.metrics]
        result = TaskResult(dict.fromkeys(names), {}, dict.fromkeys(names, failure(error)))
    seconds = time.perf_counter() - start
    common = {"scene": context.scene.name, "preset": context.preset.label, "seed": context.seed}
    return rows_of(task.name, task.metrics, result, context.field.meta, {"seconds": seconds, **common}), result


def rows_of(
    task: str, metrics: Iterable[Metric], result: TaskResult, meta: dict[str, Any], common: dict[str, Any]
) -> list[Score]:
    """Return one score for each metric.

    Args:
        task: name in the rows.
        metrics: in the order of the rows.
        result: values and statuses.
        meta: of the field: policy, reward, model, start.
        common: fields of :class:`~autonerf_lab.types.Score` that are the same in all rows.
    """
    rows = []
    for metric in metrics:
        value, status = result.values[metric.name], result.status.get(metric.name, "ok")
        if value is not None and not math.isfinite(value):
            value, status = None, f"not finite: {value}"
        rows.append(
            Score(
                task=task,
                metric=metric.name,
                value=value,
                unit=metric.unit,
                status=status,
                n=result.n.get(metric.name, 0),
                start=int(meta.get("start") or 0),
                policy=str(meta.get("policy") or ""),
                reward=str(meta.get("reward") or ""),
                model=str(meta.get("model") or ""),
                **common,
            )
        )
    return rows
