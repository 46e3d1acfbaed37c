"""Planning as the released code does and judges it.

A square of 40 cells to each side of start and goal is always cleared, whatever is there. Objects are pieces of 300
cells and more, grown by 25. A path has at most 1000 steps of 5 cells; it succeeds if it ends within 1 m and at most 10
cells are obstacles, counted over the 3 x 3 cells around each waypoint, on the true map grown by 18 cm.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from scipy.spatial import cKDTree

from autonerf_lab.evaluators.ground_truth import TrueMap
from autonerf_lab.evaluators.planning import SUCCESS_DISTANCE, Episode, Tasks, grow
from autonerf_lab.evaluators.upstream.maps import MIN_PIECE, large_pieces
from autonerf_lab.planning.fast_marching import descend, path_length, travel_distance

DILATION = 20  # cells, of the predicted map
OBJECT_DILATION = 25
CLEARED = 40
MAX_STEPS = 1000
MAX_HITS = 10


def _square(cell: np.ndarray, shape: tuple[int, ...]) -> tuple[slice, slice]:
    (top, bottom), (left, right) = (
        (max(0, int(c) - CLEARED), min(size, int(c) + CLEARED)) for c, size in zip(cell, shape, strict=True)
    )
    return slice(top, bottom), slice(left, right)


def obstacle_hits(path: np.ndarray, passable: np.ndarray) -> int:
    """Cells that are no free ones, over the 3 x 3 around each of (K, 2) waypoints; outside of the map counts too.

    Example:
        >>> free = np.ones((5, 5), bool); free[:, 3] = False
        >>> obstacle_hits(np.array([[2, 0], [2, 2], [2, 3]]), free)
        9
    """
    walls = np.pad(~passable, 1, constant_values=True)
    around = np.array([(i, j) for i in range(3) for j in range(3)])
    cells = path[:, None].astype(int) + around
    return int(walls[cells[..., 0], cells[..., 1]].sum())


def _judged(
    path: np.ndarray | None, tasks: Tasks, end_distance: Callable[[np.ndarray], float], cell: float
) -> tuple[str, float]:
    """Why an episode failed, and the length of its path."""
    if path is None:
        return "no path", np.inf
    through = obstacle_hits(path, tasks.passable) > MAX_HITS
    far = end_distance(path[-1]) >= SUCCESS_DISTANCE
    return "through an obstacle" if through else "ended far" if far else "", path_length(path, cell)


def plan_points(free: np.ndarray, tasks: Tasks, cell: float) -> list[Episode]:
    """Plan and judge every PointGoal; ``free`` (R, C) is the predicted map, grown."""

    def episode(i: int) -> Episode:
        start, goal = tasks.starts[i], tasks.goals[i]
        here = free.copy()
        here[_square(start, free.shape)] = here[_square(goal, free.shape)] = True
        distance = travel_distance(here, goal[None], cell, stop_at=start)
        path = descend(distance, start, cell, max_steps=MAX_STEPS) if np.isfinite(distance[tuple(start)]) else None
        reason, length = _judged(path, tasks, lambda end: float(np.hypot(*(end - goal)) * cell), cell)
        return Episode(start, goal, 0, reason, path, length, float(tasks.shortest[i]))

    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(episode, np.flatnonzero(tasks.shortest > 0).tolist()))


def plan_objects(free: np.ndarray, columns: np.ndarray, truth: TrueMap, tasks: Tasks) -> list[Episode]:
    """Plan and judge every ObjectGoal; ``columns`` (15, R, C) are the predicted ones."""
    cell = truth.grid.cell

    def of_class(k: int) -> list[Episode]:
        pieces = large_pieces(columns[k - 1], MIN_PIECE)
        goal = ~grow(~pieces, OBJECT_DILATION, 1.0)
        distance = travel_distance(free | goal, goal, cell) if goal.any() else None
        tree = cKDTree(np.argwhere(truth.semantics[k - 1]))
        episodes = []
        for i in np.flatnonzero(tasks.shortest_object[k] > 0).tolist():
            start = tasks.starts[i]
            path = None if distance is None else _out_of_square(distance, start, cell)
            reason, length = _judged(path, tasks, lambda end: float(tree.query(end)[0] * cell), cell)
            reason = "class not predicted" if distance is None else reason
            episodes.append(Episode(start, None, k, reason, path, length, float(tasks.shortest_object[k, i])))
        return episodes

    with ThreadPoolExecutor(2) as pool:
        return [episode for group in pool.map(of_class, tasks.classes) for episode in group]


def _out_of_square(distance: np.ndarray, start: np.ndarray, cell: float) -> np.ndarray | None:
    """Down a field from a start with a cleared square around it.

    The square is free and convex: the way out of it is straight, and the shortest never comes back into it. So the
    field itself need not be made again for every start.
    """
    rows, cols = _square(start, distance.shape)
    there = np.stack(np.meshgrid(np.arange(distance.shape[0])[rows], np.arange(distance.shape[1])[cols], indexing="ij"))
    total = np.hypot(*(there - start[:, None, None])) * cell + distance[rows, cols]
    row, col = np.unravel_index(np.argmin(total), total.shape)
    if not np.isfinite(total[row, col]):
        return None
    first = there[:, row, col]
    return np.concatenate([np.asarray(start)[None], descend(distance, first, cell, max_steps=MAX_STEPS)])
