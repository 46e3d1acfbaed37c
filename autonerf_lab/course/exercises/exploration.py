"""Exercises of notebook 03: the frontier, the utility of a waypoint, probabilities from scores.

Students read the solutions. They compute in a few lines what ``policies.frontier`` and ``policies.networks`` compute.
"""

import numpy as np
from scipy import special

from autonerf_lab.course.checker import Case, Exercise, Mistake


def frontier(explored: np.ndarray, occupied: np.ndarray) -> np.ndarray:
    """Return the free cells that have an unknown 4-neighbour, (M, M) bool."""
    unknown = np.pad(~explored, 1)  # cells outside the map do not count as unknown
    touches = unknown[:-2, 1:-1] | unknown[2:, 1:-1] | unknown[1:-1, :-2] | unknown[1:-1, 2:]
    return explored & ~occupied & touches


def utility(gain: float, distance: float, rotation: float) -> float:
    """Return the gain per step, m2, of a waypoint from its distance (m) and rotation (rad)."""
    steps = distance / 0.25 + abs(rotation) / np.radians(30) + 4
    return gain / steps


def probabilities(scores: np.ndarray, reachable: np.ndarray) -> np.ndarray:
    """Return (R, C) probabilities: the softmax of (R, C) scores over the reachable map blocks, 0 elsewhere."""
    highest = scores[reachable].max()  # subtracting it prevents an overflow and changes no probability
    weights = np.exp(np.where(reachable, scores - highest, -np.inf))
    return weights / weights.sum()


def _neighbours(mask: np.ndarray, border: bool = False, corners: bool = False) -> np.ndarray:
    """Return True for cells with a set 4-neighbour, or 8-neighbour with ``corners``; cells outside are ``border``."""
    rows, cols = mask.shape
    padded, result = np.pad(mask, 1, constant_values=border), np.zeros_like(mask)
    for row, col in np.ndindex(3, 3):
        if corners or (row + col) % 2:
            result |= padded[row : row + rows, col : col + cols]
    return result


def _rolled(mask: np.ndarray) -> np.ndarray:
    moves = ((1, 0), (-1, 0), (1, 1), (-1, 1))
    return np.logical_or.reduce([np.roll(mask, shift, axis) for shift, axis in moves])


def _softmax(scores: np.ndarray) -> np.ndarray:
    weights = np.exp(scores - scores.max())
    return weights / weights.sum()


def _map(*rows: str) -> tuple[np.ndarray, np.ndarray]:
    """Return explored and occupied cells: "." is free, "#" an obstacle and " " unknown."""
    cells = np.array([list(row) for row in rows])
    return cells != " ", cells == "#"


_ROOM = _map("#####", "#....", "#... ", "#..  ", "##   ")
_CORNER = _map("...", "...", ".. ")
_AT_THE_BORDER = _map("...", " ..", "...")
_ALL = np.ones(3, bool)

FRONTIER = Exercise(
    "03-frontier",
    "Return the frontier, (M, M) bool: free cells with an unknown 4-neighbour.",
    (
        Case(
            "a room whose lower right is unknown",
            _ROOM,
            np.array([[0, 0, 0, 0, 0], [0, 0, 0, 0, 1], [0, 0, 0, 1, 0], [0, 0, 1, 0, 0], [0, 0, 0, 0, 0]]),
        ),
        Case("3 x 3 cells, all free except an unknown corner", _CORNER, np.array([[0, 0, 0], [0, 0, 1], [0, 1, 0]])),
        Case(
            "3 x 3 cells, all free except an unknown cell at the left border",
            _AT_THE_BORDER,
            np.array([[1, 0, 0], [0, 1, 0], [1, 0, 0]]),
        ),
    ),
    frontier,
    (
        Mistake(
            "These are the unknown cells next to free ones. The frontier consists of the free cells.",
            lambda explored, occupied: ~explored & _neighbours(explored & ~occupied),
        ),
        Mistake("Occupied cells are not part of the frontier. Use only free cells.", lambda e, o: e & _neighbours(~e)),
        Mistake(
            "Diagonal neighbours do not count: use the four neighbours above, below, left and right.",
            lambda e, o: e & ~o & _neighbours(~e, corners=True),
        ),
        Mistake(
            "The border of the map became a frontier. Cells outside the array do not count as unknown.",
            lambda e, o: e & ~o & _neighbours(~e, border=True),
        ),
        Mistake(
            "np.roll wraps around: cells at one border become neighbours of the opposite border. Pad the map instead.",
            lambda e, o: e & ~o & _rolled(~e),
        ),
    ),
)

