"""What is a field good for? The tasks of the benchmark protocol, one module a task."""

from autonerf_lab.evaluators.ceiling import TrueField
from autonerf_lab.evaluators.evaluation import ceiling, evaluate, upstream_scores
from autonerf_lab.evaluators.field import Field, Image
from autonerf_lab.evaluators.mesh import export_mesh, extract_mesh, semantic_mesh
from autonerf_lab.evaluators.nearest_view import NearestView
from autonerf_lab.evaluators.scores import PAPER, Scores
from autonerf_lab.evaluators.tasks import METRICS

__all__ = [
    "METRICS",
    "PAPER",
    "Field",
    "Image",
    "NearestView",
    "Scores",
    "TrueField",
    "ceiling",
    "evaluate",
    "export_mesh",
    "extract_mesh",
    "semantic_mesh",
    "upstream_scores",
]
