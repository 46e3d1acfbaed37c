"""Planning of the released code, and its success criterion.

A square of 40 cells to each side of the start and of the goal is always cleared. Objects are connected components of at
least 300 cells, dilated by 25 cells. A path has at most 1000 steps of 5 cells. It succeeds if it ends within 1 m of the
goal and touches at most 10 obstacle cells, counted over the 3 x 3 cells around each waypoint, on the true map with
obstacles dilated by 18 cm.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from scipy.spatial import cKDTree

from autonerf_lab.evaluators.ground_truth import TrueMap
from autonerf_lab.evaluators.planning import SUCCESS_DISTANCE, Episode, EpisodeSet, dilate_obstacles
from autonerf_lab.evaluators.upstream.maps import MIN_PIECE, large_components
from autonerf_lab.planning.fast_marching import descend, path_length, travel_distance
from autonerf_lab.utils.resources import threads

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
    """Count the cells that are not passable over the 3 x 3 cells around each of (K, 2) waypoints, also outside the map.

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
    path: np.ndarray | None, episode_set: EpisodeSet, end_distance: Callable[[np.ndarray], float], cell: float
) -> tuple[str, float]:
    """Return the reason of a failure ("" for a success), and the path length."""
    if path is None:
        return "no path", np.inf
    through = obstacle_hits(path, episode_set.passable) > MAX_HITS
    far = end_distance(path[-1]) >= SUCCESS_DISTANCE
    return "through an obstacle" if through else "ended far" if far else "", path_length(path, cell)


def plan_points(free: np.ndarray, episode_set: EpisodeSet, cell: float) -> list[Episode]:
    """Plan and judge all PointGoal episodes; ``free`` (R, C) is the predicted map with dilated obstacles."""

    def episode(i: int) -> Episode:
        start, goal = episode_set.starts[i], episode_set.goals[i]
        here = free.copy()
        here[_square(start, free.shape)] = here[_square(goal, free.shape)] = True
        distance = travel_distance(here, goal[None], cell, stop_at=start)
        path = descend(distance, start, cell, max_steps=MAX_STEPS) if np.isfinite(distance[tuple(start)]) else None
        reason, length = _judged(path, episode_set, lambda end: float(np.hypot(*(end - goal)) * cell), cell)
        return Episode(start, goal, 0, reason, path, length, float(episode_set.shortest[i]))

    with ThreadPoolExecutor(threads()) as pool:
        return list(pool.map(episode, np.flatnonzero(episode_set.shortest > 0).tolist()))


def plan_objects(free: np.ndarray, class_cells: np.ndarray, truth: TrueMap, episode_set: EpisodeSet) -> list[Episode]:
    """Plan and judge all ObjectGoal episodes; ``class_cells`` (15, R, C) are the predicted map cells of each class."""
    cell = truth.grid.cell

    def of_class(k: int) -> list[Episode]:
        objects = large_components(class_cells[k - 1], MIN_PIECE)
        goal = ~dilate_obstacles(~objects, OBJECT_DILATION, 1.0)
        distance = travel_distance(free | goal, goal, cell) if goal.any() else None
        tree = cKDTree(np.argwhere(truth.semantics[k - 1]))
        episodes = []
        for i in np.flatnonzero(episode_set.shortest_object[k] > 0).tolist():
            start = episode_set.starts[i]
            path = None if distance is None else _out_of_square(distance, start, cell)
            reason, length = _judged(path, episode_set, lambda end: float(tree.query(end)[0] * cell), cell)
            reason = "class not predicted" if distance is None else reason
            episodes.append(Episode(start, None, k, reason, path, length, float(episode_set.shortest_object[k, i])))
        return episodes

    with ThreadPoolExecutor(threads()) as pool:
        return [episode for group in pool.map(of_class, episode_set.classes) for episode in group]


def _out_of_square(distance: np.ndarray, start: np.ndarray, cell: float) -> np.ndarray | None:
    """Follow a distance field downhill from a start in the middle of a cleared square.

    The square is free and convex: the shortest path leaves it on a straight line and does not return. Therefore one
    distance field serves all starts.
    """
    rows, cols = _square(start, distance.shape)
    there = np.stack(np.meshgrid(np.arange(distance.shape[0])[rows], np.arange(distance.shape[1])[cols], indexing="ij"))
    total = np.hypot(*(there - start[:, None, None])) * cell + distance[rows, cols]
    row, col = np.unravel_index(np.argmin(total), total.shape)
    if not np.isfinite(total[row, col]):
        return None
    first = there[:, row, col]
    return np.concatenate([np.asarray(start)[None], descend(distance, first, cell, max_steps=MAX_STEPS)])
