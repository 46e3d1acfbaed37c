"""Figures of an evaluation. Most functions take the artifact of a task, ``scores.artifacts[task]``.

The artifact of a failed task is empty; its figure is :func:`~autonerf_lab.viz.figures.style.empty_figure`.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from autonerf_lab.classes import CLASS_NAMES, colorize
from autonerf_lab.evaluators.maps import CellState
from autonerf_lab.evaluators.pose_refinement import CONVERGED_DEG, CONVERGED_M, pose_errors
from autonerf_lab.viz.figures.style import (
    BLUE,
    GREEN,
    ORANGE,
    YELLOW,
    cells_extent,
    class_legend,
    empty_figure,
    from_best_to_worst,
    plain_log,
)

if TYPE_CHECKING:
    import trimesh
    from matplotlib.axes import Axes

    from autonerf_lab.scenes.scene import Scene

_IGNORED, _FREE, _OCCUPIED = "#B8B8B8", "#FFFFFF", "#303030"


def _figure(width: float, height: float) -> Figure:
    return Figure(figsize=(width, height), layout="constrained")


def _floor(ax: "Axes", title: str) -> None:
    ax.set_title(title, fontsize=10)
    ax.set_aspect("equal")
    ax.set_xlabel("x (m)", fontsize=8)
    ax.set_ylabel("y (m)", fontsize=8)
    ax.tick_params(labelsize=7)


def render_comparison(artifact: dict[str, Any], rows: int = 4) -> Figure:
    """Draw true and rendered images side by side: colours, FLIP error, and classes if there are any.

    The rows are evenly spaced from the highest to the lowest PSNR, so that failures are included.

    Args:
        artifact: artifact of the task ``rendering``.
        rows: maximum number of test poses.
    """
    if not artifact:
        return empty_figure()
    images = artifact["images"]
    chosen = from_best_to_worst(-artifact["psnr"][: len(images)], rows)
    labels = {"true_semantics": "classes, true", "semantics": "classes, rendered"}
    labels = {key: title for key, title in labels.items() if images[0][key] is not None}
    titles = ("colours, true", "colours, rendered", "FLIP error", *labels.values())
    figure = _figure(1.9 * len(titles), 1.95 * len(chosen) + 0.8)
    axes = figure.subplots(len(chosen), len(titles), squeeze=False)
    for line, k in zip(axes, chosen, strict=True):
        image = images[k]
        line[0].imshow(image["true_rgb"])
        line[1].imshow(image["rgb"])
        flip = line[2].imshow(image["flip"], cmap="magma", vmin=0, vmax=1)
        for ax, key in zip(line[3:], labels, strict=True):
            ax.imshow(colorize(image[key]))
        line[0].set_ylabel(f"{artifact['psnr'][k]:.1f} dB", fontsize=9)
        for ax in line:
            ax.set_xticks([])
            ax.set_yticks([])
    for ax, title in zip(axes[0], titles, strict=True):
        ax.set_title(title, fontsize=9)
    bar = figure.colorbar(flip, ax=axes[:, 2], location="bottom", shrink=0.9, aspect=12, pad=0.02)
    bar.ax.tick_params(labelsize=7)
    bar.set_label("FLIP", fontsize=7)
    class_legend(figure, np.unique([label for k in chosen for key in labels for label in np.unique(images[k][key])]))
    return figure


def confusion(artifact: dict[str, Any]) -> Figure:
    """Draw the confusion matrix of the rendered classes, with normalised rows.

    Args:
        artifact: artifact of the task ``rendering``.
    """
    if not artifact:
        return empty_figure()
    counts = artifact["confusion"]
    if not counts.any():
        return empty_figure("no class labels")
    present = np.flatnonzero(counts.sum(axis=1) + counts.sum(axis=0))
    share = counts[np.ix_(present, present)] / np.maximum(counts[present].sum(axis=1, keepdims=True), 1)
    figure = _figure(0.45 * len(present) + 2.4, 0.42 * len(present) + 1.8)
    ax = figure.subplots()
    shown = ax.imshow(100 * share, cmap="Blues", vmin=0, vmax=100)
    names = [CLASS_NAMES[k] for k in present]
    ax.set_xticks(range(len(present)), names, rotation=60, ha="right", fontsize=8)
    ax.set_yticks(range(len(present)), names, fontsize=8)
    ax.set_xlabel("rendered class")
    ax.set_ylabel("true class")
    for r, c in np.argwhere(share >= 0.005):
        color = "white" if share[r, c] > 0.6 else "black"
        ax.text(c, r, f"{100 * share[r, c]:.0f}", ha="center", va="center", color=color, fontsize=7)
    figure.colorbar(shown, ax=ax, label="% of the pixels of the true class", shrink=0.8)
    return figure


def map_overlay(artifact: dict[str, Any]) -> Figure:
    """Compare the predicted map with the true map, cell by cell, and draw both semantic maps.

    Args:
        artifact: artifact of the task ``maps``.
    """
    if not artifact:
        return empty_figure()
    states, labels, truth = artifact["states"], artifact["labels"], artifact["truth"]
    kinds = (
        ("not scored (inside walls or furniture, outside)", _IGNORED, ~truth.scored),
        ("free, predicted free", _FREE, truth.free & (states == CellState.FREE)),
        ("occupied, predicted occupied", _OCCUPIED, truth.occupied & (states == CellState.OCCUPIED)),
        ("free, predicted occupied", BLUE, truth.free & (states == CellState.OCCUPIED)),
        ("occupied, predicted free", ORANGE, truth.occupied & (states == CellState.FREE)),
        ("unknown (never seen)", YELLOW, truth.scored & (states == CellState.UNKNOWN)),
    )
    image = np.zeros(truth.grid.shape, dtype=np.uint8)
    for k, (_, _, mask) in enumerate(kinds):
        image[mask] = k
    extent = cells_extent(truth.grid.origin, truth.grid.shape, truth.grid.cell)
    width = 5.0
    figure = _figure(3 * width, width * truth.grid.shape[0] / truth.grid.shape[1] + 0.9)
    axes = figure.subplots(1, 3)
    colors = ListedColormap([color for _, color, _ in kinds])
    axes[0].imshow(
        image, cmap=colors, vmin=0, vmax=len(kinds) - 1, origin="lower", extent=extent, interpolation="nearest"
    )
    handles = [Patch(facecolor=color, edgecolor="#606060", label=name) for name, color, _ in kinds]
    figure.legend(handles=handles, loc="outside lower left", ncols=3, fontsize=7, frameon=False)
    true_labels = np.zeros(truth.grid.shape, dtype=np.uint8)
    for k in truth.classes:
        true_labels[truth.semantics[k - 1]] = k
    for ax, label in ((axes[1], true_labels), (axes[2], labels)):
        ground = np.where(truth.free[..., None], np.uint8(255), np.uint8(200)).repeat(3, axis=2)
        ground[label > 0] = colorize(label[label > 0])
        ax.imshow(ground, origin="lower", extent=extent, interpolation="nearest")
    for ax, title in zip(
        axes, ("occupancy: prediction and ground truth", "classes, true", "classes, predicted"), strict=True
    ):
        _floor(ax, title)
    class_legend(figure, np.union1d(truth.classes, np.unique(labels[labels > 0])).astype(int), "outside lower right", 6)
    return figure


_REASON_COLORS = {
    "": GREEN,
    "through an obstacle": ORANGE,
    "ended far": BLUE,
    "no path": "#CC79A7",
    "class not predicted": "#7F7F7F",
}


def planned_paths(artifact: dict[str, Any], count: int = 25) -> Figure:
    """Draw PointGoal and ObjectGoal paths over the true map, coloured by outcome.

    Args:
        artifact: artifact of the task ``planning``.
        count: approximate number of drawn episodes per outcome, so that rare outcomes are visible.
    """
    if not artifact:
        return empty_figure()
    truth, episode_set = artifact["truth"], artifact["episode_set"]
    grid = truth.grid
    ground = np.full((*grid.shape, 3), 205, dtype=np.uint8)
    ground[truth.free] = 238
    ground[episode_set.passable] = 255
    ground[truth.occupied] = 60
    figure = _figure(13, 6.5 * grid.shape[0] / grid.shape[1] + 1.2)
    axes = figure.subplots(1, 2)
    extent = cells_extent(grid.origin, grid.shape, grid.cell)
    for ax, name in zip(axes, ("points", "objects"), strict=True):
        episodes = artifact[name]
        ax.imshow(ground, origin="lower", extent=extent, interpolation="nearest")
        alike = [[e for e in episodes if e.reason == reason] for reason in _REASON_COLORS]
        for e in (e for group in alike for e in group[:: max(1, len(group) // count)]):
            color = _REASON_COLORS[e.reason]
            start = grid.centers(e.start)
            ax.plot(*start, "o", color=color, markersize=3)
            if e.path is not None:
                line = grid.centers(e.path)
                ax.plot(*line.T, color=color, linewidth=1.1, alpha=0.9)
                ax.plot(*line[-1], "x", color=color, markersize=5)
        won = sum(e.success for e in episodes)
        title = {"points": "PointGoal", "objects": "ObjectGoal"}[name]
        _floor(ax, f"{title}: {won} of {len(episodes)} episodes succeed")
    handles = [Line2D([], [], color=c, label=name or "success") for name, c in _REASON_COLORS.items()]
    handles += [Line2D([], [], color="k", marker=m, linestyle="", label=t) for m, t in (("o", "start"), ("x", "end"))]
    figure.legend(handles=handles, loc="outside lower center", ncols=7, fontsize=8, frameon=False)
    return figure


def refinement_trace(artifact: dict[str, Any]) -> Figure:
    """Draw the errors of all poses over the iterations, and images of the first poses before and after.

    Args:
        artifact: artifact of the task ``pose_refinement``.
    """
    if not artifact:
        return empty_figure()
    truth, iterations = artifact["truth"], artifact["iterations"]
    errors = np.array([pose_errors(poses, truth) for poses in artifact["trace"]])  # (I, 2, K)
    before, after, targets = artifact["before"], artifact["after"], artifact["targets"]
    shown = min(len(before), 3)
    figure = _figure(14, 4.6)
    halves: Any = figure.subfigures(1, 2, width_ratios=(1.1, 1))
    curves, images = halves
    axes = curves.subplots(1, 2)
    converged = (errors[-1, 0] < CONVERGED_DEG) & (errors[-1, 1] < CONVERGED_M)
    panels = (
        (errors[:, 0], CONVERGED_DEG, "rotation", "°"),
        (1000 * errors[:, 1], 1000 * CONVERGED_M, "position", "mm"),
    )
    for ax, (error, limit, name, unit) in zip(axes, panels, strict=True):
        for k in range(error.shape[1]):
            ax.semilogy(
                iterations, np.maximum(error[:, k], 1e-3), color=BLUE if converged[k] else ORANGE, alpha=0.7, lw=1
            )
        ax.axhline(limit, color="k", linestyle="--", linewidth=0.8)
        plain_log(ax.yaxis)
        ax.set_xlabel("iteration", fontsize=8)
        ax.set_ylabel(f"{name} error ({unit})", fontsize=8)
        ax.tick_params(labelsize=7)
    handles = [Line2D([], [], color=BLUE, label=f"converged ({converged.sum()})")]
    handles += [Line2D([], [], color=ORANGE, label=f"not converged ({(~converged).sum()})")]
    handles += [Line2D([], [], color="k", linestyle="--", label="convergence threshold")]
    axes[0].legend(handles=handles, fontsize=7, frameon=False)
    grid = images.subplots(shown, 5, squeeze=False)
    titles = ("target", "start", "|difference|", "end", "|difference|")
    for k, line in enumerate(grid):
        target = targets[k].astype(np.float32) / 255
        differences = [np.abs(image - target).mean(axis=2) for image in (before[k], after[k])]
        for ax, image in zip(line, (target, before[k], differences[0], after[k], differences[1]), strict=True):
            shown_image = ax.imshow(np.clip(image, 0, 1), cmap="magma", vmin=0, vmax=0.4)
            ax.set_xticks([])
            ax.set_yticks([])
        line[0].set_ylabel(f"{errors[-1, 0, k]:.2f}°, {1000 * errors[-1, 1, k]:.0f} mm", fontsize=8)
    for ax, title in zip(grid[0], titles, strict=True):
        ax.set_title(title, fontsize=8)
    bar = images.colorbar(shown_image, ax=grid, location="bottom", shrink=0.4, aspect=30, extend="max")
    bar.set_label("|difference| of colours in [0, 1]", fontsize=7)
    bar.ax.tick_params(labelsize=7)
    return figure


def bird_view(
    mesh: "trimesh.Trimesh", colors: np.ndarray | None = None, width: int = 1000, azimuth_deg: float = -60.0
) -> np.ndarray:
    """Render a slanted parallel projection of a mesh, without ceiling and near walls.

    Back-facing triangles are left out. In a parallel projection, these are the ceiling and the walls between the viewer
    and the rooms.

    Args:
        mesh: world frame, metres, triangles face the free side.
        colors: (V, 3) uint8; default: the vertex colours of the mesh.
        width: of the image, pixels.
        azimuth_deg: direction of the viewer, counter-clockwise from world +x.

    Returns:
        (H, width, 3) uint8, white background.
    """
    return _bird_views(mesh, [colors], width, azimuth_deg)[0]


def _bird_views(
    mesh: "trimesh.Trimesh", colorings: Sequence[np.ndarray | None], width: int, azimuth_deg: float
) -> list[np.ndarray]:
    """Render :func:`bird_view` in several colourings, with one ray casting."""
    from autonerf_lab.simulator.raycast import RayCaster

    if not len(mesh.faces):
        return [np.full((width // 2, width, 3), 255, dtype=np.uint8)] * len(colorings)
    azimuth, elevation = np.radians(azimuth_deg), np.radians(50)
    back = np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    up = np.cross(back, right)
    triangles = np.asarray(mesh.triangles, dtype=np.float64)
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normal = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-20)
    front = np.flatnonzero(normal @ back > 0)
    triangles, normal, corners = triangles[front], normal[front], np.asarray(mesh.faces)[front]
    flat = triangles.reshape(-1, 3) @ np.stack([right, up], axis=1)
    low, high = flat.min(axis=0) - 0.1, flat.max(axis=0) + 0.1
    fine, pixel = 2 * width, (high[0] - low[0]) / (2 * width)
    rows = 2 * max(1, int(np.ceil((high[1] - low[1]) / pixel / 2)))
    u, v = np.meshgrid(low[0] + (np.arange(fine) + 0.5) * pixel, high[1] - (np.arange(rows) + 0.5) * pixel)
    far = float((triangles.reshape(-1, 3) @ back).max()) + 1
    origins = (u[..., None] * right + v[..., None] * up + far * back).reshape(-1, 3)
    hits = RayCaster(triangles).cast(origins, np.broadcast_to(-back, origins.shape))
    hit = hits.face >= 0
    face = hits.face[hit]
    points = origins[hit] - hits.t[hit, None] * back
    a, b, c = (triangles[face, i] for i in range(3))
    areas = np.stack([_area(points, b, c), _area(a, points, c), _area(a, b, points)], axis=1)
    weights = areas / np.maximum(areas.sum(axis=1, keepdims=True), 1e-20)
    shade = 0.62 + 0.38 * np.abs(normal[face] @ np.array([0.35, 0.2, 0.91]))
    visual: Any = mesh.visual
    images = []
    for colors in colorings:
        of_vertices = np.asarray(visual.vertex_colors)[:, :3] if colors is None else colors
        image = np.full((len(origins), 3), 255.0)
        image[hit] = np.einsum("nk,nkd->nd", weights, of_vertices[corners[face]].astype(np.float64)) * shade[:, None]
        images.append(image.reshape(rows // 2, 2, width, 2, 3).mean(axis=(1, 3)).round().astype(np.uint8))
    return images


def _area(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    return np.linalg.norm(np.cross(b - a, c - a), axis=1)


def mesh_view(artifact: dict[str, Any]) -> Figure:
    """Draw the extracted mesh from above: colours, classes if it has any, and distance to the true surface.

    Args:
        artifact: artifact of the task ``mesh``.
    """
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from scipy.spatial import cKDTree

    if not artifact:
        return empty_figure()
    mesh = artifact["mesh"]
    classes = mesh.vertex_attributes.get("semantics")
    if not len(mesh.faces):
        return empty_figure("no surface was found in the field")
    _, nearest = cKDTree(artifact["points"]).query(mesh.vertices)
    scale = Normalize(0, 100 * artifact["limit"])
    distance = colormaps["viridis"](scale(100 * artifact["distance"][nearest]))[:, :3]
    colorings: dict[str, np.ndarray | None] = {"colours": None}
    if classes is not None:
        colorings["classes"] = colorize(np.asarray(classes).astype(int))
    colorings["distance to the true surface"] = (255 * distance).astype(np.uint8)
    images = _bird_views(mesh, list(colorings.values()), width=1000, azimuth_deg=-60.0)
    height = images[0].shape[0] / images[0].shape[1]
    figure = _figure(5.3 * len(images), 5.2 * height + 0.7)
    axes = figure.subplots(1, len(images))
    for ax, title, image in zip(axes, colorings, images, strict=True):
        ax.imshow(image)
        ax.set_title(title, fontsize=10)
        ax.axis("off")
    figure.colorbar(ScalarMappable(scale, "viridis"), ax=axes[-1], label="distance (cm)", shrink=0.8, extend="max")
    if classes is not None:
        class_legend(figure, np.unique(classes))
    return figure


def trajectory_view(scene: "Scene", poses: np.ndarray) -> Figure:
    """Draw a scene from above with a trajectory, coloured by step.

    Args:
        scene: the scene.
        poses: (T, 4, 4) camera-to-world poses of the trajectory.
    """
    from autonerf_lab.scenes.plotting import plot_scale, top_view

    scale = plot_scale(scene)
    image, corner = top_view(scene, scale)
    high = corner + np.array(image.shape[1::-1]) / scale
    figure = _figure(8, 6.1 * image.shape[0] / image.shape[1] + 0.7)  # the colour bar takes the remaining width
    ax = figure.subplots()
    ax.imshow(image, extent=(corner[0], high[0], corner[1], high[1]))
    xy = poses[:, :2, 3]
    ax.plot(*xy.T, color="black", linewidth=2.6, alpha=0.5)
    dots = ax.scatter(xy[:, 0], xy[:, 1], c=np.arange(len(xy)), cmap="plasma", s=7, zorder=3)
    ax.plot(*xy[0], "o", color="white", markeredgecolor="black", markersize=9, zorder=4)
    figure.colorbar(dots, ax=ax, label="step", shrink=0.7)
    _floor(ax, f"{scene.name}: trajectory")
    return figure
