"""Evaluation task: RMSE of the rendered depth, by distance from the camera."""

import numpy as np
from matplotlib.figure import Figure

from autonerf_lab.evaluators import Metric, Task, TaskFigure, TaskResult
from autonerf_lab.evaluators.rendering import sample_test_poses

NAME = "depth_by_distance"
BANDS = {"near": (0.0, 2.0), "middle": (2.0, 4.0), "far": (4.0, np.inf)}  # true depth, metres


def draw_rmse(artifact):
    """Draw the RMSE of each distance band."""
    figure = Figure(figsize=(5, 3), layout="constrained")
    figure.subplots().bar(list(artifact), [100 * value for value in artifact.values()])
    figure.axes[0].set(xlabel="distance band", ylabel="RMSE of depth (cm)")
    return figure


class DepthByDistance(Task):
    """RMSE of the rendered depth at the test poses, in three bands of the true depth."""

    name = NAME
    metrics = tuple(
        Metric(NAME, f"rmse_{band}_m", "m", f"Depth RMSE, {low:g} to {high:g} m", -1, 1, 100.0)
        for band, (low, high) in BANDS.items()
    )
    title = "Depth error by distance"
    text = "The depth of the field is compared with the true depth, in three bands of distance from the camera."
    figures = (
        TaskFigure(
            "rmse",
            draw_rmse,
            title="Depth error",
            caption="Root mean square error in each band.",
            alt="Bar chart of the depth error in centimetres for near, middle and far surfaces",
        ),
    )
    optional = True

    def run(self, context):
        """Render the test poses and compare depths."""
        errors, depths = [], []
        for c2w in sample_test_poses(context.sim, context.preset.test_poses, context.seed):
            true = context.sim.render(c2w).depth
            rendered = context.field.render(c2w, context.sim.intrinsics).depth
            errors.append((rendered - true)[true > 0])
            depths.append(true[true > 0])
        error, depth = np.concatenate(errors).astype(np.float64), np.concatenate(depths)
        values, n, status, artifact = {}, {}, {}, {}
        for metric, (band, (low, high)) in zip(self.metrics, BANDS.items(), strict=True):
            inside = (depth >= low) & (depth < high)
            n[metric.name] = int(inside.sum())
            if n[metric.name]:
                values[metric.name] = artifact[band] = float(np.sqrt(np.mean(error[inside] ** 2)))
            else:
                values[metric.name], status[metric.name] = None, "no surface at this distance"
        return TaskResult(values, n, status, artifact)


TASK = DepthByDistance()
