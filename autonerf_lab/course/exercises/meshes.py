"""Exercises of notebook 11: where a surface crosses an edge, which cubes it crosses, how far two surfaces are apart.

The solutions are read by students: they say in a few lines what marching cubes and ``evaluators.mesh_metrics`` compute.
"""

import numpy as np

from autonerf_lab.course.checker import Case, Exercise, Mistake


def crossing(a: float, b: float, level: float) -> float:
    return (level - a) / (b - a)


def crossed(values: np.ndarray, level: float) -> np.ndarray:
    x, y, z = values.shape
    corners = [values[i : x - 1 + i, j : y - 1 + j, k : z - 1 + k] for i, j, k in np.ndindex(2, 2, 2)]
    return (np.min(corners, axis=0) < level) & (np.max(corners, axis=0) > level)


def surface_distances(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    distance = np.linalg.norm(found[:, None] - true[None], axis=2)  # metres, from each to each
    to_truth, to_found = distance.min(axis=1), distance.min(axis=0)
    return np.array([to_truth.mean(), to_found.mean(), 100 * np.mean(to_found < 0.05)])


def _two(values: np.ndarray, level: float) -> np.ndarray:
    """As if a cube had only its first and its last corner."""
    low, high = values[:-1, :-1, :-1], values[1:, 1:, 1:]
    return (np.minimum(low, high) < level) & (np.maximum(low, high) > level)


def _solid(values: np.ndarray, level: float) -> np.ndarray:
    """Solid at one corner at least."""
    return crossed(values, level) | (values > level)[:-1, :-1, :-1]


def _apart(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    return np.linalg.norm(found[:, None] - true[None], axis=2)


def _squared(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    squares, ratio = _apart(found, true) ** 2, surface_distances(found, true)[2]
    return np.array([squares.min(axis=1).mean(), squares.min(axis=0).mean(), ratio])


_WALL = np.zeros((4, 2, 2))
_WALL[2:] = 1.0
_SPECK = np.zeros((3, 3, 2))
_SPECK[1, 1, 0] = 0.9
_FLOOR = np.array([[x / 2, 0, 0] for x in range(5)])  # five points of the truth, half a metre apart
_HALF = _FLOOR[:3] + np.array([0.0, 0, 0.03])  # of which three were found, 3 cm too high
_GHOST = np.array([[0.0, 0, 0], [0, 0, 1.0]])

CROSSING = Exercise(
    "11-crossing",
    "How far from node a to node b, 0 to 1, a quantity that changes evenly between them takes the value `level`.",
    (
        Case("0 and 1, at 0.5", (0.0, 1.0, 0.5), 0.5),
        Case("0.2 and 0.6, at 0.5", (0.2, 0.6, 0.5), 0.75),
        Case("0.8 and 0, at 0.5", (0.8, 0.0, 0.5), 0.375),
    ),
    crossing,
    (
        Mistake("The middle of the edge makes stairs. Where exactly is the value reached?", lambda a, b, level: 0.5),
        Mistake("Measured from b: it is to be 0 at a.", lambda a, b, level: (b - level) / (b - a)),
        Mistake("The value at a is not 0: how much is left from there?", lambda a, b, level: level / (b - a)),
        Mistake("This is the value's change. As a share of that between the nodes?", lambda a, b, level: level - a),
        Mistake(
            "From a high to a low node both differences are negative: keep both signs.",
            lambda a, b, level: (level - a) / abs(b - a),
        ),
    ),
)

CROSSED = Exercise(
    "11-crossed",
    "Which cubes between (X, Y, Z) nodes a surface runs through, (X - 1, Y - 1, Z - 1) bool.",
    (
        Case("a wall: nodes 0, 0, 1, 1 along x", (_WALL, 0.5), np.array([0, 1, 0], bool).reshape(3, 1, 1)),
        Case("one solid node among 3 x 3 x 2", (_SPECK, 0.5), np.ones((2, 2, 1), bool)),
        Case("the same, where more is asked of a surface", (_SPECK, 0.95), np.zeros((2, 2, 1), bool)),
    ),
    crossed,
    (
        Mistake("These are the cubes that are solid at a corner; some are so at all eight.", _solid),
        Mistake(
            "A cube has eight corners, and these are two of them: a surface may cut off any.",
            _two,
        ),
        Mistake("These are the empty cubes, and the full ones: the others.", lambda v, level: ~crossed(v, level)),
        Mistake(
            "These are nodes. Between n nodes there are n - 1 cubes, with eight nodes each.",
            lambda v, level: v > level,
        ),
    ),
)

SURFACE_DISTANCES = Exercise(
    "11-distances",
    "Accuracy (m), completion (m) and completion ratio within 5 cm (%) from points on two surfaces, (3,).",
    (
        Case(
            "three of five points found, 3 cm too high",
            (_HALF, _FLOOR),
            np.array([0.03, (3 * 0.03 + np.hypot(0.5, 0.03) + np.hypot(1, 0.03)) / 5, 60.0]),
        ),
        Case("one point, found, and a ghost 1 m above", (_GHOST, _GHOST[:1]), np.array([0.5, 0.0, 100.0])),
    ),
    surface_distances,
    (
        Mistake(
            "The two have changed places: accuracy asks the found points, completion the true ones.",
            lambda f, t: surface_distances(t, f),
        ),
        Mistake(
            "Distances to the nearest point of the other surface, and not to all of them.",
            lambda f, t: np.array([_apart(f, t).mean(), _apart(f, t).mean(), 100 * np.mean(_apart(f, t) < 0.05)]),
        ),
        Mistake(
            "The ratio is that of the completion: of the true points, how many were found?",
            lambda f, t: np.append(surface_distances(f, t)[:2], 100 * np.mean(_apart(f, t).min(axis=1) < 0.05)),
        ),
        Mistake("Metres, and not their squares.", _squared),
        Mistake("The ratio in percent, please.", lambda f, t: surface_distances(f, t) / np.array([1, 1, 100])),
    ),
)

EXERCISES = (CROSSING, CROSSED, SURFACE_DISTANCES)
