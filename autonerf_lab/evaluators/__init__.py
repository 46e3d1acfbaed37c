"""What is a field good for? The tasks of the benchmark protocol, one module a task."""

from autonerf_lab.evaluators.evaluation import evaluate, oracle_scores, upstream_scores
from autonerf_lab.evaluators.mesh import export_mesh, extract_mesh, semantic_mesh
from autonerf_lab.evaluators.nearest_view import NearestView
from autonerf_lab.evaluators.oracle import TrueField
from autonerf_lab.evaluators.radiance_field import Field, Image
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
    "evaluate",
    "export_mesh",
    "extract_mesh",
    "oracle_scores",
    "semantic_mesh",
    "upstream_scores",
]
