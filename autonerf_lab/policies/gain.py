"""What a robot would see of its own map from somewhere else: rays over the grid.

A ray runs from a cell until an obstacle stops it. A step of it stands for the ground between it and its neighbours, so
that the sums over rays are areas.
"""

import numpy as np
from numba import njit

RAYS = 72  # directions, counter-clockwise from world +x


@njit(cache=True)
def unknown_area(
    explored: np.ndarray, occupied: np.ndarray, row: int, col: int, near: float, reach: float
) -> np.ndarray:
    """Unexplored ground that could be seen from a cell.

    Args:
        explored: (M, M) bool.
        occupied: (M, M) bool.
        row: of the cell.
        col: of the cell.
        near: cells; ground nearer than this is not seen.
        reach: cells; nor is ground farther than this.

    Returns:
        (RAYS,) area in each direction, cells.
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
    """Explored ground that has never been seen from the direction of a cell: as :func:`unknown_area`.

    ``viewpoints`` is (12, M, M) bool. A ray counts the obstacle that stops it, several cells deep: surfaces are what
    views are for.
    """
    area = np.zeros(RAYS)
    size = explored.shape[0]
    bins = viewpoints.shape[0]
    for k in range(RAYS):
        angle = 2 * np.pi * (k + 0.5) / RAYS
        dr, dc = np.sin(angle), np.cos(angle)
        seen_from = int(((k + 0.5) / RAYS + 0.5) % 1.0 * bins)  # the direction back to the cell
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
