"""Exercises of notebook 03: the frontier, what a place is worth, chances from scores.

The solutions are read by students: they say in a few lines what ``policies.frontier`` and ``.networks`` compute.
"""

import numpy as np

from autonerf_lab.course.checker import Case, Exercise, Mistake


def frontier(explored: np.ndarray, occupied: np.ndarray) -> np.ndarray:
    unknown = np.pad(~explored, 1)  # beyond the edge of the map there is nothing to discover
    beside = unknown[:-2, 1:-1] | unknown[2:, 1:-1] | unknown[1:-1, :-2] | unknown[1:-1, 2:]
    return explored & ~occupied & beside


def utility(gain: float, metres: float, turn: float) -> float:
    steps = metres / 0.25 + abs(turn) / np.radians(30) + 4
    return gain / steps


def chances(scores: np.ndarray, there: np.ndarray) -> np.ndarray:
    highest = scores[there].max()  # takes nothing away from the chances, and keeps exp from overflowing
    weights = np.exp(np.where(there, scores - highest, -np.inf))
    return weights / weights.sum()


def _beside(mask: np.ndarray, rim: bool = False, corners: bool = False) -> np.ndarray:
    """Cells with a set one above, below, left or right, or at a corner; what lies outside is ``rim``."""
    rows, cols = mask.shape
    wide, found = np.pad(mask, 1, constant_values=rim), np.zeros_like(mask)
    for row, col in np.ndindex(3, 3):
        if corners or (row + col) % 2:
            found |= wide[row : row + rows, col : col + cols]
    return found


def _rolled(mask: np.ndarray) -> np.ndarray:
    moves = ((1, 0), (-1, 0), (1, 1), (-1, 1))
    return np.logical_or.reduce([np.roll(mask, shift, axis) for shift, axis in moves])


def _softmax(scores: np.ndarray) -> np.ndarray:
    weights = np.exp(scores - scores.max())
    return weights / weights.sum()


def _map(*rows: str) -> tuple[np.ndarray, np.ndarray]:
    """Explored and occupied: "." is free, "#" an obstacle, and " " is what nobody has seen."""
    cells = np.array([list(row) for row in rows])
    return cells != " ", cells == "#"


_ROOM = _map("#####", "#....", "#... ", "#..  ", "##   ")
_CORNER = _map("...", "...", ".. ")
_TO_THE_RIM = _map("...", " ..", "...")
_ALL = np.ones(3, bool)

FRONTIER = Exercise(
    "03-frontier",
    "Which cells are the frontier, (M, M) bool: free, and beside one that nobody has seen.",
    (
        Case(
            "a room whose lower right is unseen",
            _ROOM,
            np.array([[0, 0, 0, 0, 0], [0, 0, 0, 0, 1], [0, 0, 0, 1, 0], [0, 0, 1, 0, 0], [0, 0, 0, 0, 0]]),
        ),
        Case("3 x 3 cells, all free, one corner unseen", _CORNER, np.array([[0, 0, 0], [0, 0, 1], [0, 1, 0]])),
        Case("3 x 3 cells, the left middle unseen", _TO_THE_RIM, np.array([[1, 0, 0], [0, 1, 0], [1, 0, 0]])),
    ),
    frontier,
    (
        Mistake(
            "These are the unseen cells beside the known. The frontier is on this side, where the robot can stand.",
            lambda explored, occupied: ~explored & _beside(explored & ~occupied),
        ),
        Mistake("A wall beside the unseen is no frontier: free cells only.", lambda e, o: e & _beside(~e)),
        Mistake(
            "Corners do not touch: the four neighbours above, below, left and right are meant.",
            lambda e, o: e & ~o & _beside(~e, corners=True),
        ),
        Mistake(
            "The map's edge has become a frontier: what lies outside of the array is not to be discovered.",
            lambda e, o: e & ~o & _beside(~e, rim=True),
        ),
        Mistake(
            "np.roll takes the left edge for the right neighbour of the right one. Pad the map instead.",
            lambda e, o: e & ~o & _rolled(~e),
        ),
    ),
)

UTILITY = Exercise(
    "03-utility",
    "What a place brings a step, m2: steps of 25 cm, turns of 30 degrees, and 4 steps for every new waypoint.",
    (
        Case("6 m2, 2 m away, straight ahead", (6.0, 2.0, 0.0), 0.5),
        Case("6 m2, 1 m away, 120 degrees to the left", (6.0, 1.0, np.radians(120)), 0.5),
        Case("6 m2, 1 m away, 120 degrees to the right", (6.0, 1.0, -np.radians(120)), 0.5),
        Case("2 m2 from where it stands", (2.0, 0.0, 0.0), 0.5),
    ),
    utility,
    (
        Mistake("The way is in metres: a step is 25 cm.", lambda g, m, t: g / (m + abs(t) / np.radians(30) + 4)),
        Mistake(
            "A turn to the right is negative, and takes as long as one to the left.",
            lambda g, m, t: g / (m / 0.25 + t / np.radians(30) + 4),
        ),
        Mistake("The turn is in radians, and a step turns by 30 degrees.", lambda g, m, t: g / (m / 0.25 + abs(t) + 4)),
        Mistake("It has to turn, too, before it can go.", lambda g, m, t: g / (m / 0.25 + 4)),
        Mistake(
            "The 4 steps of every new waypoint are missing: without them, what is here and small is worth most.",
            lambda g, m, t: g / (m / 0.25 + abs(t) / np.radians(30)),
        ),
        Mistake(
            "Steps are not square metres: divide the gain by them, instead of taking them away.",
            lambda g, m, t: g - (m / 0.25 + abs(t) / np.radians(30) + 4),
        ),
        Mistake("That is steps for a square metre: the other way round.", lambda g, m, t: 1 / utility(g, m, t)),
    ),
)

CHANCES = Exercise(
    "03-chances",
    "The chance of each block, like `scores`: softmax over the blocks that hold a place, 0 for the others.",
    (
        Case("scores of 0, ln 2 and ln 5, all there", (np.log([1.0, 2.0, 5.0]), _ALL), np.array([0.125, 0.25, 0.625])),
        Case(
            "scores of 0, ln 3 and 9, the last not there",
            (np.array([0.0, np.log(3), 9.0]), np.array([True, True, False])),
            np.array([0.25, 0.75, 0.0]),
        ),
        Case(
            "scores of 1000 and 1000 + ln 3",
            (np.array([1000.0, 1000.0 + np.log(3)]), _ALL[:2]),
            np.array([0.25, 0.75]),
        ),
    ),
    chances,
    (
        Mistake("A block where the robot cannot be must have no chance: use `there`.", lambda s, t: _softmax(s)),
        Mistake(
            "A score of 0 is not a chance of 0: exp(0) is 1. Take away the weights, after exp.",
            lambda s, t: _softmax(s * t),
        ),
        Mistake(
            "The chances do not sum to 1: what the absent blocks would have had is lost. Divide at the end.",
            lambda s, t: _softmax(s) * t,
        ),
        Mistake(
            "exp(1000) overflows. Take the highest score from all of them first: that changes no chance.",
            lambda s, t: np.exp(s) * t / np.sum(np.exp(s) * t),
        ),
        Mistake(
            "Only the best has a chance here. A policy that learns has to try the others now and then.",
            lambda s, t: 1.0 * (np.where(t, s, -np.inf) == s[t].max()),
        ),
        Mistake("Scores may be negative; their exponentials are what is shared.", lambda s, t: s * t / np.sum(s * t)),
    ),
)

EXERCISES = (FRONTIER, UTILITY, CHANCES)
