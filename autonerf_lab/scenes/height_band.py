"""Which columns of a grid does a mesh occupy between two heights? Exact up to rounding, and conservative.

A triangle is clipped to the height band and dropped on the floor plan; every cell that the remaining convex polygon (a
segment, for a vertical wall) touches is occupied. Cells are half open: cell [r, c] holds x in [c, c + 1) and y in
[r, r + 1), in cells from the origin.
"""

import numpy as np
from numba import njit


@njit(cache=True)
def _clip(polygon: np.ndarray, count: int, axis: int, limit: float, sign: float, out: np.ndarray) -> int:
    """Sutherland-Hodgman: keep the part with sign * (p[axis] - limit) >= 0."""
    kept = 0
    for i in range(count):
        j = (i + 1) % count
        a = sign * (polygon[i, axis] - limit)
        b = sign * (polygon[j, axis] - limit)
        if a >= 0:
            out[kept] = polygon[i]
            kept += 1
        if (a > 0 and b < 0) or (a < 0 and b > 0):
            f = a / (a - b)
            for k in range(3):
                out[kept, k] = polygon[i, k] + f * (polygon[j, k] - polygon[i, k])
            out[kept, axis] = limit  # no rounding: the cut lies on the plane
            kept += 1
    return kept


@njit(cache=True)
def _rasterise(triangles: np.ndarray, z_min: float, z_max: float, grid: np.ndarray) -> None:
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


def occupied_columns(
    vertices: np.ndarray,
    faces: np.ndarray,
    z_min: float,
    z_max: float,
    origin: np.ndarray | tuple[float, float],
    cell: float,
    shape: tuple[int, int],
) -> np.ndarray:
    """Cells whose column holds a piece of surface between two heights.

    Args:
        vertices: (V, 3) metres, world frame.
        faces: (F, 3) vertex indices.
        z_min: lower end of the band, metres (a surface exactly on either end counts).
        z_max: upper end of the band.
        origin: world x, y of the outer corner of cell [0, 0].
        cell: side of a cell, metres.
        shape: (rows, columns) of the grid; what lies outside is ignored.

    Returns:
        (rows, columns) bool, True where occupied.

    Example:
        A vertical wall along x at y = 0.5, one metre long, on 25 cm cells:

        >>> wall = np.array([[0, 0.55, 0], [0.9, 0.55, 0], [0.9, 0.55, 2], [0, 0.55, 2.0]])
        >>> occupied_columns(wall, np.array([[0, 1, 2], [0, 2, 3]]), 0.1, 0.9, (0, 0), 0.25, (3, 5)).astype(int)
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
