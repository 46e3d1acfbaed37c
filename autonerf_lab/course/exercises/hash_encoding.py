"""Exercises of notebook 07: cell size of a level, hash of a corner, trilinear weights.

Students read the solutions. They compute for one point what ``nerf.encodings`` computes for a batch.
"""

from collections.abc import Callable

import numpy as np

from autonerf_lab.course.checker import Case, Exercise, Mistake

_PRIMES = (1, 2654435761, 805459861)


def cell_side(level: int, coarse: float, fine: float, levels: int) -> float:
    """Return the cell size of a level, metres."""
    return coarse * (fine / coarse) ** (level / (levels - 1))  # constant ratio between neighbouring levels


def row(i: int, j: int, k: int, log2_entries: int) -> int:
    """Return the row of corner (i, j, k) in the hash table."""
    hashed = (i * 1) ^ (j * 2654435761) ^ (k * 805459861)  # bitwise exclusive or
    return hashed % 2**log2_entries


def corner_weights(x: float, y: float, z: float) -> np.ndarray:
    """Return the trilinear weights (8,) of the corners of a cell."""
    # corner c is at (c & 1, (c >> 1) & 1, c >> 2): x changes fastest
    return np.array([wx * wy * wz for wz in (1 - z, z) for wy in (1 - y, y) for wx in (1 - x, x)])


def _hash(i: int, j: int, k: int, combine: Callable[[int, int], int], primes: tuple[int, int, int] = _PRIMES) -> int:
    return combine(combine(i * primes[0], j * primes[1]), k * primes[2])


CELL_SIDE = Exercise(
    "07-cell-side",
    "Return the cell size of a level, metres; level 0 is the coarsest, and the ratio between levels is constant.",
    (
        Case("level 0 of 5, from 0.8 m to 0.05 m", (0, 0.8, 0.05, 5), 0.8),
        Case("level 4 of 5, from 0.8 m to 0.05 m", (4, 0.8, 0.05, 5), 0.05),
        Case("level 1 of 5, from 0.8 m to 0.05 m", (1, 0.8, 0.05, 5), 0.4),
        Case("level 1 of 3, from 0.9 m to 0.1 m", (1, 0.9, 0.1, 3), 0.3),
    ),
    cell_side,
    (
        Mistake(
            "The cell sizes differ by equal amounts. They must differ by equal factors.",
            lambda level, a, b, n: a + (b - a) * level / (n - 1),
        ),
        Mistake(
            "The last level does not reach the finest cell: n levels have n - 1 steps between them.",
            lambda level, a, b, n: a * (b / a) ** (level / n),
        ),
        Mistake(
            "Halving at each level is correct only for one ratio of finest to coarsest. Use both sizes.",
            lambda level, a, b, n: a / 2**level,
        ),
        Mistake(
            "The order is reversed: level 0 is the coarsest.",
            lambda level, a, b, n: b * (a / b) ** (level / (n - 1)),
        ),
    ),
)

ROW = Exercise(
    "07-row",
    "Return the row of the corner (i, j, k) in a hash table of 2 ** log2_entries rows.",
    (
        Case("corner (1, 0, 0) in a table of 16", (1, 0, 0, 4), 1),
        Case("corner (1, 1, 1) in a table of 16", (1, 1, 1, 4), 5),
        Case("corner (20, 0, 0) in a table of 16", (20, 0, 0, 4), 4),
        Case("corner (3, 5, 2) in a table of 2 ** 14", (3, 5, 2, 14), 3932),
        Case("corner (40, 17, 9) in a table of 2 ** 18", (40, 17, 9, 18), 131284),
    ),
    row,
    (
        Mistake(
            "Combine the products with exclusive or, ^ in Python, not with a sum.",
            lambda i, j, k, n: _hash(i, j, k, lambda a, b: a + b) % 2**n,
        ),
        Mistake(
            "This is the bitwise or, |. Use exclusive or, ^: a bit that is set in both operands becomes 0.",
            lambda i, j, k, n: _hash(i, j, k, lambda a, b: a | b) % 2**n,
        ),
        Mistake(
            "The table has 2 ** log2_entries rows: take the hash modulo that number.",
            lambda i, j, k, n: _hash(i, j, k, lambda a, b: a ^ b) % n,
        ),
        Mistake(
            "The row is outside the table: take the hash modulo the table size.", lambda i, j, k, n: row(i, j, k, 64)
        ),
        Mistake(
            "The primes are swapped: 2654435761 belongs to j, 805459861 to k.",
            lambda i, j, k, n: _hash(i, j, k, lambda a, b: a ^ b, (1, 805459861, 2654435761)) % 2**n,
        ),
    ),
    integers=True,
)

CORNER_WEIGHTS = Exercise(
    "07-corner-weights",
    "Return the trilinear weights, (8,), of the corners of a cell; corner c is at (c & 1, (c >> 1) & 1, c >> 2).",
    (
        Case("a point on corner 0", (0.0, 0.0, 0.0), np.array([1.0, 0, 0, 0, 0, 0, 0, 0])),
        Case("the centre of the cell", (0.5, 0.5, 0.5), np.full(8, 0.125)),
        Case("x = 0.25, y = 0, z = 1", (0.25, 0.0, 1.0), np.array([0, 0, 0, 0, 0.75, 0.25, 0, 0])),
        Case(
            "x = 0.5, y = 0.2, z = 0",
            (0.5, 0.2, 0.0),
            np.array([0.4, 0.4, 0.1, 0.1, 0, 0, 0, 0]),
        ),
    ),
    corner_weights,
    (
        Mistake(
            "The weights are reversed: at corner 0, its own weight is 1.",
            lambda x, y, z: corner_weights(1 - x, 1 - y, 1 - z),
        ),
        Mistake(
            "The order of the corners is wrong: bit 0 of c belongs to x, so x changes fastest.",
            lambda x, y, z: corner_weights(z, y, x),
        ),
        Mistake(
            "Multiply the three factors, do not average them: at the opposite side of the cell a weight is 0.",
            lambda x, y, z: np.array([(a + b + c) / 12 for c in (1 - z, z) for b in (1 - y, y) for a in (1 - x, x)]),
        ),
        Mistake(
            "This selects the nearest corner. Trilinear weights change continuously between corners.",
            lambda x, y, z: np.eye(8)[round(x) + 2 * round(y) + 4 * round(z)],
        ),
    ),
)

EXERCISES = (CELL_SIDE, ROW, CORNER_WEIGHTS)
