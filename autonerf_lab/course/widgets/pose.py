"""Something to play with that needs a pose to be refined: go back and forth through its iterations."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from autonerf_lab.course.widgets.live import Live
from autonerf_lab.evaluators.pose_refinement import CONVERGED_DEG, CONVERGED_M, pose_errors
from autonerf_lab.evaluators.radiance_field import Field
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.viz.figures.style import BLUE, ORANGE, plain_log

_FLOOR = 1e-3  # degrees and millimetres, where the curves of the errors end


class Refining(Live):
    """Choose an iteration, and see the field from the camera's pose at that time beside what the camera saw.

    Args:
        field: what the camera is refined in.
        trace: (I, 4, 4) poses, the start first.
        truth: (4, 4) where the camera is.
        target: (H, W, 3) uint8, what it saw.
        intrinsics: of the camera.

    Example:
        >>> from autonerf_lab.evaluators.oracle import TrueField
        >>> from autonerf_lab.geometry import planar_pose
        >>> from autonerf_lab.scenes import load_scene
        >>> from autonerf_lab.simulator import Simulator
        >>> sim = Simulator(load_scene("dev-0"), Intrinsics.from_fov(16, 16))
        >>> trace = np.stack([planar_pose(1.6, 1.0, 0.0), planar_pose(1.5, 1.0, 0.0)])
        >>> field, target = TrueField(sim.scene, sim, views=1), sim.render(trace[-1]).rgb
        >>> refining = Refining(field, trace, trace[-1], target, sim.intrinsics)
        >>> refining.errors.round(3).tolist()
        [0.0, 0.1]
        >>> refining.iteration.value = 1
        >>> refining.errors.tolist()
        [0.0, 0.0]
    """

    def __init__(
        self, field: Field, trace: np.ndarray, truth: np.ndarray, target: np.ndarray, intrinsics: Intrinsics
    ) -> None:
        super().__init__()
        self._field, self._trace, self._intrinsics = field, trace, intrinsics
        self._target = target.astype(np.float32) / 255
        self._errors = np.stack(pose_errors(trace, np.broadcast_to(truth, trace.shape)), axis=1)
        self.iteration = self.slider("iteration", 0, len(trace) - 1, 0, step=1)
        self.refresh()

    @property
    def errors(self) -> np.ndarray:
        """(2,) of the pose that is shown: degrees and metres."""
        return self._errors[self.iteration.value]

    def controls(self) -> list[Any]:
        """A slider over the iterations."""
        return [self.iteration]

    def figure(self) -> Figure:
        """What the camera saw, what the field shows from here, how they differ, and both errors over time."""
        shown = np.clip(self._field.render(self._trace[self.iteration.value], self._intrinsics).rgb, 0, 1)
        figure = Figure(figsize=(14, 3.2), layout="constrained")
        *pictures, turned, off = figure.subplots(1, 5, width_ratios=(1, 1, 1, 1.2, 1.2))
        titles = ("what the camera saw", f"the field, iteration {self.iteration.value}", "difference")
        difference = np.abs(shown - self._target).mean(axis=2)
        for ax, image, title in zip(pictures, (self._target, shown, difference), titles, strict=True):
            ax.imshow(image, cmap="magma", vmin=0, vmax=0.4)
            ax.set(xticks=[], yticks=[])
            ax.set_title(title, fontsize=10)
        panels = (
            (turned, self._errors[:, 0], CONVERGED_DEG, "rotation: {:.2f}°", "error (degrees)"),
            (off, 1000 * self._errors[:, 1], 1000 * CONVERGED_M, "position: {:.0f} mm", "error (mm)"),
        )
        for ax, errors, limit, title, unit in panels:
            ax.semilogy(np.maximum(errors, _FLOOR), color=BLUE)
            ax.plot(self.iteration.value, max(errors[self.iteration.value], _FLOOR), "o", color=ORANGE)
            ax.axhline(limit, color="black", linestyle="--", linewidth=0.8)
            ax.set(xlabel="iteration", ylabel=unit)
            plain_log(ax.yaxis)
            ax.set_title(title.format(errors[self.iteration.value]), fontsize=10)
        return figure
