"""Exercises of notebook 09: opacity, precision and recall with a tolerance, SPL.

The solutions are read by students: they say in a few lines what ``evaluators.maps`` and ``.planning`` compute.
"""

import numpy as np

from autonerf_lab.course.checker import Case, Exercise, Mistake


def alpha(sigma: float, length: float) -> float:
    return float(1 - np.exp(-sigma * length))


def _shares(predicted: np.ndarray, true: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Percent of the predicted cells with a true one nearby, and of the true cells with a predicted one."""
    return 100 * np.array([near.any(axis=1).mean(), near.any(axis=0).mean()])


def _distances(predicted: np.ndarray, true: np.ndarray) -> np.ndarray:
    """(P, N) cells from each predicted to each true cell."""
    return np.linalg.norm(np.argwhere(predicted)[:, None] - np.argwhere(true)[None], axis=2)


def tolerant(predicted: np.ndarray, true: np.ndarray, cell: float, tolerance: float) -> np.ndarray:
    here, there = np.argwhere(predicted), np.argwhere(true)
    distance = cell * np.linalg.norm(here[:, None] - there[None], axis=2)  # metres, from each to each
    near = distance <= tolerance + 1e-9
    precision, recall = near.any(axis=1).mean(), near.any(axis=0).mean()
    return np.array([100 * precision, 100 * recall])


def spl(success: np.ndarray, length: np.ndarray, shortest: np.ndarray) -> float:
    return float(100 * np.mean(success * shortest / np.maximum(length, shortest)))


def _map(*rows: str) -> np.ndarray:
    return np.array([[character == "#" for character in row] for row in rows])


_WALL = _map(".....", "#####", ".....", ".....", ".....")
_LOWER = _map(".....", ".....", "####.", ".....", "..#..")  # the same wall, a cell too far, with a gap and a ghost
_DIAGONAL = _map("#....", ".....", "..#..", ".....", "....#")
_BESIDE = _map(".....", ".#...", ".....", "..#..", ".....")
_WON, _WALKED, _BEST = np.array([1, 1, 0, 1]), np.array([4.0, 5.0, 3.0, 1.9]), np.array([4.0, 4.0, 3.0, 2.0])

ALPHA = Exercise(
    "09-alpha",
    "The share of light that is stopped on the way through a medium: density per metre, length in metres.",
    (
        Case("a density of 10 / m over 10 cm", (10.0, 0.1), float(1 - np.exp(-1))),
        Case("air", (0.0, 0.1), 0.0),
        Case("a density that lets half through on 10 cm, over 20 cm", (10 * float(np.log(2)), 0.2), 0.75),
    ),
    alpha,
    (
        Mistake(
            "20 cm do not stop twice as much as 10 cm: there is less light left to stop. That is an exponential.",
            lambda s, d: s * d,
        ),
        Mistake("This is what gets through. Opacity is the rest.", lambda s, d: np.exp(-s * d)),
        Mistake("Over which length? Density is per metre.", lambda s, d: 1 - np.exp(-s)),
        Mistake("A longer way stops more: multiply by the length.", lambda s, d: 1 - np.exp(-s / d)),
        Mistake("The sign of the exponent: opacity lies between 0 and 1.", lambda s, d: 1 - np.exp(s * d)),
    ),
)

TOLERANT = Exercise(
    "09-tolerant",
    "Precision and recall of occupied cells in percent, (2,); a cell is right with one of the others within tolerance.",
    (
        Case("a wall that is 5 cm off, 5 cells of 5 cm", (_LOWER, _WALL, 0.05, 0.05), np.array([80.0, 80.0])),
        Case("the same, where nothing is forgiven", (_LOWER, _WALL, 0.05, 0.0), np.array([0.0, 0.0])),
        Case(
            "two cells, one beside a true one and one diagonal to two",
            (_BESIDE, _DIAGONAL, 0.05, 0.05),
            np.array([50.0, 100 / 3]),
        ),
        Case("the same, with a tolerance of 8 cm", (_BESIDE, _DIAGONAL, 0.05, 0.08), np.array([100.0, 200 / 3])),
        Case("the wall again, a cell of 2 m too far", (_LOWER, _WALL, 2.0, 1.0), np.array([0.0, 0.0])),
    ),
    tolerant,
    (
        Mistake(
            "Only cells that agree exactly count. A wall that is one cell off is nearly right: use the distance.",
            lambda p, t, cell, tolerance: 100 * np.array([(p & t).sum() / p.sum(), (p & t).sum() / t.sum()]),
        ),
        Mistake(
            "The two have changed places: precision is a share of the predicted cells, recall of the true ones.",
            lambda p, t, cell, tolerance: tolerant(p, t, cell, tolerance)[::-1],
        ),
        Mistake(
            "A diagonal neighbour is farther than one beside: take the distance, and not the larger of two.",
            lambda p, t, cell, tolerance: _shares(
                p,
                t,
                cell * np.abs(np.argwhere(p)[:, None] - np.argwhere(t)[None]).max(axis=2) <= tolerance + 1e-9,
            ),
        ),
        Mistake(
            "The distance is in cells, the tolerance in metres.",
            lambda p, t, cell, tolerance: _shares(p, t, _distances(p, t) <= tolerance + 1e-9),
        ),
        Mistake("In percent, please.", lambda p, t, cell, tolerance: tolerant(p, t, cell, tolerance) / 100),
    ),
)

SPL = Exercise(
    "09-spl",
    "Success weighted by path length of several episodes, percent.",
    (
        Case(
            "four episodes: on the shortest way, 5 m instead of 4 m, a failure, and a path that cuts a corner",
            (_WON, _WALKED, _BEST),
            100 * (1 + 0.8 + 0 + 1) / 4,
        ),
        Case("no path at all", (np.array([0.0, 1.0]), np.array([np.inf, 3.0]), np.array([2.0, 3.0])), 50.0),
    ),
    spl,
    (
        Mistake(
            "A failure counts 0, and not nothing: divide by all episodes.",
            lambda s, p, b: 100 * np.sum(s * b / np.maximum(p, b)) / np.sum(s),
        ),
        Mistake(
            "Failures have been rewarded for their short ways.", lambda s, p, b: 100 * np.mean(b / np.maximum(p, b))
        ),
        Mistake(
            "A path can be shorter than the shortest true one, where it cuts a corner; nobody gets more than 1 for it.",
            lambda s, p, b: 100 * np.mean(s * b / p),
        ),
        Mistake("This is the success rate. How long was the way?", lambda s, p, b: 100 * np.mean(s)),
        Mistake(
            "The fraction is upside down: a detour must cost.", lambda s, p, b: 100 * np.mean(s * np.maximum(p, b) / b)
        ),
        Mistake("In percent, please.", lambda s, p, b: spl(s, p, b) / 100),
    ),
)

EXERCISES = (ALPHA, TOLERANT, SPL)
