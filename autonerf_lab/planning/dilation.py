"""Dilation of obstacles on a grid."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def dilate(mask: np.ndarray, radius: float) -> np.ndarray:
    """Dilate a mask by a disc: set all cells whose centre is within ``radius`` of the centre of a set cell.

    Args:
        mask: (R, C) bool; the run time is proportional to the number of set cells.
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
