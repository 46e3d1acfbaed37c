"""Task 2, occupancy: a top-down map of 1 cm cells read out of the density (section 4.3).

Details of the paper's maps are in its appendix, "Metric Map Estimation".

**Prediction.** The density is asked at the middle of 26 levels of 3 cm between 0.10 m and 0.88 m. With the step
delta = 10 cm a voxel is opaque when ``alpha = 1 - exp(-sigma * delta)`` exceeds ``OPACITY_THRESHOLD``. A column is

* *unknown* when no training view saw any voxel of it (``field.seen``, from rendered depth; asked at every second level,
  6 cm apart, because what is seen is kept in voxels of 5 cm anyway),
* *occupied* when it is known and any voxel is opaque,
* *free* otherwise.

Unknown comes first because the density of space that no view constrains means nothing.

**Scores**, over the cells where the truth is occupied or free. Free space as the positive class, an unknown cell being
not free: accuracy = (TP + TN) / (TP + TN + FP + FN), precision = TP / (TP + FP), recall = TP / (TP + FN). Occupied as
the positive class, 5 cm tolerance, with P the predicted cells, T the true ones and d the distance to the nearest:
precision = |{p in P, scored: d(p, T) <= 5 cm}| / |{p in P, scored}|, recall = |{t in T: d(t, P) <= 5 cm}| / |T|
(wherever the predicted cell lies: a wall found 3 cm too deep is found).
"""

from enum import IntEnum

import numpy as np
from scipy.spatial import cKDTree

from autonerf_lab.evaluators.ground_truth import BAND, Grid, TrueMap
from autonerf_lab.evaluators.radiance_field import Field

# Calibrated by `benchmarks/calibrate_opacity.py --policy modular-obs` (2026-11-22, semantic-nerfacto, fast, train-00,
# -04, -08, -12, -16, -20): the best sum of free accuracy and occupied F1, percent.
#   threshold        0.30   0.50   0.70   0.80   0.90   0.95   0.98   0.99
#   free accuracy    84.3   86.7   88.0   88.3   88.4   88.1   87.6   87.2
#   occupied F1      86.5   89.1   90.4   90.7   90.7   90.3   89.5   88.8
OPACITY_THRESHOLD = 0.9
OPACITY_STEP = 0.10  # metres
LEVELS = 26  # of 3 cm
TOLERANCE = 0.05  # metres
_SLAB = 100_000  # columns in memory at a time


class CellState(IntEnum):
    """What a map says about a column."""

    UNKNOWN = 0
    FREE = 1
    OCCUPIED = 2


def opacity(sigma: np.ndarray, step: float = OPACITY_STEP) -> np.ndarray:
    """Alpha of a step through a medium of density ``sigma`` (per metre).

    Example:
        >>> float(opacity(np.array(6.9315)).round(3))
        0.5
    """
    return 1 - np.exp(-np.asarray(sigma) * step)


def band_levels() -> np.ndarray:
    """(26,) heights of the middles of the levels, metres."""
    edges = np.linspace(*BAND, LEVELS + 1)
    return (edges[1:] + edges[:-1]) / 2


def predict_states(field: Field, grid: Grid, threshold: float = OPACITY_THRESHOLD) -> np.ndarray:
    """The three-state map of a field.

    Args:
        field: answers ``seen`` and ``density``.
        grid: the cells to fill.
        threshold: of the opacity over 10 cm.

    Returns:
        (R, C) uint8 of :class:`CellState`.
    """
    states = np.zeros(grid.shape, dtype=np.uint8)
    flat = states.reshape(-1)
    sigma_threshold = -np.log1p(-threshold) / OPACITY_STEP  # compare densities: the exponential is monotone
    levels = band_levels()
    for start in range(0, flat.size, _SLAB):
        index = np.arange(start, min(start + _SLAB, flat.size))
        columns = grid.centers(np.stack(np.divmod(index, grid.shape[1]), axis=1)).astype(np.float32)
        known = np.zeros(len(index), dtype=bool)
        for height in levels[::2]:
            todo = np.flatnonzero(~known)
            known[todo] = field.seen(_at_height(columns[todo], height))
        index, columns = index[known], columns[known]
        occupied = np.zeros(len(index), dtype=bool)
        for height in levels:
            todo = np.flatnonzero(~occupied)
            occupied[todo] = field.density(_at_height(columns[todo], height)) > sigma_threshold
        flat[index] = np.where(occupied, CellState.OCCUPIED, CellState.FREE)
    return states


def _at_height(columns: np.ndarray, height: float) -> np.ndarray:
    return np.concatenate([columns, np.full((len(columns), 1), height, dtype=np.float32)], axis=1)


def share_within(cells: np.ndarray, others: np.ndarray, radius: float) -> float | None:
    """Percentage of ``cells`` (N, 2) with one of ``others`` (M, 2) at most ``radius`` cells away; None without cells.

    Example:
        >>> share_within(np.array([[0, 0], [9, 9]]), np.array([[3, 4]]), radius=5)
        50.0
    """
    if len(cells) == 0:
        return None
    if len(others) == 0:
        return 0.0
    distance, _ = cKDTree(others).query(cells, distance_upper_bound=radius + 1e-6)
    return float(100 * np.mean(np.isfinite(distance)))


def _percent(part: float, whole: float) -> float | None:
    return float(100 * part / whole) if whole else None


def free_scores(states: np.ndarray, truth: TrueMap) -> dict[str, float | None]:
    """Accuracy, precision and recall of free space, percent; None where nothing can be divided.

    Args:
        states: (R, C) of :class:`CellState`.
        truth: on the same grid.
    """
    predicted = (states == CellState.FREE) & truth.scored
    hit = int(np.sum(predicted & truth.free))
    right = hit + int(np.sum(truth.scored & ~predicted & ~truth.free))
    return {
        "free_accuracy": _percent(right, int(truth.scored.sum())),
        "free_precision": _percent(hit, int(predicted.sum())),
        "free_recall": _percent(hit, int(truth.free.sum())),
    }


def occupancy_scores(states: np.ndarray, truth: TrueMap, tolerance: float = TOLERANCE) -> dict[str, float | None]:
    """Precision and recall of occupied space with a tolerance in metres, percent."""
    predicted = states == CellState.OCCUPIED
    radius = tolerance / truth.grid.cell
    true_cells = np.argwhere(truth.occupied)
    return {
        "occupancy_precision": share_within(np.argwhere(predicted & truth.scored), true_cells, radius),
        "occupancy_recall": share_within(true_cells, np.argwhere(predicted), radius),
    }
