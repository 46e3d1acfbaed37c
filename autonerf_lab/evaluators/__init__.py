"""Evaluation of radiance fields: the tasks of the benchmark protocol, one module per task."""

from autonerf_lab.evaluators.evaluation import evaluate, oracle_scores, upstream_scores
from autonerf_lab.evaluators.mesh import export_mesh, extract_mesh, semantic_mesh
from autonerf_lab.evaluators.metrics import METRICS, Metric
from autonerf_lab.evaluators.nearest_view import NearestView
from autonerf_lab.evaluators.oracle import TrueField
from autonerf_lab.evaluators.radiance_field import RadianceField
from autonerf_lab.evaluators.scores import Scores
from autonerf_lab.evaluators.task import Task, TaskFigure, TaskResult
from autonerf_lab.evaluators.tasks import DEFAULT_TASKS, TASKS, available
from autonerf_lab.types import Rendering

__all__ = [
    "DEFAULT_TASKS",
    "METRICS",
    "TASKS",
    "Metric",
    "NearestView",
    "RadianceField",
    "Rendering",
    "Scores",
    "Task",
    "TaskFigure",
    "TaskResult",
    "TrueField",
    "available",
    "evaluate",
    "export_mesh",
    "extract_mesh",
    "oracle_scores",
    "semantic_mesh",
    "upstream_scores",
]
