"""Pictures of a field's geometry: how wrong its depth is, and its density cut open along two planes."""

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
from autonerf_lab.viz.figures.style import from_best_to_worst, nothing

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from autonerf_lab.evaluators.radiance_field import Field
    from autonerf_lab.scenes.scene import Scene

HEIGHT = 1.0  # metres, of the horizontal section
CELL = 0.02  # metres, of the pictures of density
_ERROR_CM = 50.0  # where the colours of an error end
_SIGMA = (0.1, 1000.0)  # per metre, where the colours of a density end
_OPAQUE = -np.log1p(-OPACITY_THRESHOLD) / OPACITY_STEP  # per metre, from which the maps call a place occupied
_UNSEEN = (150, 185)  # greys of the stripes: no colour scale has stripes, whoever looks at it
_STRIPE = 6  # cells
_TRUTH = "#2FD6FF"  # brighter than the sky blue of the other figures: it has to stand out on black and on orange


def depth_errors(artifact: dict[str, Any], rows: int = 4) -> Figure:
    """Colour, true and rendered depth, and their signed difference, one row a test pose.

    Rows are spread over the poses from the smallest to the largest median error, so that the picture shows failures
    too.

    Args:
        artifact: of the task ``rendering``.
        rows: how many poses at most.
    """
    if not artifact:
        return nothing()
    images = artifact["images"]
    errors = [np.where(i["true_depth"] > 0, 100 * (i["depth"] - i["true_depth"]), np.nan) for i in images]
    median = np.array([np.nanmedian(np.abs(e)) if np.isfinite(e).any() else np.inf for e in errors])
    chosen = from_best_to_worst(median, rows)
    deepest = max(float(images[k]["true_depth"].max()) for k in chosen)
    titles = ("true colour", "depth, true", "depth, rendered", "rendered − true")
    figure = Figure(figsize=(2.2 * len(titles), 2.2 * len(chosen) + 0.9), layout="constrained")
    # the colour bars have a row of their own: below only some of the columns they would push the images out of line
    halves: Any = figure.subfigures(2, 1, height_ratios=(2.2 * len(chosen) + 0.3, 0.6))
    pictures, bottom = halves
    axes = pictures.subplots(len(chosen), len(titles), squeeze=False)
    for line, k in zip(axes, chosen, strict=True):
        line[0].imshow(images[k]["true_rgb"])
        line[1].imshow(images[k]["true_depth"], cmap="viridis", vmin=0, vmax=deepest)
        depth = line[2].imshow(images[k]["depth"], cmap="viridis", vmin=0, vmax=deepest)
        wrong = line[3].imshow(errors[k], cmap="RdBu", vmin=-_ERROR_CM, vmax=_ERROR_CM)
        line[3].set_facecolor("#B8B8B8")  # where the truth has no depth
        label = f"median |error| {median[k]:.0f} cm" if np.isfinite(median[k]) else "no surface in view"
        line[0].set_ylabel(label, fontsize=9)
        for ax in line:
            ax.set_xticks([])
            ax.set_yticks([])
    for ax, title in zip(axes[0], titles, strict=True):
        ax.set_title(title, fontsize=10)
    bars = (
        (depth, "depth along the optical axis (m)", "max"),
        (wrong, "error (cm): red too near, blue too far", "both"),
    )
    for place, (shown, label, ends) in zip(bottom.subplots(1, 2), bars, strict=True):
        bar = figure.colorbar(shown, cax=place, orientation="horizontal", extend=ends)
        bar.ax.tick_params(labelsize=8)
        bar.set_label(label, fontsize=8)
    return figure


@dataclass(frozen=True)
class CrossSection:
    """A field and its scene, cut by a plane across one axis."""

    axis: int  # of the world, that the plane is perpendicular to
    at: float  # metres along that axis
    extent: tuple[float, float, float, float]  # metres, left right bottom top
    sigma: np.ndarray  # (R, C) density per metre, row 0 at the bottom
    seen: np.ndarray  # (R, C) bool, by a training view
    outline: np.ndarray  # (N, 2, 2) segments in which the plane cuts the true surfaces, metres


