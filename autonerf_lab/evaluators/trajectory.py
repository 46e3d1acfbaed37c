"""Task 8, trajectory error: training poses against the true poses of the robot.

The errors are those of :func:`autonerf_lab.localization.trajectory_alignment.trajectory_errors`. The task runs by
itself if a field was trained on other poses than the true ones.
"""

from typing import TYPE_CHECKING

from autonerf_lab.evaluators.field_alignment import AlignedField, true_poses
from autonerf_lab.evaluators.metrics import metrics_of
from autonerf_lab.evaluators.task import Task, TaskFigure, TaskResult
from autonerf_lab.localization.se2 import to_planar
from autonerf_lab.localization.trajectory_alignment import align, trajectory_errors

if TYPE_CHECKING:
    from autonerf_lab.evaluators.context import EvaluationContext


class TrajectoryTask(Task):
    """Error of the training poses."""

    name = "trajectory"
    metrics = metrics_of("trajectory")
    title = "Trajectory error"
    text = (
        "The field was trained on poses that are not the true ones, so its coordinate frame differs from that of the "
        "apartment. For all scores of this report, the field was first aligned with the apartment by one planar rigid "
        "motion: the one that fits the training poses best to the true ones. The errors below remain after it."
    )
    figures = (
        TaskFigure(
            "drift",
            "trajectory_drift",
            "True path and training poses",
            "Left: the true path, and the training poses after alignment. Right: distance and heading error of "
            "each step.",
            "The true path and the path of the training poses from above, beside curves of their errors over the steps",
        ),
    )
    optional = True

    def run(self, context: "EvaluationContext") -> TaskResult:
        """Compare the training poses with the true ones."""
        field = context.field
        names = [metric.name for metric in self.metrics]
        source = str(field.meta.get("pose_source", "true"))
        if source == "true":
            return TaskResult(dict.fromkeys(names), {}, dict.fromkeys(names, "the training poses are the true ones"))
        poses = (field.field if isinstance(field, AlignedField) else field).poses  # before alignment
        estimated, true = to_planar(poses), true_poses(field.meta, len(poses))
        errors = trajectory_errors(estimated, true)
        values: dict[str, float | None] = {
            "ate_m": errors.ate_m,
            "ate_unaligned_m": errors.ate_unaligned_m,
            "heading_error_deg": errors.heading_error_deg,
            "error_per_metre": 100 * errors.error_per_metre,
            "error_per_degree": 100 * errors.error_per_degree,
        }
        x, y, heading = (round(float(value), 6) for value in align(estimated, true))
        return TaskResult(
            values,
            dict.fromkeys(values, len(true)),
            artifact={"true": true, "errors": errors, "source": source},
            details={"pose_source": source, "alignment": {"x_m": x, "y_m": y, "heading_rad": heading}},
        )
