"""Figures of pose sources: paths from above, and errors over the steps."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from autonerf_lab.localization.se2 import between, to_planar
from autonerf_lab.viz.figures.style import BLUE, SOURCE_COLORS

if TYPE_CHECKING:
    from autonerf_lab.data.trajectory import Trajectory


def pose_drift(trajectory: "Trajectory") -> Figure:
    """Draw the paths of all pose sources of a trajectory, and their distances from the true poses, without alignment.

    Args:
        trajectory: has true poses and at least one other source.

    Example:
        >>> from autonerf_lab.data.trajectory import Trajectory
        >>> from autonerf_lab.geometry import Intrinsics
        >>> poses, rgb = np.eye(4)[None].repeat(3, axis=0), np.zeros((3, 4, 4, 3), np.uint8)
        >>> trajectory = Trajectory(poses, rgb, None, None, Intrinsics.from_fov(4, 4)).with_poses("odometry", poses)
        >>> len(pose_drift(trajectory).axes)
        3
    """
    paths = {name: to_planar(poses) for name, poses in trajectory.pose_sources.items()}
    return _drift(paths.pop("true"), paths, trajectory.meta.get("pose_std"))


def trajectory_drift(artifact: dict[str, Any]) -> Figure:
    """Draw the result of the task ``trajectory``: the training poses after alignment."""
    return _drift(artifact["true"], {artifact["source"]: artifact["errors"].aligned}, None)


def _drift(true: np.ndarray, paths: Mapping[str, np.ndarray], spread: Any) -> Figure:
    figure = Figure(figsize=(11, 5), layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=(1, 1.2))
    above, distance = figure.add_subplot(grid[:, 0]), figure.add_subplot(grid[0, 1])
    heading = figure.add_subplot(grid[1, 1], sharex=distance)
    above.plot(true[:, 0], true[:, 1], color=SOURCE_COLORS["true"], linewidth=2.2, label="true")
    for name, path in paths.items():
        color = SOURCE_COLORS[name]
        above.plot(path[:, 0], path[:, 1], color=color, linewidth=1, label=name)
        distance.plot(100 * np.linalg.norm(path[:, :2] - true[:, :2], axis=1), color=color, linewidth=1, label=name)
        heading.plot(np.abs(np.degrees(between(true, path)[:, 2])), color=color, linewidth=1)
    if spread is not None and "estimated" in paths:
        deviations = np.array(spread)
        distance.plot(100 * np.hypot(deviations[:, 0], deviations[:, 1]), ":", color=BLUE, label="predicted, 1σ")
        heading.plot(np.degrees(deviations[:, 2]), ":", color=BLUE)
    above.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
    above.legend(fontsize=8)
    for ax, largest in ((distance, 10.0), (heading, 1.0)):  # odometry drifts by metres, an estimate by centimetres
        ax.set_yscale("symlog", linthresh=largest)
        ax.set_ylim(bottom=0)
        ax.grid(alpha=0.3)
    distance.set(ylabel="position error (cm)")
    heading.set(xlabel="step", ylabel="heading error (°)")
    distance.legend(fontsize=8)
    return figure
