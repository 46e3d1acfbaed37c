"""Conformance check of a task, for its tests and before a plug-in is listed."""

import json
from typing import TYPE_CHECKING

from autonerf_lab.evaluators.metrics import METRICS, Metric
from autonerf_lab.evaluators.task import Task, TaskFigure, TaskResult
from autonerf_lab.utils.plugins import require

if TYPE_CHECKING:
    from autonerf_lab.evaluators.context import EvaluationContext

INPUTS = ("artifact", "field", "scene")


def check_task(task: Task) -> None:
    """Check the description of a task: name, metrics, text and figures.

    Raises:
        AssertionError: names the rule that is broken.

    Example:
        >>> from autonerf_lab.evaluators.tasks import TASKS
        >>> check_task(TASKS["maps"])
    """
    require(isinstance(task, Task), f"a task is an instance of Task, not {type(task).__name__}")
    for attribute in ("name", "title", "text"):
        text = getattr(task, attribute, None)
        require(isinstance(text, str) and bool(text.strip()), f"{attribute} of a task must be a text, not {text!r}")
    require(isinstance(task.optional, bool), "optional of a task must be True or False")
    metrics = getattr(task, "metrics", ())
    require(bool(metrics) and all(isinstance(m, Metric) for m in metrics), "a task needs at least one Metric")
    names = [metric.name for metric in metrics]
    require(len(set(names)) == len(names), f"metrics of task {task.name!r} must have different names: {names}")
    for metric in metrics:
        require(metric.task == task.name, f"metric {metric.name!r} belongs to task {metric.task!r}, not {task.name!r}")
        require(METRICS.get(metric.key, metric) is metric, f"{metric.key} is a metric of the protocol")
        require(metric.better in (-1, 0, 1), f"better of metric {metric.name!r} must be -1, 0 or 1")
    for figure in task.figures:
        require(isinstance(figure, TaskFigure), "figures of a task must be TaskFigure objects")
        require(set(figure.inputs) <= set(INPUTS), f"inputs of figure {figure.name!r} must be among {INPUTS}")
        require(bool(figure.alt.strip()), f"figure {figure.name!r} needs an alternative text")


def check_run(task: Task, context: "EvaluationContext") -> TaskResult:
    """Run a task and check its result: a value or a status for each metric, details that JSON can hold.

    Returns:
        The result, for further checks.

    Raises:
        AssertionError: names the rule that is broken.
    """
    check_task(task)
    result = task.run(context)
    require(isinstance(result, TaskResult), f"run must return a TaskResult, not {type(result).__name__}")
    for metric in task.metrics:
        require(metric.name in result.values, f"the result lacks the metric {metric.name!r}")
        value = result.values[metric.name]
        require(value is None or isinstance(value, float), f"{metric.name!r} must be a float or None, not {value!r}")
        require(value is not None or metric.name in result.status, f"{metric.name!r} is None and needs a status")
    json.dumps(result.details)
    return result
