"""Maps as the released code makes and scores them.

A column is occupied if anywhere up to 1.50 m ``1 - exp(-3.906 sigma) > 0.99``, in units in which the cameras lie within
-1 and 1; pieces under 300 cells are dropped. All else is free: nothing is unknown. Every cell of the grid counts, those
within walls and outside too. The released code begins at height 0 of its world. Here that is the floor itself, which
would fill the map; so columns begin at 0.10 m, as in the standard maps, and levels are 3 cm apart instead of 1 cm.

A class is in a column as soon as one point is, and the column is occupied; holes under 2000 cells are filled, gaps
closed by a disc of 20 cells. The mean is over all 15 classes, and one that the scene does not hold scores 0.
"""

import numpy as np
from scipy import ndimage

from autonerf_lab.classes import NUM_CLASSES
from autonerf_lab.evaluators.ground_truth import BAND, Grid, TrueMap
from autonerf_lab.evaluators.planning import grow
from autonerf_lab.evaluators.radiance_field import Field

BOTTOM, TOP = BAND[0], 1.5  # metres, of the columns
LEVELS = 47
OPACITY_STEP = 3.906  # in units of the cameras
THRESHOLD = 0.99
MIN_PIECE = 300  # cells
MIN_HOLE = 2000
CLOSING = 20
_SLAB = 200_000


def camera_unit(cameras: np.ndarray) -> float:
    """Metres in the unit in which (T, 4, 4) cameras lie within -1 and 1 around their mean."""
    positions = cameras[:, :3, 3]
    return float(np.abs(positions - positions.mean(axis=0)).max()) or 1.0


def large_pieces(mask: np.ndarray, fewest: int) -> np.ndarray:
    """(R, C) bool without its 4-connected pieces of fewer cells.

    Example:
        >>> large_pieces(np.array([[1, 1, 0, 1]], bool), 2).astype(int)
        array([[1, 1, 0, 0]])
    """
    labels, _ = ndimage.label(mask)
    return mask & (np.bincount(labels.ravel()) >= fewest)[labels]


def closed(mask: np.ndarray, min_hole: int = MIN_HOLE, radius: int = CLOSING) -> np.ndarray:
    """(R, C) bool with small holes filled and gaps closed by a disc; crumbs go where there is much else."""
    mask = ~large_pieces(~mask, min_hole)
    if mask.sum() > min_hole:
        mask = large_pieces(mask, 10)
    mask = ~large_pieces(grow(~mask, radius, 1.0), min_hole)
    return grow(mask, radius, 1.0)


def occupied_columns(field: Field, grid: Grid) -> np.ndarray:
    """(R, C) bool: columns that are opaque anywhere up to 1.50 m, without small pieces."""
    opaque = -np.log1p(-THRESHOLD) / (OPACITY_STEP * camera_unit(field.cameras))
    heights = BOTTOM + (np.arange(LEVELS) + 0.5) * (TOP - BOTTOM) / LEVELS
    occupied = np.zeros(grid.shape[0] * grid.shape[1], dtype=bool)
    for first in range(0, occupied.size, _SLAB):
        index = np.arange(first, min(first + _SLAB, occupied.size))
        places = grid.centers(np.stack(np.divmod(index, grid.shape[1]), axis=1))
        for height in heights:
            todo = np.flatnonzero(~occupied[index])
            points = np.concatenate([places[todo], np.full((len(todo), 1), height)], axis=1).astype(np.float32)
            occupied[index[todo]] = field.density(points) > opaque
    return large_pieces(occupied.reshape(grid.shape), MIN_PIECE)


def semantic_columns(points: np.ndarray, classes: np.ndarray, grid: Grid) -> np.ndarray:
    """(15, R, C) bool: which classes any point of a column has.

    Example:
        >>> grid = Grid(np.zeros(2), (1, 2), cell=1.0)
        >>> both = semantic_columns(np.array([[0.5, 0.5, 0.3]] * 2), np.array([4, 7]), grid)
        >>> np.argwhere(both).tolist()
        [[3, 0, 0], [6, 0, 0]]
    """
    within = (points[:, 2] >= BOTTOM) & (points[:, 2] <= TOP) & (classes > 0)
    cells, inside = grid.cells(points[within])
    columns = np.zeros((NUM_CLASSES - 1, *grid.shape), dtype=bool)
    columns[classes[within][inside].astype(int) - 1, cells[:, 0], cells[:, 1]] = True
    return columns


def binary_scores(predicted: np.ndarray, true: np.ndarray) -> tuple[float, float, float]:
    """Accuracy, precision and recall in percent; 0 where nothing can be divided.

    Example:
        >>> binary_scores(np.array([True, True, False, False]), np.array([True, False, False, False]))
        (75.0, 50.0, 100.0)
    """
    hit, guessed, wanted = int(np.sum(predicted & true)), int(predicted.sum()), int(true.sum())
    accuracy = 100 * float(np.mean(predicted == true))
    return accuracy, 100 * hit / guessed if guessed else 0.0, 100 * hit / wanted if wanted else 0.0


def map_scores(occupied: np.ndarray, columns: np.ndarray, truth: TrueMap) -> dict[str, float | None]:
    """The six scores of maps.

    Args:
        occupied: (R, C) bool.
        columns: (15, R, C) bool, of :func:`semantic_columns`.
        truth: on the same grid.
    """
    semantic = [
        binary_scores(closed(found & occupied), true) for found, true in zip(columns, truth.semantics, strict=True)
    ]
    values = (*binary_scores(~occupied, truth.free), *np.mean(semantic, axis=0).tolist())
    names = [f"{kind}_{score}" for kind in ("free", "semantic") for score in ("accuracy", "precision", "recall")]
    return dict(zip(names, values, strict=True))
