"""Exercises of notebook 02: map cells, depth measurements and the distance field.

Students read the solutions.
"""

from collections.abc import Sequence

import numpy as np

from autonerf_lab.course.checker import Case, Exercise, Mistake
from autonerf_lab.geometry import planar_pose

_ORIGIN = np.array([-1.0, -2.0])
_POSE = planar_pose(1.1, 1.2, 0.0)
_MAP = (_POSE, np.zeros(2), 0.5)


def world_to_cell(x: float, y: float, origin: np.ndarray, cell: float) -> list[int]:
    """Return [row, column] of the cell that contains world x, y."""
    column = np.floor((x - origin[0]) / cell)  # floor, which is also correct below zero
    row = np.floor((y - origin[1]) / cell)
    return [int(row), int(column)]


def marked(right: float, up: float, depth: float, pose: np.ndarray, origin: np.ndarray, cell: float) -> list[int]:
    """Return [row, column, obstacle] of the cell that a pixel marks, or []."""
    if not 0.5 <= depth <= 5.0:
        return []
    x, y, z = pose[:3, 3] + depth * (pose[:3, :3] @ np.array([right, up, -1.0]))
    obstacle = 0.25 <= z <= pose[2, 3] + 0.01  # the height band of obstacles
    column, row = np.floor((np.array([x, y]) - origin) / cell)
    return [int(row), int(column), int(obstacle)]


def eikonal_update(a: float, b: float) -> float:
    """Return the arrival time of a cell from its smaller neighbours, in cells."""
    if abs(a - b) >= 1:  # only the smaller neighbour contributes
        return min(a, b) + 1
    return (a + b + np.sqrt(2 - (a - b) ** 2)) / 2


def _marked(
    right: float,
    up: float,
    depth: float,
    pose: np.ndarray,
    origin: np.ndarray,
    cell: float,
    *,
    reach: Sequence[float] = (0.5, 5.0),
    band: Sequence[float] = (0.25, 0.89),
    ray: bool = False,
    from_camera: bool = False,
) -> list[int]:
    """Return the result of :func:`marked` with some rules of the map changed."""
    if not reach[0] <= depth <= reach[1]:
        return []
    direction = np.array([right, up, -1.0])
    if ray:
        direction /= np.linalg.norm(direction)
    x, y, z = pose[:3, 3] + depth * (pose[:3, :3] @ direction)
    height = z - pose[2, 3] if from_camera else z
    return [*world_to_cell(x, y, origin, cell), int(band[0] <= height <= band[1])]


WORLD_TO_CELL = Exercise(
    "02-world-to-cell",
    "Return [row, column] of the cell that contains the world point x, y.",
    (
        Case("x = 0.2, y = 0.1, origin (-1, -2), cells of 0.5 m", (0.2, 0.1, _ORIGIN, 0.5), [4, 2]),
        Case("x = 0.49, y = 0.9, close to the next column", (0.49, 0.9, _ORIGIN, 0.5), [5, 2]),
        Case("x = -1.3, y = -1.9, left of the map", (-1.3, -1.9, _ORIGIN, 0.5), [0, -1]),
    ),
    world_to_cell,
    (
        Mistake(
            "Row and column are swapped: arrays are indexed [row, column], which is [y, x].",
            lambda x, y, origin, cell: world_to_cell(x, y, origin, cell)[::-1],
        ),
        Mistake(
            "int() rounds towards zero, so the cell left of column 0 also becomes column 0. Use floor.",
            lambda x, y, origin, cell: [int((y - origin[1]) / cell), int((x - origin[0]) / cell)],
        ),
        Mistake(
            "round() is off by half a cell: cell k covers the interval from k to k + 1. Use floor.",
            lambda x, y, origin, cell: [round((y - origin[1]) / cell), round((x - origin[0]) / cell)],
        ),
        Mistake(
            "Cell [0, 0] is not at the origin of the world: subtract the origin of the map.",
            lambda x, y, origin, cell: [int(np.floor(y / cell)), int(np.floor(x / cell))],
        ),
        Mistake(
            "Divide by the cell size, do not multiply: metres / (metres per cell) = cells.",
            lambda x, y, origin, cell: [int(np.floor((y - origin[1]) * cell)), int(np.floor((x - origin[0]) * cell))],
        ),
    ),
    integers=True,
)

