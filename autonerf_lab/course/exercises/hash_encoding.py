"""Exercises of notebook 07: cells of a level, the hash of a corner, trilinear weights.

The solutions are read by students: they say for one point what ``nerf.encodings`` does for many at once.
"""

from collections.abc import Callable

import numpy as np

from autonerf_lab.course.checker import Case, Exercise, Mistake

_PRIMES = (1, 2654435761, 805459861)


def cell_side(level: int, coarse: float, fine: float, levels: int) -> float:
    return coarse * (fine / coarse) ** (level / (levels - 1))  # equal ratios, from the first level to the last


def row(i: int, j: int, k: int, log2_entries: int) -> int:
    mixed = (i * 1) ^ (j * 2654435761) ^ (k * 805459861)  # exclusive or, bit by bit
    return mixed % 2**log2_entries


def corner_weights(x: float, y: float, z: float) -> np.ndarray:
    # corner c lies at (c & 1, (c >> 1) & 1, c >> 2): x changes fastest
    return np.array([wx * wy * wz for wz in (1 - z, z) for wy in (1 - y, y) for wx in (1 - x, x)])


def _mixed(i: int, j: int, k: int, mix: Callable[[int, int], int], primes: tuple[int, int, int] = _PRIMES) -> int:
    return mix(mix(i * primes[0], j * primes[1]), k * primes[2])


CELL_SIDE = Exercise(
    "07-cell-side",
    "The side of the cells of a level, metres; level 0 is the coarsest, and neighbouring levels have equal ratios.",
    (
        Case("level 0 of 5, from 0.8 m to 0.05 m", (0, 0.8, 0.05, 5), 0.8),
        Case("level 4 of 5, from 0.8 m to 0.05 m", (4, 0.8, 0.05, 5), 0.05),
        Case("level 1 of 5, from 0.8 m to 0.05 m", (1, 0.8, 0.05, 5), 0.4),
        Case("level 1 of 3, from 0.9 m to 0.1 m", (1, 0.9, 0.1, 3), 0.3),
    ),
    cell_side,
    (
        Mistake(
            "The sides differ by equal amounts here. They should differ by equal factors.",
            lambda level, a, b, n: a + (b - a) * level / (n - 1),
        ),
        Mistake(
            "The last level misses the finest cell: from the first to the last of n levels there are n - 1 steps.",
            lambda level, a, b, n: a * (b / a) ** (level / n),
        ),
        Mistake(
            "Halving at each level is right only when the finest is that many times smaller. Use both ends.",
            lambda level, a, b, n: a / 2**level,
        ),
        Mistake(
            "Level 0 is the coarsest: it is the other way round.",
            lambda level, a, b, n: b * (a / b) ** (level / (n - 1)),
        ),
    ),
)

ROW = Exercise(
    "07-row",
    "The row of a table of 2 ** log2_entries that the corner (i, j, k) is hashed to.",
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
            "The products are mixed by exclusive or, ^ in Python, and not by a sum.",
            lambda i, j, k, n: _mixed(i, j, k, lambda a, b: a + b) % 2**n,
        ),
        Mistake(
            "That is the bitwise or, |. Exclusive or, ^, is needed: a bit that both have becomes 0.",
            lambda i, j, k, n: _mixed(i, j, k, lambda a, b: a | b) % 2**n,
        ),
        Mistake(
            "The table has 2 ** log2_entries rows: divide by that, and keep the rest.",
            lambda i, j, k, n: _mixed(i, j, k, lambda a, b: a ^ b) % n,
        ),
        Mistake("The row lies far outside of the table: take it modulo its size.", lambda i, j, k, n: row(i, j, k, 64)),
        Mistake(
            "The primes have changed places: 2654435761 belongs to j, and 805459861 to k.",
            lambda i, j, k, n: _mixed(i, j, k, lambda a, b: a ^ b, (1, 805459861, 2654435761)) % 2**n,
        ),
    ),
)

CORNER_WEIGHTS = Exercise(
    "07-corner-weights",
    "Trilinear weights, (8,), of the corners of a cell; corner c lies at (c & 1, (c >> 1) & 1, c >> 2).",
    (
        Case("a point on corner 0", (0.0, 0.0, 0.0), np.array([1.0, 0, 0, 0, 0, 0, 0, 0])),
        Case("the middle of the cell", (0.5, 0.5, 0.5), np.full(8, 0.125)),
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
            "The far corner is the heaviest here. A point on corner 0 has all of its weight there.",
            lambda x, y, z: corner_weights(1 - x, 1 - y, 1 - z),
        ),
        Mistake(
            "The corners are in another order: bit 0 of c belongs to x, so x changes fastest.",
            lambda x, y, z: corner_weights(z, y, x),
        ),
        Mistake(
            "Three shares are multiplied, and not averaged: from the far side of the cell a corner weighs nothing.",
            lambda x, y, z: np.array([(a + b + c) / 12 for c in (1 - z, z) for b in (1 - y, y) for a in (1 - x, x)]),
        ),
        Mistake(
            "This is the nearest corner. Trilinear weights change smoothly from one corner to the next.",
            lambda x, y, z: np.eye(8)[round(x) + 2 * round(y) + 4 * round(z)],
        ),
    ),
)

EXERCISES = (CELL_SIDE, ROW, CORNER_WEIGHTS)
