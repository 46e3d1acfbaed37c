"""Grow the obstacles of a grid by a radius."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def dilate(mask: np.ndarray, radius: float) -> np.ndarray:
    """Cells whose centre is within ``radius`` cells of a set cell's centre.

    Args:
        mask: (R, C) bool, few of them set: the time is the number of set cells times the disc's.
        radius: cells.

    Returns:
        (R, C) bool.

    Example:
        >>> dilate(np.array([[False, False, True, False]]), 1).tolist()
        [[False, True, True, True]]
    """
    rows, cols = mask.shape
    reach = int(radius)
    out = np.zeros((rows, cols), np.bool_)
    for row in range(rows):
        for col in range(cols):
            if not mask[row, col]:
                continue
            for r in range(max(0, row - reach), min(rows, row + reach + 1)):
                for c in range(max(0, col - reach), min(cols, col + reach + 1)):
                    if (r - row) ** 2 + (c - col) ** 2 <= radius * radius:
                        out[r, c] = True
    return out