MARKED = Exercise(
    "02-marked",
    "Return [row, column, obstacle (0 or 1)] of the cell that a pixel marks, or [] if its depth is out of range.",
    (
        Case("a wall 2 m ahead, at the height of the camera", (0.0, 0.0, 2.0, *_MAP), [2, 6, 1]),
        Case("the floor 2 m ahead (up = -0.44)", (0.0, -0.44, 2.0, *_MAP), [2, 6, 0]),
        Case("a box 2 m ahead (up = -0.25)", (0.0, -0.25, 2.0, *_MAP), [2, 6, 1]),
        Case("a ceiling lamp 2 m ahead (up = 0.3)", (0.0, 0.3, 2.0, *_MAP), [2, 6, 0]),
        Case("a chair at a depth of 2.4 m, off to the right (right = 0.5)", (0.5, -0.1, 2.4, *_MAP), [0, 7, 1]),
        Case("a depth of 0.3 m", (0.0, 0.0, 0.3, *_MAP), []),
        Case("a depth of 6 m", (0.0, 0.0, 6.0, *_MAP), []),
    ),
    marked,
    (
        Mistake(
            "The range of the sensor is 0.5 m to 5 m. Ignore other depths.",
            lambda *args: _marked(*args, reach=(0.0, np.inf)),
        ),
        Mistake("Ignore depths below 0.5 m.", lambda *args: _marked(*args, reach=(0.0, 5.0))),
        Mistake("Ignore depths above 5 m.", lambda *args: _marked(*args, reach=(0.5, np.inf))),
        Mistake(
            "The robot passes below a ceiling lamp: points above the camera are not obstacles.",
            lambda *args: _marked(*args, band=(0.25, np.inf)),
        ),
        Mistake(
            "A point at the height of the camera is an obstacle: the height band ends 1 cm above the camera.",
            lambda *args: _marked(*args, band=(0.25, 0.8799)),
        ),
        Mistake(
            "The floor is not an obstacle: the height band starts 25 cm above it.",
            lambda *args: _marked(*args, band=(-0.01, 0.89)),
        ),
        Mistake(
            "Heights are measured from the floor, not from the camera, which is at 0.88 m.",
            lambda *args: _marked(*args, from_camera=True),
        ),
        Mistake(
            "Depth is measured along the optical axis: do not normalise the ray.",
            lambda *args: _marked(*args, ray=True),
        ),
        Mistake(
            "Row and column are swapped: [row, column] is [y, x].",
            lambda *args: [*marked(*args)[1::-1], *marked(*args)[2:]],
        ),
    ),
    integers=True,
)

EIKONAL_UPDATE = Exercise(
    "02-eikonal-update",
    "Return the distance of a cell, in cells, from the smaller neighbours: a above or below, b left or right.",
    (
        Case("a = 0, b = inf, only one neighbour known", (0.0, np.inf), 1.0),
        Case("a = b = 1", (1.0, 1.0), 1 + np.sqrt(2) / 2),
        Case("a = 2, b = 2.6", (2.0, 2.6), 2.9403124),
        Case("a = 3, b = 1, more than one cell apart", (3.0, 1.0), 2.0),
        Case("a = inf, b = 5", (np.inf, 5.0), 6.0),
        Case("a = 2, b = 3.2, between 1 and the root of 2 apart", (2.0, 3.2), 3.0),
    ),
    eikonal_update,
    (
        Mistake(
            "This is Dijkstra's update, which moves along one axis only. Solve (T - a)^2 + (T - b)^2 = 1.",
            lambda a, b: min(a, b) + 1,
        ),
        Mistake(
            "If |a - b| >= 1, the quadratic equation has no valid solution. Use only the smaller neighbour then.",
            lambda a, b: (a + b + np.sqrt(2 - (a - b) ** 2)) / 2,
        ),
        Mistake(
            "Between |a - b| = 1 and the root of 2 the equation has a solution, but it is smaller than the larger "
            "neighbour. The condition is |a - b| < 1.",
            lambda a, b: min(a, b) + 1 if abs(a - b) > np.sqrt(2) else (a + b + np.sqrt(2 - (a - b) ** 2)) / 2,
        ),
        Mistake(
            "If |a - b| >= 1, do not clip the root: the cell is reached from the smaller neighbour alone.",
            lambda a, b: (a + b + np.sqrt(max(0.0, 2 - (a - b) ** 2))) / 2,
        ),
        Mistake(
            "Take the larger of the two roots: T must not be smaller than its neighbours.",
            lambda a, b: min(a, b) + 1 if abs(a - b) >= 1 else (a + b - np.sqrt(2 - (a - b) ** 2)) / 2,
        ),
        Mistake(
            "The cell is reached from the smaller neighbour: min, not max.",
            lambda a, b: max(a, b) + 1 if abs(a - b) >= 1 else eikonal_update(a, b),
        ),
        Mistake(
            "The division by two of the quadratic formula is missing.",
            lambda a, b: min(a, b) + 1 if abs(a - b) >= 1 else a + b + np.sqrt(2 - (a - b) ** 2),
        ),
    ),
)

EXERCISES = (WORLD_TO_CELL, MARKED, EIKONAL_UPDATE)
