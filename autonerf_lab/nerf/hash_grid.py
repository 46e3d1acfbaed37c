"""Layout of a multi-resolution hash table (Müller et al. 2022)."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class HashGrid:
    """Layout of a multi-resolution table: L levels with 2 features per entry, concatenated in one array."""

    resolutions: np.ndarray  # (L, 3) int64, cells along each axis
    offsets: np.ndarray  # (L,) int64, first entry of each level
    masks: np.ndarray  # (L,) int64, table size - 1 where the level is hashed, 0 where it is dense
    entries: int  # of all levels

    @classmethod
    def build(cls, size: np.ndarray, coarse: float, fine: float, levels: int, log2_entries: int) -> "HashGrid":
        """Return a grid of cubic cells, whose side goes from ``coarse`` to ``fine`` metres in equal ratios.

        Args:
            size: (3,) size of the unit cube, metres.
            coarse: side of the largest cells, metres.
            fine: side of the smallest cells, metres.
            levels: number of levels.
            log2_entries: a level has at most 2 ** log2_entries entries; a larger one is hashed.

        Example:
            >>> grid = HashGrid.build(np.array([4.0, 4.0, 2.0]), 1.0, 0.25, levels=3, log2_entries=9)
            >>> grid.resolutions.tolist(), grid.masks.tolist()
            ([[4, 4, 2], [8, 8, 4], [16, 16, 8]], [0, 0, 511])
        """
        cells = np.geomspace(coarse, fine, levels)
        resolutions = np.maximum(np.ceil(size / cells[:, None] - 1e-9), 1).astype(np.int64)
        corners = np.prod(resolutions + 1.0, axis=1)  # float: those of a large scene exceed int64
        hashed = corners > 2**log2_entries
        sizes = np.where(hashed, 2**log2_entries, corners).astype(np.int64)
        offsets = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64)
        return cls(resolutions, offsets, np.where(hashed, sizes - 1, 0).astype(np.int64), int(sizes.sum()))
