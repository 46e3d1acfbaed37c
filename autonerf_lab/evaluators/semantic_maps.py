"""Task 2, semantics: the object class of each map cell (section 4.3, details in the appendix).

**Prediction.** Every training ray ends at a point at its rendered depth, with the rendered class. Points between 0.10 m
and 0.88 m vote for the class of their map cell; the background votes too:
``label(cell) = argmax_k |{points of class k in the cell}|``. The rays come from evenly spaced training views, resized
to 64 pixels a side: about two million for an apartment. Pixels are larger than map cells, so that most cells of a
surface would get no point. Therefore 36 points of a pixel are interpolated on the surface between it and its
neighbours, where all four have one class and lie close together.

**Ground truth.** A map cell has a class if a visible surface of that class lies in its height band
(:mod:`~autonerf_lab.evaluators.ground_truth`). A cell may have two classes: a cup and the table under its rim.

**Scores** are computed for each class in the scene, over the cells whose ground truth is occupied or free, and averaged
over these classes: accuracy = (TP + TN) / (TP + TN + FP + FN) of the binary map, precision = TP / (TP + FP), recall =
TP / (TP + FN). Precision and recall are also computed with a tolerance of 5 cm, as in
:mod:`~autonerf_lab.evaluators.maps`. A class that is never predicted has precision 0.
"""

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from autonerf_lab.classes import NUM_CLASSES
from autonerf_lab.evaluators.ground_truth import BAND, MapGrid, TrueMap
from autonerf_lab.evaluators.maps import TOLERANCE, free_scores, occupancy_scores, share_within
from autonerf_lab.evaluators.metrics import metrics_of
from autonerf_lab.evaluators.radiance_field import RadianceField, surface_points, training_views
from autonerf_lab.evaluators.task import Task, TaskFigure, TaskResult

if TYPE_CHECKING:
    from autonerf_lab.evaluators.context import EvaluationContext

RAYS = 2_000_000
_SPLIT = 6  # points of a pixel along each side
_GAP = 0.2  # metres; neighbouring pixels closer than this, with equal classes, see one surface


@njit(cache=True)
def _vote(
    points: np.ndarray,
    depth: np.ndarray,
    classes: np.ndarray,
    ends: np.ndarray,
    frame: tuple[float, float, float],
    votes: np.ndarray,
) -> None:
    """Add the points of an image to the votes, 36 for each pixel.

    Args:
        points: (H, W, 3) end points of the rays, metres.
        depth: (H, W) depth; its inverse, unlike itself, is linear in the pixel along a plane.
        classes: (H, W) int64.
        ends: (H, W) bool, rays that have an end point.
        frame: x and y of the corner of the map, side of its cells.
        votes: (K, R, C) int32, changed in place.
    """
    rows, cols = depth.shape
    share = np.empty(4)
    for i in range(rows):
        for j in range(cols):
            if not ends[i, j]:
                continue
            k = classes[i, j]
            surface = i + 1 < rows and j + 1 < cols and _one_surface(points, classes, ends, i, j)
            split = _SPLIT if surface else 1
            for a in range(split):
                for b in range(split):
                    u, v = a / split, b / split
                    share[:] = (1 - u) * (1 - v), (1 - u) * v, u * (1 - v), u * v
                    x = y = z = total = 0.0
                    for corner in range(4 if surface else 1):
                        r, c = i + corner // 2, j + corner % 2
                        weight = share[corner] / depth[r, c]
                        x += weight * points[r, c, 0]
                        y += weight * points[r, c, 1]
                        z += weight * points[r, c, 2]
                        total += weight
                    if not BAND[0] <= z / total <= BAND[1]:
                        continue
                    row = int(np.floor((y / total - frame[1]) / frame[2]))
                    col = int(np.floor((x / total - frame[0]) / frame[2]))
                    if 0 <= row < votes.shape[1] and 0 <= col < votes.shape[2]:
                        votes[k, row, col] += _SPLIT * _SPLIT // (split * split)


@njit(cache=True)
def _one_surface(points: np.ndarray, classes: np.ndarray, ends: np.ndarray, i: int, j: int) -> bool:
    """Return True if a pixel and its neighbours below and to the right have one class and lie close together."""
    for r, c in ((i + 1, j), (i, j + 1), (i + 1, j + 1)):
        if not ends[r, c] or classes[r, c] != classes[i, j]:
            return False
    for r, c in ((i, j), (i + 1, j + 1)):
        for s, d in ((i + 1, j), (i, j + 1)):
            distance = 0.0
            for axis in range(3):
                distance += (points[r, c, axis] - points[s, d, axis]) ** 2
            if distance > _GAP * _GAP:
                return False
    return True


