"""Operations on the masks of a grid: dilation of obstacles, the rectangle of the set cells, the nearest set cell."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def dilate(mask: np.ndarray, radius: float) -> np.ndarray:
    """Dilate a mask by a disc: set all cells whose centre is within ``radius`` of the centre of a set cell.

    Args:
        mask: (R, C) bool.
        radius: radius of the disc, cells. The run time is proportional to it.

    Returns:
        (R, C) bool.

    Example:
        >>> dilate(np.array([[False, False, True, False]]), 1).tolist()
        [[False, True, True, True]]
    """
    rows, cols = mask.shape
    reach = int(radius)
    out = np.zeros((rows, cols), np.bool_)
    nearest = np.empty(cols, np.int32)  # columns to the nearest set cell of the row
    for row in range(rows):
        count = 0
        for col in range(cols):
            count += mask[row, col]
        if count == 0:
            continue
        gap = cols + reach + 1
        for col in range(cols):
            gap = 0 if mask[row, col] else gap + 1
            nearest[col] = gap
        gap = cols + reach + 1
        for col in range(cols - 1, -1, -1):
            gap = 0 if mask[row, col] else gap + 1
            nearest[col] = min(nearest[col], gap)
        for r in range(max(0, row - reach), min(rows, row + reach + 1)):
            half = reach  # columns of the disc to each side in row r
            while half >= 0 and (r - row) ** 2 + half**2 > radius * radius:
                half -= 1
            for col in range(cols):
                out[r, col] |= nearest[col] <= half
    return out


def bounding_box(mask: np.ndarray) -> tuple[int, int, int, int]:
    """Return the first row, the end of the rows, the first column and the end of the columns that contain set cells.

    Args:
        mask: (R, C) bool; all four are 0 if no cell is set.

    Example:
        >>> bounding_box(np.eye(5, dtype=np.bool_)[:, 2:])
        (2, 5, 0, 3)
    """
    rows = np.flatnonzero(mask.any(axis=1))
    if not len(rows):
        return 0, 0, 0, 0
    top, bottom = int(rows[0]), int(rows[-1]) + 1
    cols = np.flatnonzero(mask[top:bottom].any(axis=0))
    return top, bottom, int(cols[0]), int(cols[-1]) + 1


@njit(cache=True, nogil=True)
def nearest_set_cell(mask: np.ndarray, row: int, col: int) -> tuple[int, int]:
    """Return the set cell nearest to a cell; of several, the first one in the order of rows and columns.

    Args:
        mask: (R, C) bool with a set cell; without, the result is (-1, -1).
        row: row of the cell.
        col: column of the cell.

    Example:
        >>> nearest_set_cell(np.array([[True, False, False, False, True]]), 0, 2)
        (0, 0)
    """
    best, best_row, best_col = np.inf, -1, -1
    for ring in range(max(mask.shape)):
        if ring * ring > best:
            break
        for r in range(max(0, row - ring), min(mask.shape[0], row + ring + 1)):
            step = 1 if abs(r - row) == ring else 2 * ring  # whole sides above and below, one cell left and right
            for c in range(col - ring, col + ring + 1, step):
                if not (0 <= c < mask.shape[1] and mask[r, c]):
                    continue
                squared = (r - row) ** 2 + (c - col) ** 2
                if squared < best or (squared == best and (r, c) < (best_row, best_col)):
                    best, best_row, best_col = squared, r, c
    return best_row, best_col


def resized(mask: np.ndarray | None, size: int) -> np.ndarray:
    """Return the mask of a map that grew from the middle, or an empty one if there is none or it does not fit.

    Args:
        mask: (R, R) bool, or None.
        size: M, cells a side of the grown map.

    Returns:
        (M, M) bool.

    Example:
        >>> resized(np.ones((1, 1), np.bool_), 3).astype(int).tolist()
        [[0, 0, 0], [0, 1, 0], [0, 0, 0]]
    """
    border, odd = divmod(size - (size if mask is None else len(mask)), 2)
    return np.zeros((size, size), np.bool_) if mask is None or odd or border < 0 else np.pad(mask, border)
