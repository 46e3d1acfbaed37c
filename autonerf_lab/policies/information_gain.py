"""What a robot would see of its own map from somewhere else: rays over the grid.

A ray runs from a cell until an obstacle stops it. A step of it stands for the ground between it and its neighbours, so
that the sums over rays are areas.
"""

import numpy as np
from numba import njit

RAYS = 72  # directions, counter-clockwise from world +x
SPARSE = 2


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


@njit(cache=True, nogil=True)
def outlook(explored: np.ndarray, occupied: np.ndarray, viewpoints: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """What a robot that turned around would see from each of several places, in every ``SPARSE``-th direction.

    Args:
        explored: (M, M) bool.
        occupied: (M, M) bool.
        viewpoints: (12, M, M) bool.
        cells: (K, 2) places, row and column.

    Returns:
        (K, 3) float32, cells: unseen ground up to the first obstacle; ground that was seen, but never from there;
        obstacle cells that were never seen from there. Rays are as long as the depth sensor sees on a map of 10 cm.
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