def class_votes(field: RadianceField, grid: MapGrid, rays: int = RAYS) -> np.ndarray:
    """Count the points of each class in the height band of each map cell.

    Args:
        field: its training views are rendered; without classes, everything is background.
        grid: map with R x C cells.
        rays: approximate number of rays; the views are evenly spaced along the trajectory.

    Returns:
        (16, R, C) int32 numbers of points.
    """
    votes = np.zeros((NUM_CLASSES, *grid.shape), dtype=np.int32)
    frame = (float(grid.origin[0]), float(grid.origin[1]), float(grid.cell))
    for c2w, intrinsics, image in training_views(field, rays):
        points, ends = surface_points(image, c2w, intrinsics)
        dense = np.zeros((*ends.shape, 3))
        dense[ends] = points
        labels = np.zeros(ends.shape) if image.semantics is None else image.semantics
        classes = np.where(labels < NUM_CLASSES, labels, 0).astype(np.int64)
        _vote(dense, image.depth.astype(np.float64), classes, ends, frame, votes)
    return votes


def semantic_cells(votes: np.ndarray) -> np.ndarray:
    """Return the (R, C) uint8 class with most votes in each map cell; 0: background or no vote.

    Args:
        votes: (16, R, C), result of :func:`class_votes`. Of classes with equal votes, the first one wins.
    """
    return votes.argmax(axis=0).astype(np.uint8)


def semantic_scores(labels: np.ndarray, truth: TrueMap, tolerance: float = TOLERANCE) -> dict[str, float | None]:
    """Compute the five semantic map scores, percent; None for a scene without objects.

    Args:
        labels: (R, C) predicted class of each map cell, 0 for none.
        truth: ground truth on the same grid.
        tolerance: of the ``_5cm`` scores, metres.
    """
    names = (
        "semantic_accuracy",
        "semantic_precision",
        "semantic_recall",
        "semantic_precision_5cm",
        "semantic_recall_5cm",
    )
    scored, radius = truth.scored, tolerance / truth.grid.cell
    total = int(scored.sum())
    rows = []
    for k in truth.classes:
        true, everywhere = truth.semantics[k - 1], labels == k
        predicted = everywhere & scored
        hit, guesses, wanted = int(np.sum(predicted & true)), int(predicted.sum()), int(true.sum())
        true_cells = np.argwhere(true)
        rows.append(
            (
                100 * (total - guesses - wanted + 2 * hit) / total,
                100 * hit / guesses if guesses else 0.0,
                100 * hit / wanted,
                share_within(np.argwhere(predicted), true_cells, radius) or 0.0,
                share_within(true_cells, np.argwhere(everywhere), radius) or 0.0,
            )
        )
    if not rows:
        return dict.fromkeys(names)
    return dict(zip(names, np.mean(rows, axis=0).tolist(), strict=True))


class MapsTask(Task):
    """Task 2: occupancy and semantic maps."""

    name, metrics, title = "maps", metrics_of("maps"), "Maps"
    text = (
        "A top-down map with cells of 1 cm is computed from the density and the classes of the field. A cell is "
        "occupied if the field is opaque anywhere between 0.10 m and 0.88 m above the floor. Cells that no training "
        "image has seen are unknown: they count neither as free nor as occupied."
    )
    figures = (
        TaskFigure(
            "sections",
            "density_sections",
            title="Density in two planes",
            caption="Top: horizontal plane. Bottom: vertical plane. The field is opaque where the colour is bright; "
            "blue lines are the true surfaces. The white mark on the colour bar is the density above which a map cell "
            "counts as occupied. Striped areas were seen by no training image.",
            alt="Density of the field in a horizontal plane at one metre and in a vertical plane, with the outlines of "
            "the true surfaces; unseen areas are striped",
            inputs=("field", "scene"),
        ),
        TaskFigure(
            "overlay",
            "map_overlay",
            title="Predicted and true maps",
            caption="Left: predicted occupancy compared with the ground truth, cell by cell. Middle and right: true "
            "and predicted object classes.",
            alt="Three floor plans: agreement of the predicted occupancy with the ground truth, true classes, "
            "predicted classes",
        ),
    )

    def run(self, context: "EvaluationContext") -> TaskResult:
        """Compare the maps of the field with the ground truth."""
        states, labels, truth = context.states, context.labels, context.truth
        values = free_scores(states, truth) | occupancy_scores(states, truth)
        values |= semantic_scores(labels, truth)
        missing = {"semantic": "no object in the scene"}
        status = {
            name: missing.get(name.split("_")[0], "no such cell") for name, value in values.items() if value is None
        }
        artifact = {"states": states, "labels": labels, "truth": truth}
        return TaskResult(values, dict.fromkeys(values, int(truth.scored.sum())), status, artifact)