def cross_section(field: "Field", scene: "Scene", axis: int, at: float, cell: float = CELL) -> CrossSection:
    """The density of a field in a plane, over the bounds of the scene and half a metre around them.

    Args:
        field: answers ``density`` and ``seen``.
        scene: the truth.
        axis: of the world, that the plane is perpendicular to: 2 for a floor plan.
        at: metres along that axis.
        cell: metres between two points.
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
    """(N, 2, 3) segments in which a plane cuts triangles, and the (N,) triangles."""
    normal = np.eye(3)[axis]
    return trimesh.intersections.mesh_plane(surfaces, normal, at * normal, return_faces=True)


def _through_objects(plan: CrossSection, field: "Field", scene: "Scene") -> float:
    """The y of the elevation, out of every 10 cm, with the most seen space times kinds of seen objects that it cuts.

    One along a corridor shows nothing but floor and ceiling, and one inside a wall nothing that was seen.
    """
    surfaces = _surfaces(scene)
    rows = np.arange(0, len(plan.seen), 5)
    places = plan.extent[2] + (rows + 0.5) * CELL
    scores = []
    for row, y in zip(rows, places, strict=True):
        ends, faces = _outline(surfaces, 1, y)
        seen = field.seen(ends.mean(axis=1)) if len(ends) else np.zeros(0, bool)
        kinds = np.setdiff1d(scene.face_class[faces[seen]], 0)
        scores.append(plan.seen[row].mean() * (1 + len(kinds)))
    return float(places[np.argmax(scores)])


def density_sections(field: "Field", scene: "Scene", height: float = HEIGHT) -> Figure:
    """Density cut open twice, as a floor plan and as an elevation, with the true surfaces drawn over it.

    The elevation goes along x, where much of the space was seen and several kinds of objects are cut; dashed lines say
    where each plane cuts the other.

    Args:
        field: a trained field in ``scene``.
        scene: the truth.
        height: of the floor plan, metres above the floor.
    """
    plan = cross_section(field, scene, 2, height)
    y = _through_objects(plan, field, scene)
    elevation = cross_section(field, scene, 1, y)
    heights = [s.extent[3] - s.extent[2] for s in (plan, elevation)]
    width = 11.0
    scale = (width - 1.5) / (plan.extent[1] - plan.extent[0])
    figure = Figure(figsize=(width, scale * sum(heights) + 1.9), layout="constrained")
    axes = figure.subplots(2, 1, sharex=True, height_ratios=heights)
    _draw(axes[0], plan, f"floor plan at z = {height:.2f} m", "y (m)")
    axes[0].axhline(y, color="white", linestyle=(0, (6, 6)), linewidth=0.9)
    _draw(axes[1], elevation, f"elevation at y = {y:.2f} m", "z (m)")
    axes[1].axhline(height, color="white", linestyle=(0, (6, 6)), linewidth=0.9)
    axes[1].set_xlabel("x (m)", fontsize=9)
    bar = figure.colorbar(ScalarMappable(LogNorm(*_SIGMA), "magma"), ax=axes, shrink=0.6, aspect=30, extend="both")
    bar.set_label("density σ (1/m), logarithmic", fontsize=9)
    bar.ax.axhline(_OPAQUE, color="white", linewidth=2)
    bar.ax.tick_params(labelsize=8)
    handles = [
        Line2D([], [], color=_TRUTH, label="true surfaces"),
        Patch(facecolor="#B9B9B9", hatch="////", edgecolor="#969696", label="never seen by a training view"),
        Line2D(
            [], [], color="black", linestyle=(0, (4, 3)), linewidth=0.9, label="the other plane (white in the picture)"
        ),
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
    """(R, C, 4) uint8: grey stripes over what was not seen, nothing elsewhere."""
    row, column = np.indices(seen.shape)
    picture = np.empty((*seen.shape, 4), np.uint8)
    picture[..., :3] = np.where((row + column) // _STRIPE % 2, *_UNSEEN)[..., None]
    picture[..., 3] = np.where(seen, 0, 255)
    return picture
