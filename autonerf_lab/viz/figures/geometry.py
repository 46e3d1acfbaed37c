"""Figures of the geometry of a field: depth errors, and the density in two planes."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import trimesh
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from autonerf_lab.evaluators.maps import OPACITY_STEP, OPACITY_THRESHOLD
from autonerf_lab.viz.figures.style import empty_figure, from_best_to_worst

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from autonerf_lab.evaluators.radiance_field import RadianceField
    from autonerf_lab.scenes.scene import Scene

HEIGHT = 1.0  # of the horizontal plane, metres
CELL = 0.02  # side of a pixel in the density images, metres
_ERROR_CM = 50.0  # limit of the colour scale of depth errors
_SIGMA = (0.1, 1000.0)  # limits of the colour scale of the density, per metre
_OPAQUE = -np.log1p(-OPACITY_THRESHOLD) / OPACITY_STEP  # density above which a map cell is occupied, per metre
_UNSEEN = (150, 185)  # greys of the stripes over unseen space
_STRIPE = 6  # width of a stripe, pixels
_TRUTH = "#2FD6FF"  # visible on black and on orange


def depth_errors(artifact: dict[str, Any], rows: int = 4) -> Figure:
    """Draw colours, true and rendered depth, and their signed difference, one row per test pose.

    The rows are evenly spaced from the smallest to the largest median error, so that failures are included.

    Args:
        artifact: artifact of the task ``rendering``.
        rows: maximum number of test poses.
    """
    if not artifact:
        return empty_figure()
    images = artifact["images"]
    errors = [np.where(i["true_depth"] > 0, 100 * (i["depth"] - i["true_depth"]), np.nan) for i in images]
    median = np.array([np.nanmedian(np.abs(e)) if np.isfinite(e).any() else np.inf for e in errors])
    chosen = from_best_to_worst(median, rows)
    deepest = max(float(images[k]["true_depth"].max()) for k in chosen)
    titles = ("colours, true", "depth, true", "depth, rendered", "rendered − true")
    figure = Figure(figsize=(2.2 * len(titles), 2.2 * len(chosen) + 0.9), layout="constrained")
    # The colour bars are in a row of their own; otherwise they would misalign the images.
    halves: Any = figure.subfigures(2, 1, height_ratios=(2.2 * len(chosen) + 0.3, 0.6))
    top, bottom = halves
    axes = top.subplots(len(chosen), len(titles), squeeze=False)
    for line, k in zip(axes, chosen, strict=True):
        line[0].imshow(images[k]["true_rgb"])
        line[1].imshow(images[k]["true_depth"], cmap="viridis", vmin=0, vmax=deepest)
        depth = line[2].imshow(images[k]["depth"], cmap="viridis", vmin=0, vmax=deepest)
        error = line[3].imshow(errors[k], cmap="RdBu", vmin=-_ERROR_CM, vmax=_ERROR_CM)
        line[3].set_facecolor("#B8B8B8")  # no true depth
        label = f"median |error| {median[k]:.0f} cm" if np.isfinite(median[k]) else "no surface in view"
        line[0].set_ylabel(label, fontsize=9)
        for ax in line:
            ax.set_xticks([])
            ax.set_yticks([])
    for ax, title in zip(axes[0], titles, strict=True):
        ax.set_title(title, fontsize=10)
    bars = (
        (depth, "depth along the optical axis (m)", "max"),
        (error, "depth error (cm): red too near, blue too far", "both"),
    )
    for bar_ax, (shown, label, ends) in zip(bottom.subplots(1, 2), bars, strict=True):
        bar = figure.colorbar(shown, cax=bar_ax, orientation="horizontal", extend=ends)
        bar.ax.tick_params(labelsize=8)
        bar.set_label(label, fontsize=8)
    return figure


@dataclass(frozen=True)
class CrossSection:
    """Density of a field, and outline of its scene, in a plane perpendicular to an axis."""

    axis: int  # of the world, perpendicular to the plane
    at: float  # position along this axis, metres
    extent: tuple[float, float, float, float]  # metres, left right bottom top
    sigma: np.ndarray  # (R, C) density per metre, row 0 at the bottom
    seen: np.ndarray  # (R, C) bool, seen by a training view
    outline: np.ndarray  # (N, 2, 2) line segments of the true surfaces in the plane, metres


def cross_section(field: "RadianceField", scene: "Scene", axis: int, at: float, cell: float = CELL) -> CrossSection:
    """Evaluate the density of a field in a plane, over the bounds of the scene and a margin of 0.5 m.

    Args:
        field: its methods ``density`` and ``seen`` are used.
        scene: the ground truth.
        axis: of the world, perpendicular to the plane: 2 for a horizontal plane.
        at: position along this axis, metres.
        cell: distance of the points, metres.
    """
    across = [k for k in range(3) if k != axis]
    low, high = scene.bounds[0][across] - 0.5, scene.bounds[1][across] + 0.5
    columns, rows = np.maximum(np.ceil((high - low) / cell), 1).astype(int)
    high = low + cell * np.array([columns, rows])
    points = np.empty((rows, columns, 3))
    points[..., axis] = at
    points[..., across[0]] = low[0] + (np.arange(columns) + 0.5) * cell
    points[..., across[1]] = low[1] + (np.arange(rows)[:, None] + 0.5) * cell
    flat = points.reshape(-1, 3)
    sigma, seen = (answer(flat).reshape(rows, columns) for answer in (field.density, field.seen))
    outline, _ = _outline(_surfaces(scene), axis, at)
    return CrossSection(axis, at, (low[0], high[0], low[1], high[1]), sigma, seen, outline[:, :, across])


def _surfaces(scene: "Scene") -> trimesh.Trimesh:
    return trimesh.Trimesh(scene.vertices, scene.faces, process=False)


def _outline(surfaces: trimesh.Trimesh, axis: int, at: float) -> tuple[np.ndarray, np.ndarray]:
    """Intersect triangles with a plane: (N, 2, 3) line segments, and the (N,) indices of their triangles."""
    normal = np.eye(3)[axis]
    return trimesh.intersections.mesh_plane(surfaces, normal, at * normal, return_faces=True)


def _plane_through_objects(plan: CrossSection, field: "RadianceField", scene: "Scene") -> float:
    """Choose the y of the vertical plane: the largest product of seen space and number of seen object classes.

    This avoids planes in a corridor without objects, and planes inside a wall. Candidates are 10 cm apart.
    """
    surfaces = _surfaces(scene)
    rows = np.arange(0, len(plan.seen), 5)
    positions = plan.extent[2] + (rows + 0.5) * CELL
    scores = []
    for row, y in zip(rows, positions, strict=True):
        ends, faces = _outline(surfaces, 1, y)
        seen = field.seen(ends.mean(axis=1)) if len(ends) else np.zeros(0, bool)
        classes = np.setdiff1d(scene.face_class[faces[seen]], 0)
        scores.append(plan.seen[row].mean() * (1 + len(classes)))
    return float(positions[np.argmax(scores)])


def density_sections(field: "RadianceField", scene: "Scene", height: float = HEIGHT) -> Figure:
    """Draw the density in a horizontal and a vertical plane, with the outlines of the true surfaces.

    The vertical plane is parallel to the x axis; it is chosen so that much of it was seen and it contains several
    object classes. Dashed lines show the intersection of the two planes.

    Args:
        field: a field trained in ``scene``.
        scene: the ground truth.
        height: of the horizontal plane above the floor, metres.
    """
    plan = cross_section(field, scene, 2, height)
    y = _plane_through_objects(plan, field, scene)
    elevation = cross_section(field, scene, 1, y)
    heights = [s.extent[3] - s.extent[2] for s in (plan, elevation)]
    width = 11.0
    scale = (width - 1.5) / (plan.extent[1] - plan.extent[0])
    figure = Figure(figsize=(width, scale * sum(heights) + 1.9), layout="constrained")
    axes = figure.subplots(2, 1, sharex=True, height_ratios=heights)
    _draw(axes[0], plan, f"horizontal plane at z = {height:.2f} m", "y (m)")
    axes[0].axhline(y, color="white", linestyle=(0, (6, 6)), linewidth=0.9)
    _draw(axes[1], elevation, f"vertical plane at y = {y:.2f} m", "z (m)")
    axes[1].axhline(height, color="white", linestyle=(0, (6, 6)), linewidth=0.9)
    axes[1].set_xlabel("x (m)", fontsize=9)
    bar = figure.colorbar(ScalarMappable(LogNorm(*_SIGMA), "magma"), ax=axes, shrink=0.6, aspect=30, extend="both")
    bar.set_label("density σ (1/m), logarithmic scale", fontsize=9)
    bar.ax.axhline(_OPAQUE, color="white", linewidth=2)
    bar.ax.tick_params(labelsize=8)
    handles = [
        Line2D([], [], color=_TRUTH, label="true surfaces"),
        Patch(facecolor="#B9B9B9", hatch="////", edgecolor="#969696", label="never seen by a training view"),
        Line2D([], [], color="black", linestyle=(0, (4, 3)), linewidth=0.9, label="other plane (white in the image)"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    return figure


def _draw(ax: "Axes", section: CrossSection, title: str, vertical: str) -> None:
    ax.imshow(
        np.clip(section.sigma, *_SIGMA), cmap="magma", norm=LogNorm(*_SIGMA), origin="lower", extent=section.extent
    )
    ax.imshow(_stripes(section.seen), origin="lower", extent=section.extent, interpolation="nearest")
    ax.add_collection(LineCollection(list(section.outline), colors=_TRUTH, linewidths=0.8))
    ax.set_aspect("equal")
    ax.set_title(title, fontsize=10)
    ax.set_ylabel(vertical, fontsize=9)
    ax.tick_params(labelsize=8)


def _stripes(seen: np.ndarray) -> np.ndarray:
    """Return (R, C, 4) uint8 grey stripes over unseen space, transparent elsewhere."""
    row, column = np.indices(seen.shape)
    image = np.empty((*seen.shape, 4), np.uint8)
    image[..., :3] = np.where((row + column) // _STRIPE % 2, *_UNSEEN)[..., None]
    image[..., 3] = np.where(seen, 0, 255)
    return image
