"""Exercises of notebook 09: opacity, precision and recall with a tolerance, SPL.

Students read the solutions. They compute in a few lines what ``evaluators.maps`` and ``evaluators.planning`` compute.
"""

import numpy as np

from autonerf_lab.course.checker import Case, Exercise, Mistake


def alpha(sigma: float, length: float) -> float:
    """Return the opacity of a medium from density (1/m) and length (m)."""
    return float(1 - np.exp(-sigma * length))


def _percentages(predicted: np.ndarray, true: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Return precision and recall, %, from (P, N) flags: predicted cell p is close to true cell n."""
    return 100 * np.array([near.any(axis=1).mean(), near.any(axis=0).mean()])


def _distances(predicted: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Return the distances, (P, N), in cells, from each predicted to each true cell."""
    return np.linalg.norm(np.argwhere(predicted)[:, None] - np.argwhere(true)[None], axis=2)


def tolerant(predicted: np.ndarray, true: np.ndarray, cell: float, tolerance: float) -> np.ndarray:
    """Return precision and recall of occupied cells within a tolerance, %, (2,)."""
    predicted_cells, true_cells = np.argwhere(predicted), np.argwhere(true)
    distance = cell * np.linalg.norm(predicted_cells[:, None] - true_cells[None], axis=2)  # metres, all pairs
    near = distance <= tolerance
    precision, recall = near.any(axis=1).mean(), near.any(axis=0).mean()
    return np.array([100 * precision, 100 * recall])


def spl(success: np.ndarray, length: np.ndarray, shortest: np.ndarray) -> float:
    """Return the success weighted by path length, %."""
    return float(100 * np.mean(success * shortest / np.maximum(length, shortest)))


def _map(*rows: str) -> np.ndarray:
    return np.array([[character == "#" for character in row] for row in rows])


_WALL = _map(".....", "#####", ".....", ".....", ".....")
# the wall shifted by one cell, with a gap and a false positive
_LOWER = _map(".....", ".....", "####.", ".....", "..#..")
_DIAGONAL = _map("#....", ".....", "..#..", ".....", "....#")
_BESIDE = _map(".....", ".#...", ".....", "..#..", ".....")
_SUCCESS, _LENGTH, _SHORTEST = np.array([1, 1, 0, 1]), np.array([4.0, 5.0, 3.0, 1.9]), np.array([4.0, 4.0, 3.0, 2.0])

ALPHA = Exercise(
    "09-alpha",
    "Return the opacity of a medium, 0 to 1: density per metre, length in metres.",
    (
        Case("a density of 10 / m over 10 cm", (10.0, 0.1), float(1 - np.exp(-1))),
        Case("air", (0.0, 0.1), 0.0),
        Case("a density at which half of the light passes 10 cm, over 20 cm", (10 * float(np.log(2)), 0.2), 0.75),
    ),
    alpha,
    (
        Mistake(
            "The product can exceed 1, but opacity cannot. The light decays exponentially with density * length.",
            lambda s, d: s * d,
        ),
        Mistake("This is the fraction that passes. Opacity is 1 minus this fraction.", lambda s, d: np.exp(-s * d)),
        Mistake("The length is missing: density is per metre.", lambda s, d: 1 - np.exp(-s)),
        Mistake("Multiply by the length, do not divide: a longer path absorbs more.", lambda s, d: 1 - np.exp(-s / d)),
        Mistake(
            "The minus sign of the exponent is missing: opacity is between 0 and 1.", lambda s, d: 1 - np.exp(s * d)
        ),
    ),
)

TOLERANT = Exercise(
    "09-tolerant",
    "Return precision and recall of occupied cells, %, (2,); cells match within the tolerance (m).",
    (
        Case(
            "a wall that is 5 cm off, 5 cells of 5 cm, tolerance 6 cm",
            (_LOWER, _WALL, 0.05, 0.06),
            np.array([80.0, 80.0]),
        ),
        Case("the same, with a tolerance of 0", (_LOWER, _WALL, 0.05, 0.0), np.array([0.0, 0.0])),
        Case(
            "two cells, one adjacent to a true one and one diagonal to two",
            (_BESIDE, _DIAGONAL, 0.05, 0.06),
            np.array([50.0, 100 / 3]),
        ),
        Case("the same, with a tolerance of 8 cm", (_BESIDE, _DIAGONAL, 0.05, 0.08), np.array([100.0, 200 / 3])),
        Case(
            "the wall again, with cells of 2 m and a tolerance of 1 m", (_LOWER, _WALL, 2.0, 1.0), np.array([0.0, 0.0])
        ),
    ),
    tolerant,
    (
        Mistake(
            "Only identical cells count. Use the distance, so that a wall one cell off can match.",
            lambda p, t, cell, tolerance: 100 * np.array([(p & t).sum() / p.sum(), (p & t).sum() / t.sum()]),
        ),
        Mistake(
            "Precision and recall are swapped: precision is a fraction of the predicted cells.",
            lambda p, t, cell, tolerance: tolerant(p, t, cell, tolerance)[::-1],
        ),
        Mistake(
            "Use the Euclidean distance, not the maximum over the axes: a diagonal neighbour is farther away.",
            lambda p, t, cell, tolerance: _percentages(
                p,
                t,
                cell * np.abs(np.argwhere(p)[:, None] - np.argwhere(t)[None]).max(axis=2) <= tolerance,
            ),
        ),
        Mistake(
            "Use the straight line, not the sum over the axes: a diagonal neighbour is 1.41 cells away, not 2.",
            lambda p, t, cell, tolerance: _percentages(
                p, t, cell * np.abs(np.argwhere(p)[:, None] - np.argwhere(t)[None]).sum(axis=2) <= tolerance
            ),
        ),
        Mistake(
            "The distance is in cells but the tolerance in metres: multiply by the cell size.",
            lambda p, t, cell, tolerance: _percentages(p, t, _distances(p, t) <= tolerance),
        ),
        Mistake(
            "The result is a fraction. Return percent.",
            lambda p, t, cell, tolerance: tolerant(p, t, cell, tolerance) / 100,
        ),
    ),
)

SPL = Exercise(
    "09-spl",
    "Return the success weighted by path length (SPL) of several episodes, %.",
    (
        Case(
            "four episodes: the shortest path, 5 m instead of 4 m, a failure, and a path shorter than the shortest",
            (_SUCCESS, _LENGTH, _SHORTEST),
            100 * (1 + 0.8 + 0 + 1) / 4,
        ),
        Case("no path at all", (np.array([0.0, 1.0]), np.array([np.inf, 3.0]), np.array([2.0, 3.0])), 50.0),
    ),
    spl,
    (
        Mistake(
            "Divide by the number of all episodes: a failure counts as 0.",
            lambda s, p, b: 100 * np.sum(s * b / np.maximum(p, b)) / np.sum(s),
        ),
        Mistake(
            "Failures must count as 0: multiply by the success.", lambda s, p, b: 100 * np.mean(b / np.maximum(p, b))
        ),
        Mistake(
            "A path may be slightly shorter than the shortest one, if it cuts a corner. Limit the ratio to 1.",
            lambda s, p, b: 100 * np.mean(s * b / p),
        ),
        Mistake(
            "This is the success rate. Weight each success by shortest / length.", lambda s, p, b: 100 * np.mean(s)
        ),
        Mistake(
            "The fraction is inverted: a detour must lower the score.",
            lambda s, p, b: 100 * np.mean(s * np.maximum(p, b) / b),
        ),
        Mistake("The result is a fraction. Return percent.", lambda s, p, b: spl(s, p, b) / 100),
    ),
)

EXERCISES = (ALPHA, TOLERANT, SPL)
