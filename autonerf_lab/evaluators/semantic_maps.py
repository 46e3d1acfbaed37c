"""Task 2, semantics: which object class stands in which column (section 4.3, details in the appendix).

**Prediction.** Every point at the rendered depth of a training ray carries the rendered class. Points between 0.10 m
and 0.88 m are summed in their column, and the class with the largest sum (background included) names it:
``label(column) = argmax_k |{points of class k in the column}|``. The rays are
those of a subset of the training views at 64 pixels a side: a million points name the cells of an apartment.

**Truth.** A class is in a column when a visible surface of that class is
(:mod:`~autonerf_lab.evaluators.ground_truth`), so a column may hold two: a cup and the table under its rim.

**Scores**, for each class in the scene over the cells where the truth is occupied or free, then averaged over these
classes: accuracy = (TP + TN) / (TP + TN + FP + FN) of the binary map, precision = TP / (TP + FP), recall =
TP / (TP + FN); and precision and recall within 5 cm, where a cell counts as a hit when the nearest of the other map is
so near, as in :mod:`~autonerf_lab.evaluators.maps`. A class never predicted has precision 0.
"""

import numpy as np

from autonerf_lab.classes import NUM_CLASSES
from autonerf_lab.evaluators.ground_truth import BAND, Grid, TrueMap
from autonerf_lab.evaluators.maps import TOLERANCE, share_within
from autonerf_lab.evaluators.radiance_field import Field, surface_points

VIEW_SIDE = 64  # pixels
POINTS = 1_000_000


def point_cloud(field: Field, count: int = POINTS) -> tuple[np.ndarray, np.ndarray]:
    """Points where training rays end, with their classes.

    Args:
        field: renders its own training cameras.
        count: about how many rays; views are taken at even intervals along the walk.

    Returns:
        (N, 3) float32 world points and (N,) uint8 classes, all background where the field knows none.
    """
    scale = min(1.0, VIEW_SIDE / max(field.intrinsics.width, field.intrinsics.height))
    intrinsics = field.intrinsics.resized(
        max(1, round(field.intrinsics.width * scale)), max(1, round(field.intrinsics.height * scale))
    )
    views = min(len(field.cameras), max(1, count // (intrinsics.width * intrinsics.height)))
    points, classes = [], []
    for k in np.linspace(0, len(field.cameras) - 1, views).round().astype(int):
        c2w = field.cameras[k]
        image = field.render(c2w, intrinsics)
        found, ends = surface_points(image, c2w, intrinsics)
        labels = np.zeros(ends.shape) if image.semantics is None else np.asarray(image.semantics)
        points.append(found)
        classes.append(labels[ends].astype(np.uint8))
    return np.concatenate(points), np.concatenate(classes)


def semantic_columns(points: np.ndarray, classes: np.ndarray, grid: Grid) -> np.ndarray:
    """(R, C) uint8: the class with most points of the band in each column; 0 is background or no point.

    Example:
        >>> grid = Grid(np.zeros(2), (1, 2), cell=1.0)
        >>> semantic_columns(np.array([[0.5, 0.5, 0.3]] * 3), np.array([4, 4, 0]), grid)
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
    """The five semantic map scores, percent; None for a scene without objects.

    Args:
        labels: (R, C) class of each column, 0 for none.
        truth: on the same grid.
        tolerance: metres, of the tolerant scores.
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
