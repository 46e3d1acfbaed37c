"""Exercises of notebook 11: crossing of a surface and an edge, crossed cubes, distances between two surfaces.

Students read the solutions. They compute in a few lines what marching cubes and ``evaluators.mesh_metrics`` compute.
"""

import numpy as np

from autonerf_lab.course.checker import Case, Exercise, Mistake


def crossing(a: float, b: float, level: float) -> float:
    """Return the position of the level between the nodes a and b, 0 to 1."""
    return (level - a) / (b - a)


def crossed(values: np.ndarray, level: float) -> np.ndarray:
    """Return the cubes that the surface crosses, bool."""
    x, y, z = values.shape
    corners = [values[i : x - 1 + i, j : y - 1 + j, k : z - 1 + k] for i, j, k in np.ndindex(2, 2, 2)]
    return (np.min(corners, axis=0) < level) & (np.max(corners, axis=0) > level)


def surface_distances(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Return accuracy (m), completion (m) and completion ratio (%), (3,)."""
    distance = np.linalg.norm(found[:, None] - true[None], axis=2)  # metres, all pairs
    to_true, to_found = distance.min(axis=1), distance.min(axis=0)
    return np.array([to_true.mean(), to_found.mean(), 100 * np.mean(to_found < 0.05)])


def _two(values: np.ndarray, level: float) -> np.ndarray:
    """Return cubes whose first and last corner are on different sides of the level."""
    low, high = values[:-1, :-1, :-1], values[1:, 1:, 1:]
    return (np.minimum(low, high) < level) & (np.maximum(low, high) > level)


def _solid(values: np.ndarray, level: float) -> np.ndarray:
    """Return cubes with at least one corner above the level."""
    return crossed(values, level) | (values > level)[:-1, :-1, :-1]


def _distances(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    return np.linalg.norm(found[:, None] - true[None], axis=2)


def _squared(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    squares, ratio = _distances(found, true) ** 2, surface_distances(found, true)[2]
    return np.array([squares.min(axis=1).mean(), squares.min(axis=0).mean(), ratio])


_WALL = np.zeros((4, 2, 2))
_WALL[2:] = 1.0
_SPECK = np.zeros((3, 3, 2))
_SPECK[1, 1, 0] = 0.9
_FLOOR = np.array([[x / 2, 0, 0] for x in range(5)])  # five true points, half a metre apart
_HALF = _FLOOR[:3] + np.array([0.0, 0, 0.03])  # three reconstructed points, 3 cm too high
_GHOST = np.array([[0.0, 0, 0], [0, 0, 1.0]])

CROSSING = Exercise(
    "11-crossing",
    "Return the position between two nodes, 0 to 1, where a linear function from a to b reaches `level`.",
    (
        Case("0 and 1, at 0.5", (0.0, 1.0, 0.5), 0.5),
        Case("0.2 and 0.6, at 0.5", (0.2, 0.6, 0.5), 0.75),
        Case("0.8 and 0, at 0.5", (0.8, 0.0, 0.5), 0.375),
    ),
    crossing,
    (
        Mistake(
            "This is the middle of the edge, which gives a staircase surface. Interpolate linearly.",
            lambda a, b, level: 0.5,
        ),
        Mistake("This is measured from b. The position must be 0 at a.", lambda a, b, level: (b - level) / (b - a)),
        Mistake(
            "The value at the first node is not 0: subtract a from the level.", lambda a, b, level: level / (b - a)
        ),
        Mistake(
            "This is a difference of values. Divide it by the difference between the nodes.",
            lambda a, b, level: level - a,
        ),
        Mistake(
            "Do not take the absolute value: if b < a, both differences are negative.",
            lambda a, b, level: (level - a) / abs(b - a),
        ),
    ),
)

CROSSED = Exercise(
    "11-crossed",
    "Return which cubes between (X, Y, Z) nodes the surface crosses, (X - 1, Y - 1, Z - 1) bool.",
    (
        Case("a wall: nodes 0, 0, 1, 1 along x", (_WALL, 0.5), np.array([0, 1, 0], bool).reshape(3, 1, 1)),
        Case("one solid node among 3 x 3 x 2", (_SPECK, 0.5), np.ones((2, 2, 1), bool)),
        Case("the same, with a level above all values", (_SPECK, 0.95), np.zeros((2, 2, 1), bool)),
    ),
    crossed,
    (
        Mistake("These cubes have a corner above the level. Exclude those with all eight corners above it.", _solid),
        Mistake(
            "This tests only two of the eight corners. The surface may cut off any corner.",
            _two,
        ),
        Mistake(
            "The result is inverted: these cubes are entirely empty or entirely solid.",
            lambda v, level: ~crossed(v, level),
        ),
        Mistake(
            "These are nodes, not cubes. There are n - 1 cubes between n nodes, each with eight corners.",
            lambda v, level: v > level,
        ),
    ),
)

SURFACE_DISTANCES = Exercise(
    "11-distances",
    "Return accuracy (m), completion (m) and completion ratio within 5 cm (%) from points on two surfaces, (3,).",
    (
        Case(
            "three of five points reconstructed, 3 cm too high",
            (_HALF, _FLOOR),
            np.array([0.03, (3 * 0.03 + np.hypot(0.5, 0.03) + np.hypot(1, 0.03)) / 5, 60.0]),
        ),
        Case(
            "one point, reconstructed, and a false point 1 m above", (_GHOST, _GHOST[:1]), np.array([0.5, 0.0, 100.0])
        ),
    ),
    surface_distances,
    (
        Mistake(
            "Accuracy and completion are swapped: accuracy averages over reconstructed points.",
            lambda f, t: surface_distances(t, f),
        ),
        Mistake(
            "Use the distance to the nearest point of the other surface, not the mean distance to all points.",
            lambda f, t: np.array(
                [_distances(f, t).mean(), _distances(f, t).mean(), 100 * np.mean(_distances(f, t) < 0.05)]
            ),
        ),
        Mistake(
            "The ratio counts the wrong points. It is the fraction of true points with a reconstructed point nearby.",
            lambda f, t: np.append(surface_distances(f, t)[:2], 100 * np.mean(_distances(f, t).min(axis=1) < 0.05)),
        ),
        Mistake("These are squared distances. Use distances in metres.", _squared),
        Mistake(
            "The ratio is a fraction. Return percent.", lambda f, t: surface_distances(f, t) / np.array([1, 1, 100])
        ),
    ),
)

EXERCISES = (CROSSING, CROSSED, SURFACE_DISTANCES)
