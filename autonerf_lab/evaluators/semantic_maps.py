"""Task 2, semantics: the object class of each map cell (section 4.3, details in the appendix).

**Prediction.** Every training ray ends at a point at its rendered depth, with the rendered class. Points between 0.10 m
and 0.88 m vote for the class of their map cell; the background votes too:
``label(cell) = argmax_k |{points of class k in the cell}|``. The rays come from a subset of the training views, resized
to 64 pixels a side: about a million points for an apartment.

**Ground truth.** A map cell has a class if a visible surface of that class lies in its height band
(:mod:`~autonerf_lab.evaluators.ground_truth`). A cell may have two classes: a cup and the table under its rim.

**Scores** are computed for each class in the scene, over the cells whose ground truth is occupied or free, and averaged
over these classes: accuracy = (TP + TN) / (TP + TN + FP + FN) of the binary map, precision = TP / (TP + FP), recall =
TP / (TP + FN). Precision and recall are also computed with a tolerance of 5 cm, as in
:mod:`~autonerf_lab.evaluators.maps`. A class that is never predicted has precision 0.
"""

from typing import TYPE_CHECKING

import numpy as np

from autonerf_lab.classes import NUM_CLASSES
from autonerf_lab.evaluators.ground_truth import BAND, MapGrid, TrueMap
from autonerf_lab.evaluators.maps import TOLERANCE, free_scores, occupancy_scores, share_within
from autonerf_lab.evaluators.metrics import metrics_of
from autonerf_lab.evaluators.radiance_field import RadianceField, surface_points
from autonerf_lab.evaluators.task import Task, TaskFigure, TaskResult

if TYPE_CHECKING:
    from autonerf_lab.evaluators.context import EvaluationContext

VIEW_SIDE = 64  # pixels
POINTS = 1_000_000


def point_cloud(field: RadianceField, count: int = POINTS) -> tuple[np.ndarray, np.ndarray]:
    """Compute the end points of training rays, and their classes.

    Args:
        field: its training views are rendered.
        count: approximate number of rays; the views are evenly spaced along the trajectory.

    Returns:
        (N, 3) float32 world points and (N,) uint8 classes, all background if the field has no classes.
    """
    scale = min(1.0, VIEW_SIDE / max(field.intrinsics.width, field.intrinsics.height))
    intrinsics = field.intrinsics.resized(
        max(1, round(field.intrinsics.width * scale)), max(1, round(field.intrinsics.height * scale))
    )
    views = min(len(field.poses), max(1, count // (intrinsics.width * intrinsics.height)))
    points, classes = [], []
    for k in np.linspace(0, len(field.poses) - 1, views).round().astype(int):
        c2w = field.poses[k]
        image = field.render(c2w, intrinsics)
        found, ends = surface_points(image, c2w, intrinsics)
        labels = np.zeros(ends.shape) if image.semantics is None else np.asarray(image.semantics)
        points.append(found)
        classes.append(labels[ends].astype(np.uint8))
    return np.concatenate(points), np.concatenate(classes)


def semantic_cells(points: np.ndarray, classes: np.ndarray, grid: MapGrid) -> np.ndarray:
    """Return the (R, C) uint8 class with most points in the height band of each map cell; 0: background or no point.

    Example:
        >>> grid = MapGrid(np.zeros(2), (1, 2), cell=1.0)
        >>> semantic_cells(np.array([[0.5, 0.5, 0.3]] * 3), np.array([4, 4, 0]), grid)
        array([[4, 0]], dtype=uint8)
    """
    band = (points[:, 2] >= BAND[0]) & (points[:, 2] <= BAND[1])
    cells, inside = grid.cells(points[band])
    classes = classes[band][inside]
    flat = cells[:, 0] * grid.shape[1] + cells[:, 1]
    size = grid.shape[0] * grid.shape[1]
    most = np.bincount(flat[classes == 0], minlength=size)
    label = np.zeros(size, dtype=np.uint8)
    for k in range(1, NUM_CLASSES):
        count = np.bincount(flat[classes == k], minlength=size)
        label[count > most] = k
        np.maximum(most, count, out=most)
    return label.reshape(grid.shape)


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
