"""Figures of pose sources: paths from above, errors over the steps, and the depth points at these poses."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from autonerf_lab.geometry import camera_rays
from autonerf_lab.localization.se2 import between, to_planar
from autonerf_lab.viz.figures.style import BLUE, SKY, SOURCE_COLORS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from autonerf_lab.data.trajectory import Trajectory

_BAND = (0.3, 1.6)  # metres above the floor: walls and furniture without floor and ceiling
_FRAMES, _PIXELS = 200, 32  # number of images, and pixels along their sides, of which points are drawn


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
    above.plot(true[:, 0], true[:, 1], color=SOURCE_COLORS["true"], linewidth=3.2, label="true")
    for name, path in paths.items():
        color = SOURCE_COLORS[name]
        style: dict[str, Any] = {"color": color, "linewidth": 2.2 if name == "estimated" else 1}  # wider: below refined
        above.plot(path[:, 0], path[:, 1], label=name, **style)
        distance.plot(100 * np.linalg.norm(path[:, :2] - true[:, :2], axis=1), label=name, **style)
        heading.plot(np.abs(np.degrees(between(true, path)[:, 2])), **style)
    if spread is not None and "estimated" in paths:
        deviations = np.array(spread)
        distance.plot(100 * np.hypot(deviations[:, 0], deviations[:, 1]), ":", color=BLUE, label="predicted, 1σ")
        heading.plot(np.degrees(deviations[:, 2]), ":", color=BLUE)
    above.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
    above.legend(fontsize=8)
    for ax, fine in ((distance, 10.0), (heading, 1.0)):  # odometry drifts by metres, an estimate by centimetres
        _scale_errors(ax, fine)
    distance.set(ylabel="position error (cm)")
    heading.set(xlabel="step", ylabel="heading error (°)")
    distance.legend(fontsize=8)
    return figure


def _scale_errors(ax: "Axes", fine: float) -> None:
    """Scale an axis of errors: linear up to ``fine``, and logarithmic above if there are larger errors."""
    largest = ax.get_ylim()[1]
    if largest > fine:
        ax.set_yscale("symlog", linthresh=fine)
        ax.set_yticks([0, fine / 2, *fine * 10.0 ** np.arange(4)])
        ax.yaxis.set_major_formatter("{x:g}")
    ax.set_ylim(0, largest)
    ax.grid(alpha=0.3)


def pose_maps(trajectory: "Trajectory") -> Figure:
    """Draw the depth points from above at the poses of each source: the better the poses, the thinner the walls.

    Args:
        trajectory: has depth, true poses and at least one other source.

    Example:
        >>> from autonerf_lab.data.trajectory import Trajectory
        >>> from autonerf_lab.geometry import Intrinsics
        >>> poses, rgb = np.eye(4)[None].repeat(3, axis=0), np.zeros((3, 4, 4, 3), np.uint8)
        >>> depth = np.ones((3, 4, 4), np.float32)
        >>> trajectory = Trajectory(poses, rgb, depth, None, Intrinsics.from_fov(4, 4)).with_poses("odometry", poses)
        >>> [ax.get_title() for ax in pose_maps(trajectory).axes]
        ['odometry']
    """
    sources = trajectory.pose_sources
    true = sources.pop("true")
    figure = Figure(figsize=(4.2 * len(sources), 4.2), layout="constrained")
    axes = figure.subplots(1, len(sources), sharex=True, sharey=True, squeeze=False)[0]
    for ax, (name, poses) in zip(axes, sources.items(), strict=True):
        ax.plot(*_points(trajectory, poses).T, ",", color="black")
        ax.plot(*poses[:, :2, 3].T, color=SOURCE_COLORS[name], linewidth=1)
        ax.plot(*true[:, :2, 3].T, ":", color=SKY, linewidth=1.5)
        ax.set(title=name, xlabel="x (m)", aspect="equal")
    axes[0].set_ylabel("y (m)")
    return figure


def _points(trajectory: "Trajectory", poses: np.ndarray) -> np.ndarray:
    """Return the positions (N, 2) of depth points of some images within a band of heights."""
    assert trajectory.depth is not None
    every = max(1, len(poses) // _FRAMES)
    step = max(1, max(trajectory.depth.shape[1:]) // _PIXELS)
    found = []
    for pose, image in zip(poses[::every], trajectory.depth[::every, ::step, ::step], strict=True):
        rays_o, rays_d = (part[::step, ::step] for part in camera_rays(trajectory.intrinsics, pose))
        points = (rays_o + image[..., None] * rays_d)[image > 0]
        found.append(points[(points[:, 2] > _BAND[0]) & (points[:, 2] < _BAND[1]), :2])
    return np.concatenate(found)