UTILITY = Exercise(
    "03-utility",
    "Return the gain per step, m2: forward steps of 25 cm, rotations of 30 degrees, and 4 steps per waypoint.",
    (
        Case("6 m2, 2 m away, straight ahead", (6.0, 2.0, 0.0), 0.5),
        Case("6 m2, 1 m away, 120 degrees to the left", (6.0, 1.0, np.radians(120)), 0.5),
        Case("6 m2, 1 m away, 120 degrees to the right", (6.0, 1.0, -np.radians(120)), 0.5),
        Case("2 m2 from the current position", (2.0, 0.0, 0.0), 0.5),
    ),
    utility,
    (
        Mistake(
            "The distance is in metres: divide it by 0.25 m to get steps.",
            lambda g, d, r: g / (d + abs(r) / np.radians(30) + 4),
        ),
        Mistake(
            "A rotation to the right is negative but costs as many steps as one to the left. Use abs.",
            lambda g, d, r: g / (d / 0.25 + r / np.radians(30) + 4),
        ),
        Mistake(
            "The rotation is in radians: divide it by np.radians(30) to get steps.",
            lambda g, d, r: g / (d / 0.25 + abs(r) + 4),
        ),
        Mistake("The steps for the rotation are missing.", lambda g, d, r: g / (d / 0.25 + 4)),
        Mistake(
            "The 4 steps per waypoint are missing: without them, small gains nearby get the highest utility.",
            lambda g, d, r: g / (d / 0.25 + abs(r) / np.radians(30)),
        ),
        Mistake(
            "Divide the gain by the steps instead of subtracting them: the units differ.",
            lambda g, d, r: g - (d / 0.25 + abs(r) / np.radians(30) + 4),
        ),
        Mistake("The fraction is inverted: this is steps per square metre.", lambda g, d, r: 1 / utility(g, d, r)),
    ),
)

PROBABILITIES = Exercise(
    "03-chances",
    "Return the probability of each block: softmax of `scores` over the reachable blocks, 0 for the others.",
    (
        Case(
            "scores of 0, ln 2 and ln 5, all reachable", (np.log([1.0, 2.0, 5.0]), _ALL), np.array([0.125, 0.25, 0.625])
        ),
        Case(
            "scores of 0, ln 3 and 9, the last not reachable",
            (np.array([0.0, np.log(3), 9.0]), np.array([True, True, False])),
            np.array([0.25, 0.75, 0.0]),
        ),
        Case(
            "scores of 1000 and 1000 + ln 3",
            (np.array([1000.0, 1000.0 + np.log(3)]), _ALL[:2]),
            np.array([0.25, 0.75]),
        ),
        Case(
            "2 x 2 blocks with scores of 0, ln 2; ln 3, 2000, the last not reachable",
            (np.array([[0.0, np.log(2)], [np.log(3), 2000.0]]), np.array([[True, True], [True, False]])),
            np.array([[1 / 6, 1 / 3], [1 / 2, 0.0]]),
        ),
    ),
    probabilities,
    (
        Mistake("Unreachable blocks must have probability 0: use `reachable`.", lambda s, t: _softmax(s)),
        Mistake(
            "The blocks of a map have two axes. Normalise over all of them, not along one axis.",
            lambda s, t: special.softmax(np.where(t, s, -np.inf), axis=-1),
        ),
        Mistake(
            "This normalises each column. Normalise over all blocks, not along one axis.",
            lambda s, t: special.softmax(np.where(t, s, -np.inf), axis=0),
        ),
        Mistake(
            "An unreachable block may have the highest score; then all others underflow to 0. Subtract the highest "
            "reachable score.",
            lambda s, t: np.exp(s - s.max()) * t / np.sum(np.exp(s - s.max()) * t),
        ),
        Mistake(
            "A score of 0 is not a probability of 0, because exp(0) is 1. Set the weights to 0 after exp.",
            lambda s, t: _softmax(s * t),
        ),
        Mistake(
            "The probabilities do not sum to 1: normalise after setting the unreachable blocks to 0.",
            lambda s, t: _softmax(s) * t,
        ),
        Mistake(
            "exp(1000) overflows. Subtract the highest score first; this changes no probability.",
            lambda s, t: np.where(t, np.exp(s), 0) / np.sum(np.exp(s[t])),
        ),
        Mistake(
            "exp(1000) overflows, and infinity * 0 is NaN. Subtract the highest reachable score first.",
            lambda s, t: np.exp(s) * t / np.sum(np.exp(s) * t),
        ),
        Mistake(
            "This is argmax: only the best block gets a probability. Softmax also gives the others a probability.",
            lambda s, t: 1.0 * (np.where(t, s, -np.inf) == s[t].max()),
        ),
        Mistake(
            "Scores may be negative: normalise their exponentials, not the scores.", lambda s, t: s * t / np.sum(s * t)
        ),
    ),
)

EXERCISES = (FRONTIER, UTILITY, PROBABILITIES)
