"""Interactive view of the iterations of a pose refinement."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from autonerf_lab.course.widgets.live import LiveFigure
from autonerf_lab.evaluators.pose_refinement import CONVERGED_DEG, CONVERGED_M, pose_errors
from autonerf_lab.evaluators.radiance_field import RadianceField
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.viz.figures.style import BLUE, ORANGE, plain_log

_FLOOR = 1e-3  # degrees and millimetres, smallest error on the logarithmic axes


class PoseRefinement(LiveFigure):
    """Rendering from the estimated pose at a chosen iteration, next to the target image.

    Args:
        field: radiance field used for the refinement.
        trace: (I, 4, 4) estimated poses, camera-to-world, the initial one first.
        truth: (4, 4) true pose.
        target: (H, W, 3) uint8 image taken from the true pose.
        intrinsics: camera model.

    Example:
        >>> from autonerf_lab.evaluators.oracle import TrueField
        >>> from autonerf_lab.geometry import planar_pose
        >>> from autonerf_lab.scenes import load_scene
        >>> from autonerf_lab.simulator import Simulator
        >>> sim = Simulator(load_scene("dev-0"), Intrinsics.from_fov(16, 16))
        >>> trace = np.stack([planar_pose(1.6, 1.0, 0.0), planar_pose(1.5, 1.0, 0.0)])
        >>> field, target = TrueField(sim.scene, sim, views=1), sim.render(trace[-1]).rgb
        >>> refining = PoseRefinement(field, trace, trace[-1], target, sim.intrinsics)
        >>> refining.errors.round(3).tolist()
        [0.0, 0.1]
        >>> refining.iteration.value = 1
        >>> refining.errors.tolist()
        [0.0, 0.0]
    """

    def __init__(
        self, field: RadianceField, trace: np.ndarray, truth: np.ndarray, target: np.ndarray, intrinsics: Intrinsics
    ) -> None:
        super().__init__()
        self._field, self._trace, self._intrinsics = field, trace, intrinsics
        self._target = target.astype(np.float32) / 255
        self._errors = np.stack(pose_errors(trace, np.broadcast_to(truth, trace.shape)), axis=1)
        self.iteration = self.slider("iteration", 0, len(trace) - 1, 0, step=1)
        self.refresh()

    @property
    def errors(self) -> np.ndarray:
        """(2,) rotation error, degrees, and position error, metres, of the shown pose."""
        return self._errors[self.iteration.value]

    def controls(self) -> list[Any]:
        """Return a slider over the iterations."""
        return [self.iteration]

    def figure(self) -> Figure:
        """Draw target, rendering and their difference, and both errors over the iterations."""
        rendered = np.clip(self._field.render(self._trace[self.iteration.value], self._intrinsics).rgb, 0, 1)
        figure = Figure(figsize=(14, 3.2), layout="constrained")
        *images, rotation, position = figure.subplots(1, 5, width_ratios=(1, 1, 1, 1.2, 1.2))
        titles = ("target image", f"rendering, iteration {self.iteration.value}", "absolute difference")
        difference = np.abs(rendered - self._target).mean(axis=2)
        for ax, image, title in zip(images, (self._target, rendered, difference), titles, strict=True):
            ax.imshow(image, cmap="magma", vmin=0, vmax=0.4)
            ax.set(xticks=[], yticks=[])
            ax.set_title(title, fontsize=10)
        panels = (
            (rotation, self._errors[:, 0], CONVERGED_DEG, "rotation: {:.2f}°", "error (°)"),
            (position, 1000 * self._errors[:, 1], 1000 * CONVERGED_M, "position: {:.0f} mm", "error (mm)"),
        )
        for ax, errors, limit, title, unit in panels:
            ax.semilogy(np.maximum(errors, _FLOOR), color=BLUE)
            ax.plot(self.iteration.value, max(errors[self.iteration.value], _FLOOR), "o", color=ORANGE)
            ax.axhline(limit, color="black", linestyle="--", linewidth=0.8)
            ax.set(xlabel="iteration", ylabel=unit)
            plain_log(ax.yaxis)
            ax.set_title(title.format(errors[self.iteration.value]), fontsize=10)
        return figure
