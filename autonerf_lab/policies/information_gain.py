"""Expected gain of a view from a cell of the map, by ray casting on the grid.

A ray runs from a cell to the first obstacle. Each step of a ray represents the area between it and the neighbouring
rays, so sums over rays are areas.
"""

import numpy as np
from numba import njit

RAYS = 72  # directions, counter-clockwise from world +x
SPARSE = 2  # :func:`panoramic_gain` casts every second ray


@njit(cache=True)
def unknown_area(
    explored: np.ndarray, occupied: np.ndarray, row: int, col: int, near: float, reach: float
) -> np.ndarray:
    """Compute the unexplored area visible from a cell.

    Args:
        explored: (M, M) bool.
        occupied: (M, M) bool.
        row: row of the cell.
        col: column of the cell.
        near: minimum distance that counts, cells.
        reach: maximum distance that counts, cells.

    Returns:
        (RAYS,) float64, area in each direction, cells.
    """
    area = np.zeros(RAYS)
    size = explored.shape[0]
    for k in range(RAYS):
        angle = 2 * np.pi * (k + 0.5) / RAYS
        dr, dc = np.sin(angle), np.cos(angle)
        distance = 1.0
        while distance <= reach:
            r, c = int(np.floor(row + 0.5 + dr * distance)), int(np.floor(col + 0.5 + dc * distance))
            if r < 0 or c < 0 or r >= size or c >= size or occupied[r, c]:
                break
            if distance >= near and not explored[r, c]:
                area[k] += distance * 2 * np.pi / RAYS
            distance += 1.0
    return area


@njit(cache=True)
def new_views(
    explored: np.ndarray,
    occupied: np.ndarray,
    viewpoints: np.ndarray,
    row: int,
    col: int,
    near: float,
    reach: float,
) -> np.ndarray:
    """Compute the explored area that would be seen from a new direction.

    Arguments and result as in :func:`unknown_area`, with ``viewpoints`` (12, M, M) bool. The obstacle cell that ends a
    ray counts four times, because surfaces matter most for a radiance field.
    """
    area = np.zeros(RAYS)
    size = explored.shape[0]
    bins = viewpoints.shape[0]
    for k in range(RAYS):
        angle = 2 * np.pi * (k + 0.5) / RAYS
        dr, dc = np.sin(angle), np.cos(angle)
        seen_from = int(((k + 0.5) / RAYS + 0.5) % 1.0 * bins)  # direction from the seen cell back to (row, col)
        distance = 1.0
        while distance <= reach:
            r, c = int(np.floor(row + 0.5 + dr * distance)), int(np.floor(col + 0.5 + dc * distance))
            if r < 0 or c < 0 or r >= size or c >= size:
                break
            if distance >= near and explored[r, c] and not viewpoints[seen_from, r, c]:
                area[k] += distance * 2 * np.pi / RAYS * (4.0 if occupied[r, c] else 1.0)
            if occupied[r, c]:
                break
            distance += 1.0
    return area


@njit(cache=True, nogil=True)
def panoramic_gain(explored: np.ndarray, occupied: np.ndarray, viewpoints: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Compute the gain of a full turn at each of several cells, from every ``SPARSE``-th ray.

    Args:
        explored: (M, M) bool.
        occupied: (M, M) bool.
        viewpoints: (12, M, M) bool.
        cells: (K, 2) rows and columns.

    Returns:
        (K, 3) float32, cells: unexplored ground up to the first obstacle; explored ground seen from a new direction;
        obstacles seen from a new direction. Rays have the range of the depth sensor on a map with cells of 10 cm.
    """
    size, bins = explored.shape[0], viewpoints.shape[0]
    rays = RAYS // SPARSE
    sector = 2 * np.pi / rays
    out = np.zeros((len(cells), 3), np.float32)
    for k in range(rays):
        turn = (k + 0.5) / rays
        dr, dc = np.sin(2 * np.pi * turn), np.cos(2 * np.pi * turn)
        seen_from = int((turn + 0.5) % 1.0 * bins)
        for i in range(len(cells)):
            row, col = cells[i, 0] + 0.5, cells[i, 1] + 0.5
            for distance in range(5, 50):
                r, c = int(np.floor(row + dr * distance)), int(np.floor(col + dc * distance))
                if r < 0 or c < 0 or r >= size or c >= size:
                    break
                if occupied[r, c]:
                    if not viewpoints[seen_from, r, c]:
                        out[i, 2] += distance * sector
                    break
                if not explored[r, c]:
                    out[i, 0] += distance * sector
                elif not viewpoints[seen_from, r, c]:
                    out[i, 1] += distance * sector
    return out
