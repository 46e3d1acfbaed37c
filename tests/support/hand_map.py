"""True maps drawn as text."""

import numpy as np

from autonerf_lab.evaluators.ground_truth import MapGrid, TrueMap


def hand_map(rows: list[str], cell: float = 0.01) -> TrueMap:
    """Return a map: '#' occupied, '.' free, ' ' ignored, a digit: occupied by that class."""
    letters = np.array([list(row) for row in rows])
    occupied = (letters != ".") & (letters != " ")
    semantics = np.stack([letters == str(k) for k in range(1, 16)])
    return TrueMap(MapGrid(np.zeros(2), letters.shape, cell), occupied, occupied, letters == ".", semantics)
