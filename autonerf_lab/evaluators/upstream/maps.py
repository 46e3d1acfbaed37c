"""Maps of the released code, and their scores.

A map cell is occupied if ``1 - exp(-3.906 sigma) > 0.99`` at any height up to 1.50 m, in units in which all camera
positions lie between -1 and 1. Connected components under 300 cells are removed. All other cells are free; no cell is
unknown. Every cell of the grid is scored, including cells inside walls and outside the apartment. The height band of
the released code begins at height 0 of its world. Here this is the floor, which would fill the map; so the height band
begins at 0.10 m, as in the standard maps, and heights are 3 cm apart instead of 1 cm.

A map cell has a class if it is occupied and contains at least one point of the class. Holes under 2000 cells are
filled, and gaps are closed by a disc of 20 cells. The mean is over all 15 classes; a class that is not in the scene
scores 0.
"""

import numpy as np
from scipy import ndimage

from autonerf_lab.classes import NUM_CLASSES
from autonerf_lab.evaluators.ground_truth import BAND, MapGrid, TrueMap
from autonerf_lab.evaluators.planning import dilate_obstacles
from autonerf_lab.evaluators.radiance_field import RadianceField

BOTTOM, TOP = BAND[0], 1.5  # height band, metres
LEVELS = 47
OPACITY_STEP = 3.906  # in the unit of :func:`camera_unit`
THRESHOLD = 0.99
MIN_PIECE = 300  # cells
MIN_HOLE = 2000
CLOSING = 20
_SLAB = 200_000


def camera_unit(poses: np.ndarray) -> float:
    """Return the length, in metres, of the unit in which (T, 4, 4) poses lie between -1 and 1 around their mean."""
    positions = poses[:, :3, 3]
    return float(np.abs(positions - positions.mean(axis=0)).max()) or 1.0


def large_components(mask: np.ndarray, fewest: int) -> np.ndarray:
    """Remove the 4-connected components with fewer than ``fewest`` cells from an (R, C) bool mask.

    Example:
        >>> large_components(np.array([[1, 1, 0, 1]], bool), 2).astype(int)
        array([[1, 1, 0, 0]])
    """
    labels, _ = ndimage.label(mask)
    return mask & (np.bincount(labels.ravel()) >= fewest)[labels]


def close_gaps(mask: np.ndarray, min_hole: int = MIN_HOLE, radius: int = CLOSING) -> np.ndarray:
    """Fill small holes of an (R, C) bool mask and close gaps with a disc; very small components of large masks go."""
    mask = ~large_components(~mask, min_hole)
    if mask.sum() > min_hole:
        mask = large_components(mask, 10)
    mask = ~large_components(dilate_obstacles(~mask, radius, 1.0), min_hole)
    return dilate_obstacles(mask, radius, 1.0)


def occupied_cells(field: RadianceField, grid: MapGrid) -> np.ndarray:
    """Return the (R, C) bool map cells that are opaque at any height up to 1.50 m, without small components."""
    opaque = -np.log1p(-THRESHOLD) / (OPACITY_STEP * camera_unit(field.poses))
    heights = BOTTOM + (np.arange(LEVELS) + 0.5) * (TOP - BOTTOM) / LEVELS
    occupied = np.zeros(grid.shape[0] * grid.shape[1], dtype=bool)
    for first in range(0, occupied.size, _SLAB):
        index = np.arange(first, min(first + _SLAB, occupied.size))
        centers = grid.centers(np.stack(np.divmod(index, grid.shape[1]), axis=1))
        for height in heights:
            todo = np.flatnonzero(~occupied[index])
            points = np.concatenate([centers[todo], np.full((len(todo), 1), height)], axis=1).astype(np.float32)
            occupied[index[todo]] = field.density(points) > opaque
    return large_components(occupied.reshape(grid.shape), MIN_PIECE)


def semantic_cells(points: np.ndarray, classes: np.ndarray, grid: MapGrid) -> np.ndarray:
    """Return (15, R, C) bool: the map cells that contain a point of each class.

    Example:
        >>> grid = MapGrid(np.zeros(2), (1, 2), cell=1.0)
        >>> both = semantic_cells(np.array([[0.5, 0.5, 0.3]] * 2), np.array([4, 7]), grid)
        >>> np.argwhere(both).tolist()
        [[3, 0, 0], [6, 0, 0]]
    """
    within = (points[:, 2] >= BOTTOM) & (points[:, 2] <= TOP) & (classes > 0)
    cells, inside = grid.cells(points[within])
    class_cells = np.zeros((NUM_CLASSES - 1, *grid.shape), dtype=bool)
    class_cells[classes[within][inside].astype(int) - 1, cells[:, 0], cells[:, 1]] = True
    return class_cells


def binary_scores(predicted: np.ndarray, true: np.ndarray) -> tuple[float, float, float]:
    """Compute accuracy, precision and recall, percent; 0 if a denominator is zero.

    Example:
        >>> binary_scores(np.array([True, True, False, False]), np.array([True, False, False, False]))
        (75.0, 50.0, 100.0)
    """
    hit, guessed, wanted = int(np.sum(predicted & true)), int(predicted.sum()), int(true.sum())
    accuracy = 100 * float(np.mean(predicted == true))
    return accuracy, 100 * hit / guessed if guessed else 0.0, 100 * hit / wanted if wanted else 0.0


def map_scores(occupied: np.ndarray, class_cells: np.ndarray, truth: TrueMap) -> dict[str, float | None]:
    """Compute the six map scores.

    Args:
        occupied: (R, C) bool, result of :func:`occupied_cells`.
        class_cells: (15, R, C) bool, result of :func:`semantic_cells`.
        truth: ground truth on the same grid.
    """
    semantic = [
        binary_scores(close_gaps(found & occupied), true)
        for found, true in zip(class_cells, truth.semantics, strict=True)
    ]
    values = (*binary_scores(~occupied, truth.free), *np.mean(semantic, axis=0).tolist())
    names = [f"{kind}_{score}" for kind in ("free", "semantic") for score in ("accuracy", "precision", "recall")]
    return dict(zip(names, values, strict=True))
