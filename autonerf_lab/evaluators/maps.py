"""Task 2, occupancy: a top-down map with 1 cm cells, computed from the density of a field (section 4.3).

The paper describes its maps in the appendix, "Metric Map Estimation".

**Prediction.** A map cell stands for the height band from 0.10 m to 0.88 m above it, divided into 26 voxels of 3 cm.
The density is evaluated at the centre of each voxel. With the step delta = 10 cm, a voxel is opaque if
``alpha = 1 - exp(-sigma * delta)`` exceeds ``OPACITY_THRESHOLD``. A cell is

* *unknown* if no training view saw any of its voxels (``field.seen``, from rendered depth; evaluated at every second
  voxel, 6 cm apart, because visibility is stored in voxels of 5 cm),
* *occupied* if it is known and any voxel is opaque,
* *free* otherwise.

Unknown takes precedence because no training view constrains the density of unseen space.

**Scores** are computed over the cells whose ground truth is occupied or free. For free space as the positive class, an
unknown cell counts as not free: accuracy = (TP + TN) / (TP + TN + FP + FN), precision = TP / (TP + FP), recall =
TP / (TP + FN). For occupied space as the positive class, the tolerance is 5 cm. With the predicted cells P, the true
cells T and the distance d to the nearest cell:
``precision = |{p in P, scored: d(p, T) <= 5 cm}| / |{p in P, scored}|`` and
``recall = |{t in T: d(t, P) <= 5 cm}| / |T|``.
Recall also accepts predicted cells outside the scored area: a wall predicted 3 cm too deep counts as found.
"""

from enum import IntEnum

import numpy as np
from scipy.spatial import cKDTree

from autonerf_lab.evaluators.ground_truth import BAND, MapGrid, TrueMap
from autonerf_lab.evaluators.radiance_field import RadianceField

# Calibrated with `benchmarks/calibrate_opacity.py --policy modular-obs` (semantic-nerfacto, fast, train-00, -04, -08,
# -12, -16, -20): the threshold with the best sum of free accuracy and occupied F1, percent. It was calibrated on
# 2026-11-22 and measured again on 2026-11-28, with a better field and policy: 183.31 at 0.8, and 183.28 at 0.9.
#   threshold        0.30   0.50   0.70   0.80   0.90   0.95   0.98   0.99
#   free accuracy    87.5   88.9   89.7   89.9   89.8   89.5   88.8   88.3
#   occupied F1      91.0   92.4   93.2   93.4   93.5   93.3   92.8   92.4
OPACITY_THRESHOLD = 0.9
OPACITY_STEP = 0.10  # metres
LEVELS = 26  # voxels of 3 cm in the height band
TOLERANCE = 0.05  # metres
_SLAB = 100_000  # map cells in memory at a time


class CellState(IntEnum):
    """State of a map cell."""

    UNKNOWN = 0
    FREE = 1
    OCCUPIED = 2


def opacity(sigma: np.ndarray, step: float = OPACITY_STEP) -> np.ndarray:
    """Return the opacity (alpha) of a step through a medium.

    Args:
        sigma: density per metre, any shape.
        step: length of the step, metres.

    Example:
        >>> float(opacity(np.array(6.9315)).round(3))
        0.5
    """
    return 1 - np.exp(-np.asarray(sigma) * step)


def band_levels() -> np.ndarray:
    """Return the (26,) heights of the voxel centres in the height band, metres."""
    edges = np.linspace(*BAND, LEVELS + 1)
    return (edges[1:] + edges[:-1]) / 2


def predict_states(field: RadianceField, grid: MapGrid, threshold: float = OPACITY_THRESHOLD) -> np.ndarray:
    """Compute the three-state map of a field.

    Args:
        field: its methods ``seen`` and ``density`` are used.
        grid: the map cells.
        threshold: opacity over 10 cm above which a voxel is opaque.

    Returns:
        (R, C) uint8 of :class:`CellState`.
    """
    states = np.zeros(grid.shape, dtype=np.uint8)
    flat = states.reshape(-1)
    sigma_threshold = -np.log1p(-threshold) / OPACITY_STEP  # compare densities: the exponential is monotone
    levels = band_levels()
    for start in range(0, flat.size, _SLAB):
        index = np.arange(start, min(start + _SLAB, flat.size))
        centers = grid.centers(np.stack(np.divmod(index, grid.shape[1]), axis=1)).astype(np.float32)
        known = np.zeros(len(index), dtype=bool)
        for height in levels[::2]:
            todo = np.flatnonzero(~known)
            known[todo] = field.seen(_at_height(centers[todo], height))
        index, centers = index[known], centers[known]
        occupied = np.zeros(len(index), dtype=bool)
        for height in levels:
            todo = np.flatnonzero(~occupied)
            occupied[todo] = field.density(_at_height(centers[todo], height)) > sigma_threshold
        flat[index] = np.where(occupied, CellState.OCCUPIED, CellState.FREE)
    return states


def _at_height(centers: np.ndarray, height: float) -> np.ndarray:
    return np.concatenate([centers, np.full((len(centers), 1), height, dtype=np.float32)], axis=1)


def share_within(cells: np.ndarray, others: np.ndarray, radius: float) -> float | None:
    """Return the percentage of ``cells`` that have one of ``others`` within ``radius``; None without cells.

    Args:
        cells: (N, 2) map cells.
        others: (M, 2) map cells.
        radius: in cells.

    Example:
        >>> share_within(np.array([[0, 0], [9, 9]]), np.array([[3, 4]]), radius=5)
        50.0
    """
    if len(cells) == 0:
        return None
    distance, _ = cKDTree(others).query(cells, distance_upper_bound=radius + 1e-6)
    return float(100 * np.mean(np.isfinite(distance)))


def _percent(part: float, whole: float) -> float | None:
    return float(100 * part / whole) if whole else None


def free_scores(states: np.ndarray, truth: TrueMap) -> dict[str, float | None]:
    """Compute accuracy, precision and recall of free space, percent; None if a denominator is zero.

    Args:
        states: (R, C) predicted :class:`CellState`.
        truth: ground truth on the same grid.
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
    """Compute precision and recall of occupied space, percent.

    Args:
        states: (R, C) predicted :class:`CellState`.
        truth: ground truth on the same grid.
        tolerance: metres.
    """
    predicted = states == CellState.OCCUPIED
    radius = tolerance / truth.grid.cell
    true_cells = np.argwhere(truth.occupied)
    return {
        "occupancy_precision": share_within(np.argwhere(predicted & truth.scored), true_cells, radius),
        "occupancy_recall": share_within(true_cells, np.argwhere(predicted), radius),
    }
