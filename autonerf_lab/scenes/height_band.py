"""Rasterisation of a mesh between two heights into a grid of occupied cells. Exact up to rounding, and conservative.

Each triangle is clipped to the height band and projected onto the floor plan. Every cell that the remaining convex
polygon touches (a segment, for a vertical wall) is occupied. Cells are half open: cell [r, c] contains x in [c, c + 1)
and y in [r, r + 1), in cells from the origin.
"""

import numpy as np
from numba import njit


@njit(cache=True)
def _clip(polygon: np.ndarray, count: int, axis: int, limit: float, sign: float, out: np.ndarray) -> int:
    """Clip a polygon to sign * (p[axis] - limit) >= 0 (Sutherland-Hodgman); return its number of corners."""
    corners = 0
    for i in range(count):
        j = (i + 1) % count
        a = sign * (polygon[i, axis] - limit)
        b = sign * (polygon[j, axis] - limit)
        if a >= 0:
            out[corners] = polygon[i]
            corners += 1
        if (a > 0 and b < 0) or (a < 0 and b > 0):
            f = a / (a - b)
            for k in range(3):
                out[corners, k] = polygon[i, k] + f * (polygon[j, k] - polygon[i, k])
            out[corners, axis] = limit  # no rounding error: the cut lies exactly on the plane
            corners += 1
    return corners


@njit(cache=True)
def _rasterise(triangles: np.ndarray, z_min: float, z_max: float, grid: np.ndarray) -> None:
    """Set ``grid`` to True where triangles, x and y in cells, are between the heights."""
    rows, cols = grid.shape
    a, b, c = np.empty((16, 3)), np.empty((16, 3)), np.empty((16, 3))
    for f in range(triangles.shape[0]):
        for k in range(3):
            a[k] = triangles[f, k]
        low, high = min(a[0, 2], a[1, 2], a[2, 2]), max(a[0, 2], a[1, 2], a[2, 2])
        if high < z_min or low > z_max:
            continue
        n = _clip(a, 3, 2, z_min, 1.0, b)
        n = _clip(b, n, 2, z_max, -1.0, a)
        if n == 0:
            continue
        y_low, y_high = a[0, 1], a[0, 1]
        for k in range(1, n):
            y_low, y_high = min(y_low, a[k, 1]), max(y_high, a[k, 1])
        for row in range(max(0, int(np.floor(y_low))), min(rows - 1, int(np.floor(y_high))) + 1):
            m = _clip(a, n, 1, float(row), 1.0, b)
            m = _clip(b, m, 1, float(row + 1), -1.0, c)
            if m == 0:
                continue
            x_low, x_high = c[0, 0], c[0, 0]
            for k in range(1, m):
                x_low, x_high = min(x_low, c[k, 0]), max(x_high, c[k, 0])
            for col in range(max(0, int(np.floor(x_low))), min(cols - 1, int(np.floor(x_high))) + 1):
                grid[row, col] = True


def occupied_cells(
    vertices: np.ndarray,
    faces: np.ndarray,
    z_min: float,
    z_max: float,
    origin: np.ndarray | tuple[float, float],
    cell: float,
    shape: tuple[int, int],
) -> np.ndarray:
    """Return the cells in which a mesh has surface between two heights.

    Args:
        vertices: (V, 3) world frame, metres.
        faces: (F, 3) vertex indices.
        z_min: Lower end of the band, metres; a surface exactly at either end counts.
        z_max: Upper end of the band, metres.
        origin: (2,) world x, y of the outer corner of cell [0, 0], metres.
        cell: Side of a cell, metres.
        shape: (rows, columns) of the grid; surface outside it is ignored.

    Returns:
        (rows, columns) bool, True where occupied.

    Example:
        A vertical wall along x at y = 0.5, one metre long, on 25 cm cells:

        >>> wall = np.array([[0, 0.55, 0], [0.9, 0.55, 0], [0.9, 0.55, 2], [0, 0.55, 2.0]])
        >>> occupied_cells(wall, np.array([[0, 1, 2], [0, 2, 3]]), 0.1, 0.9, (0, 0), 0.25, (3, 5)).astype(int)
        array([[0, 0, 0, 0, 0],
               [0, 0, 0, 0, 0],
               [1, 1, 1, 1, 0]])
    """
    grid = np.zeros(shape, dtype=np.bool_)
    scaled = np.asarray(vertices, dtype=np.float64).copy()
    scaled[:, :2] = (scaled[:, :2] - np.asarray(origin, dtype=np.float64)) / cell
    if len(faces):
        _rasterise(scaled[np.asarray(faces)], float(z_min), float(z_max), grid)
    return grid
