"""Figures of a trajectory, and of the refinement of one pose."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from autonerf_lab.classes import colorize
from autonerf_lab.evaluators.pose_refinement import CONVERGED_DEG, CONVERGED_M, pose_errors
from autonerf_lab.viz.figures.style import BLUE, ORANGE, class_legend

if TYPE_CHECKING:
    from autonerf_lab.data.trajectory import Trajectory
    from autonerf_lab.evaluators.radiance_field import RadianceField

_DIFFERENCE_MAX = 0.4  # limit of the colour scale of differences, colours in [0, 1]


def trajectory_frames(trajectory: "Trajectory", count: int = 8) -> Figure:
    """Draw evenly spaced images of a trajectory: colours, depth and classes, if they were recorded.

    Args:
        trajectory: the recorded trajectory.
        count: maximum number of steps to show, one column each.

    Example:
        >>> from autonerf_lab.geometry import Intrinsics
        >>> from autonerf_lab.data.trajectory import Trajectory
        >>> rgb = np.zeros((3, 4, 4, 3), np.uint8)
        >>> trajectory = Trajectory(np.eye(4)[None].repeat(3, axis=0), rgb, None, None, Intrinsics.from_fov(4, 4))
        >>> len(trajectory_frames(trajectory).axes)
        3
    """
    chosen = np.unique(np.linspace(0, len(trajectory) - 1, count).round().astype(int))
    layers: list[tuple[str, list[np.ndarray], dict[str, Any]]] = [("colours", [trajectory.rgb[t] for t in chosen], {})]
    if trajectory.depth is not None:
        deepest = float(trajectory.depth[chosen].max())
        layers.append(("depth", [trajectory.depth[t] for t in chosen], {"vmin": 0, "vmax": deepest}))
    if trajectory.semantics is not None:
        layers.append(("classes", [colorize(trajectory.semantics[t]) for t in chosen], {}))
    figure = Figure(figsize=(1.6 * len(chosen), 1.6 * len(layers) + 0.6), layout="constrained")
    axes = figure.subplots(len(layers), len(chosen), squeeze=False)
    for row, (name, images, limits) in zip(axes, layers, strict=True):
        for ax, image in zip(row, images, strict=True):
            shown = ax.imshow(image, cmap="viridis", **limits)
            ax.set_xticks([])
            ax.set_yticks([])
        row[0].set_ylabel(name, fontsize=9)
        if limits:
            figure.colorbar(shown, ax=list(row), label="depth (m)", pad=0.01, aspect=12)
    for ax, t in zip(axes[0], chosen, strict=True):
        ax.set_title(f"step {t}", fontsize=9)
    if trajectory.semantics is not None:
        class_legend(figure, np.unique(trajectory.semantics[chosen]))
    return figure


def explored_area(trajectory: "Trajectory") -> Figure:
    """Draw the explored area and the path length over the steps; ticks mark collisions."""
    meta = trajectory.meta
    figure = Figure(figsize=(8, 2.8), layout="constrained")
    ax = figure.subplots()
    ax.plot(meta["explored_m2"], color=BLUE, label="explored area (m²)")
    ax.plot(meta["path_m"], color=ORANGE, linestyle="--", label="path length (m)")
    hits = np.flatnonzero(meta["collided"])
    ax.plot(hits, np.zeros(len(hits)), "|", color="black", markersize=8, label=f"collisions ({len(hits)})")
    ax.set_xlabel("step")
    ax.set_ylim(bottom=0)
    ax.set_xlim(0, len(trajectory))
    ax.grid(alpha=0.3)
    ax.legend(frameon=False, fontsize=9)
    return figure


def shown_pose(artifact: dict[str, Any]) -> int:
    """Return the index of the first converged pose among those with stored images, else 0."""
    rotation, translation = artifact["rotation_error_deg"], artifact["translation_error_m"]
    stored = np.arange(len(rotation)) < len(artifact["targets"])
    return int(np.argmax(stored & (rotation < CONVERGED_DEG) & (translation < CONVERGED_M)))


def refinement_frames(field: "RadianceField", artifact: dict[str, Any], count: int = 16) -> list[np.ndarray]:
    """Draw the frames of an animation of one pose refinement: target, rendering, difference, error curves.

    Args:
        field: the field in which the pose was refined.
        artifact: artifact of the task ``pose_refinement``.
        count: number of frames; they are denser at the beginning, where the pose moves fastest.

    Returns:
        (H, W, 3) uint8 images of one size; empty if the task failed.
    """
    if not artifact:
        return []
    trace, iterations, truth = artifact["trace"], artifact["iterations"], artifact["truth"]
    camera = shown_pose(artifact)
    target = artifact["targets"][camera].astype(np.float32) / 255
    intrinsics = field.intrinsics.resized(target.shape[1], target.shape[0])
    errors = np.array([pose_errors(poses, truth) for poses in trace])[:, :, camera]
    chosen = np.unique((np.linspace(0, 1, count) ** 2 * (len(trace) - 1)).round().astype(int))
    draw = _refinement_drawing(target, errors, iterations)
    return [draw(field.render(trace[k][camera], intrinsics).rgb, k) for k in chosen]


def _refinement_drawing(
    target: np.ndarray, errors: np.ndarray, iterations: np.ndarray
) -> Callable[[np.ndarray, int], np.ndarray]:
    """Return a function that draws the frame of a rendering and its index in the trace.

    What all frames share is drawn once: axes and ticks take most of the time of a figure.
    """
    figure = Figure(figsize=(11, 3.1), dpi=90)
    axes = figure.subplots(1, 4, width_ratios=(1, 1, 1, 1.35))
    figure.subplots_adjust(left=0.01, right=0.93, bottom=0.16, top=0.88, wspace=0.08)
    titles = ("target", "rendering", f"|difference|, 0 to {_DIFFERENCE_MAX:g}")
    images = []
    for ax, image, title in zip(axes, (target, target, target[..., 0]), titles, strict=False):
        images.append(ax.imshow(image, cmap="magma", vmin=0, vmax=_DIFFERENCE_MAX))
        ax.set(title=title, xticks=[], yticks=[])
    curve = axes[3]
    values = np.maximum(errors * [1, 1000], 1e-3)  # degrees, millimetres
    labels = (("rotation error (°)", BLUE, CONVERGED_DEG), ("position error (mm)", ORANGE, 1000 * CONVERGED_M))
    lines = []
    for name, color, converged in labels:
        lines += curve.semilogy([], [], color=color, label=name)
        curve.axhline(converged, color=color, linestyle=":", linewidth=1)
    everything = np.concatenate([errors[:, 0], 1000 * errors[:, 1], [CONVERGED_DEG, 1000 * CONVERGED_M]])
    curve.set_xlim(0, iterations[-1])
    curve.set_ylim(max(everything.min(), 1e-3) / 4, everything.max() * 1.5)
    curve.yaxis.set_major_formatter("{x:g}")  # plain numbers instead of powers of ten
    curve.yaxis.set_minor_formatter(NullFormatter())
    curve.yaxis.tick_right()
    curve.legend(frameon=False, fontsize=8, loc="lower left")
    title = curve.set_title(" ")
    changing = [*images[1:], *lines, title]
    for artist in changing:
        artist.set_animated(True)  # not part of the background
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    background = canvas.copy_from_bbox(figure.bbox)

    def draw(shown: np.ndarray, k: int) -> np.ndarray:
        images[1].set_data(np.clip(shown, 0, 1))
        images[2].set_data(np.abs(target - shown).mean(axis=2))
        for line, column in zip(lines, values.T, strict=True):
            line.set_data(iterations[: k + 1], column[: k + 1])
        title.set_text(f"iteration {iterations[k]}: {errors[k, 0]:.2f}°, {1000 * errors[k, 1]:.1f} mm")
        canvas.restore_region(background)
        for artist in changing:
            artist.axes.draw_artist(artist)
        return np.asarray(canvas.buffer_rgba())[..., :3].copy()

    return draw
