"""Shortest paths on a grid by the fast marching method (Sethian 1996).

Dijkstra's algorithm measures lengths along grid edges, with errors up to 8 % at any resolution. Fast marching solves
``|grad T| = 1`` with first-order upwind differences: it also expands a front in the order of its distance, but updates
a cell from two neighbours, and the error vanishes with the cell size.

The front is kept in buckets of equal distance instead of a heap (Yatziv et al. 2006). A cell that was expanded too
early within its bucket is corrected and expanded again, so the result is exact, not approximate as in that article.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit

_MIN_DROP = 1e-4  # cells; minimum decrease of a descent step
_BUCKETS = 16  # per cell of distance, a power of two; fewer need more corrections, more are often empty
_LAST = 2 * _BUCKETS - 1  # index of the last bucket
_DETOUR = 0.3  # cells; excess length allowed for the limited directions of a ring (a wrong cell costs at least 1.4)


def travel_distance(
    free: np.ndarray,
    goal: np.ndarray,
    cell: float = 1.0,
    stop_at: Sequence[int] | np.ndarray | None = None,
    limit: float = np.inf,
) -> np.ndarray:
    """Compute the length of the shortest path from each cell to the goal.

    Args:
        free: (R, C) bool, cells that a path may cross.
        goal: (R, C) bool, or (2,) or (K, 2) integer [row, column] cells; goal cells that are not free are ignored.
        cell: side of a cell, metres.
        stop_at: row and column at which to stop early; farther cells remain inf.
        limit: metres; farther cells remain inf.

    Returns:
        (R, C) float64, metres; inf where blocked or unreachable.

    Example:
        >>> travel_distance(np.ones((1, 4), bool), np.array([[0, 0]]), cell=0.5)
        array([[0. , 0.5, 1. , 1.5]])
    """
    goal = np.asarray(goal)
    if goal.dtype != np.bool_ or goal.shape != free.shape:
        mask = np.zeros(free.shape, np.bool_)
        mask[tuple(goal.reshape(-1, 2).T)] = True
        goal = mask
    stop = (-1, -1) if stop_at is None else (int(stop_at[0]), int(stop_at[1]))
    work = _buffers(free.shape)
    _march(free, goal, *stop, float(limit / cell), float(cell), 0.0, *work)
    return work.distance


class UpdatedDistance:
    """Path lengths to a goal that stay the same bits as those of :func:`travel_distance`, while the map changes.

    A length depends on smaller ones only. Those below the smallest one at the cells that were blocked or freed since
    the last call are kept, and the front goes on from there. If the goal has changed, everything is computed anew.

    Args:
        cell: side of a cell, metres.

    Example:
        >>> lengths, free, goal = UpdatedDistance(), np.ones((2, 4), bool), np.array([[True, False, False, False]] * 2)
        >>> lengths.update(free, goal, stop_at=(0, 3))[0]
        array([0., 1., 2., 3.])
        >>> free[0, 2] = False  # the lengths of the first two columns are kept
        >>> lengths.update(free, goal, stop_at=(0, 3))[0]
        array([ 0.,  1., inf,  4.])
    """

    def __init__(self, cell: float = 1.0) -> None:
        self._cell = cell
        self._corner = (0, 0)
        self._buffers = _buffers((0, 0))
        self._level = 0.0  # cells; smaller lengths of the last call are final

    def update(
        self, free: np.ndarray, goal: np.ndarray, stop_at: tuple[int, int], corner: tuple[int, int] = (0, 0)
    ) -> np.ndarray:
        """Return the path lengths up to that of ``stop_at``; farther cells are inf.

        Args:
            free: (R, C) bool, the part of the map to plan on; it may grow between two calls.
            goal: (R, C) bool.
            stop_at: row and column at which to stop.
            corner: map cell of ``free[0, 0]``.

        Returns:
            (R, C) float64, metres; the next call overwrites it.
        """
        last = self._buffers
        rows, cols = last.distance.shape
        if (rows, cols) != free.shape or corner != self._corner:
            self._buffers = _buffers(free.shape)
            top, left = self._corner[0] - corner[0], self._corner[1] - corner[1]
            if 0 <= top <= free.shape[0] - rows and 0 <= left <= free.shape[1] - cols:
                inside = slice(top + 1, top + rows + 1), slice(left + 1, left + cols + 1)
                self._buffers.trial[inside] = last.trial[1:-1, 1:-1]
            self._corner = corner
        self._level = _march(free, goal, *stop_at, np.inf, self._cell, self._level, *self._buffers)
        return self._buffers.distance


def descend(
    distance: np.ndarray,
    start: Sequence[int] | np.ndarray,
    cell: float = 1.0,
    radius: int = 5,
    max_steps: int = 10_000,
) -> np.ndarray:
    """Extract a path by descent on a field of :func:`travel_distance`.

    Each step is a straight line over reachable cells to the best cell on a ring of ``radius`` cells; without such a
    cell, the ring shrinks. Larger rings have more directions and give shorter paths: with 5 cells, paths on open ground
    are within 1 % of the true length.

    Args:
        distance: (R, C) metres.
        start: row and column.
        cell: side of a cell, metres.
        radius: radius of the ring, cells.
        max_steps: maximum number of steps.

    Returns:
        (K, 2) int64 cells from ``start`` to the goal, or to the end of the descent. K = 1 if there is no first step.

    Example:
        >>> field = travel_distance(np.ones((1, 8), bool), np.array([[0, 0]]))
        >>> descend(field, (0, 7)).tolist()
        [[0, 7], [0, 2], [0, 0]]
    """
    path = np.empty((max_steps + 1, 2), np.int64)
    path[0] = start
    count = _descend(distance, float(cell), int(radius), path)
    return path[:count].copy()


def path_length(path: np.ndarray, cell: float = 1.0) -> float:
    """Compute the length of a polyline of cells, metres.

    Example:
        >>> path_length(np.array([[0, 0], [3, 4]]), cell=0.1)
        0.5
    """
    return float(np.linalg.norm(np.diff(np.asarray(path, dtype=np.float64), axis=0), axis=1).sum() * cell)


def weighted_success(success: bool, length: float, shortest: float) -> float:
    """Compute success weighted by path length, in [0, 1]; its mean over episodes is SPL (Anderson et al. 2018).

    Args:
        success: True if the episode succeeded; the result of a failure is 0.
        length: length of the path, metres.
        shortest: length of the shortest path, metres.

    Example:
        >>> weighted_success(True, 4.0, 3.0), weighted_success(True, 2.9, 3.0), weighted_success(False, 4.0, 3.0)
        (0.75, 1.0, 0.0)
    """
    if not success:
        return 0.0
    return min(1.0, shortest / length) if length > 0 else 1.0


class _Buffers(NamedTuple):
    """Arrays of a march over (R, C) cells. All but ``distance`` have a border of one blocked cell."""

    trial: np.ndarray  # (R + 2, C + 2) smallest distance so far, cells; -1 for a blocked cell
    final: np.ndarray  # (R + 2, C + 2) distance of expanded cells, cells; inf for the others
    links: np.ndarray  # (2, R + 2, C + 2) int32, next and previous cell of the same bucket
    distance: np.ndarray  # (R, C) result, metres


def _buffers(shape: tuple[int, ...]) -> _Buffers:
    padded = shape[0] + 2, shape[1] + 2
    return _Buffers(np.full(padded, -1.0), np.full(padded, np.inf), np.empty((2, *padded), np.int32), np.empty(shape))


@njit(cache=True, nogil=True)
def _march(
    free: np.ndarray,
    goal: np.ndarray,
    stop_row: int,
    stop_col: int,
    limit: float,
    cell: float,
    level: float,
    trial: np.ndarray,
    final: np.ndarray,
    links: np.ndarray,
    distance: np.ndarray,
) -> float:
    """Write metres into ``distance``; negative ``stop_row``: no early end.

    Distances of an earlier call in ``trial`` that are smaller than ``level`` are final; return the new level. With the
    border of ``trial`` and ``final``, neighbours need no bounds check; ``stride`` is the length of a row. A bucket is a
    doubly linked list of cells. No neighbour of an expanded cell is more than one cell farther, so that buckets over a
    distance of two cells suffice.
    """
    rows, cols = free.shape
    stride = cols + 2
    level = _unaffected(free, goal, trial, level)
    _keep(free, goal, level, trial, final)
    trial, final, after, before = trial.ravel(), final.ravel(), links[0].ravel(), links[1].ravel()
    first = np.full(_LAST + 2, -1, np.int32)  # of each bucket, and of the cells from which the front starts
    waiting = 0
    slot = _LAST + 1
    for r in range(rows):
        if final[(r + 1) * stride + 1 : (r + 2) * stride - 1].min() == np.inf:
            continue
        for c in range(cols):
            i = (r + 1) * stride + c + 1
            # A cell between cells of known distance has nothing to expand.
            if final[i] < np.inf and max(trial[i - stride], trial[i + stride], trial[i - 1], trial[i + 1]) == np.inf:
                after[i], before[i] = first[slot], -1
                first[slot] = i
                waiting += 1
    sides = np.array([-stride, stride, -1, 1])
    stop = (stop_row + 1) * stride + stop_col + 1 if stop_row >= 0 else 0
    bucket = int(level * _BUCKETS) - 1  # the start cells come first
    while waiting > 0 and final[stop] == np.inf and bucket <= limit * _BUCKETS:
        while first[slot] >= 0:
            i = first[slot]
            first[slot] = after[i]
            if after[i] >= 0:
                before[after[i]] = -1
            waiting -= 1
            key = trial[i]
            final[i] = key
            for side in sides:
                n = i + side
                if trial[n] <= key:
                    continue
                a = min(final[n - stride], final[n + stride])
                b = min(final[n - 1], final[n + 1])
                gap = abs(a - b)
                # With a wider gap only one axis is upwind.
                value = (a + b + np.sqrt(2 - gap * gap)) / 2 if gap < 1 else min(a, b) + 1
                if value >= trial[n]:
                    continue
                if trial[n] < final[n]:  # remove it from the bucket in which it waits
                    if before[n] >= 0:
                        after[before[n]] = after[n]
                    else:
                        first[int(trial[n] * _BUCKETS) & _LAST] = after[n]
                    if after[n] >= 0:
                        before[after[n]] = before[n]
                    waiting -= 1
                trial[n] = value
                target = int(value * _BUCKETS) & _LAST
                after[n], before[n] = first[target], -1
                if first[target] >= 0:
                    before[first[target]] = n
                first[target] = n
                waiting += 1
        bucket += 1
        slot = bucket & _LAST
    limit = min(limit, final[stop])
    for r in range(rows):
        reached = final[(r + 1) * stride + 1 :]
        for c in range(cols):
            distance[r, c] = reached[c] * cell if reached[c] <= limit else np.inf
    return max(level, final[stop]) if final[stop] < np.inf else 0.0


@njit(cache=True, nogil=True)
def _keep(free: np.ndarray, goal: np.ndarray, level: float, trial: np.ndarray, final: np.ndarray) -> None:
    """Keep distances smaller than ``level``; set the others to their initial values."""
    for r in range(free.shape[0]):
        for c in range(free.shape[1]):
            known = trial[r + 1, c + 1]
            length = 0.0 if goal[r, c] else (known if 0 <= known < level else np.inf)
            trial[r + 1, c + 1] = length if free[r, c] else -1.0
            final[r + 1, c + 1] = length if free[r, c] else np.inf


@njit(cache=True, nogil=True)
def _unaffected(free: np.ndarray, goal: np.ndarray, known: np.ndarray, level: float) -> float:
    """Return the distance, at most ``level``, below which known distances hold for these free cells and this goal."""
    for r in range(free.shape[0]):
        for c in range(free.shape[1]):
            before = known[r + 1, c + 1]
            if (goal[r, c] and free[r, c]) != (before == 0):
                return 0.0
            if free[r, c] == (before >= 0):
                continue
            if before >= 0:
                level = min(level, before)
                continue
            for value in (known[r, c + 1], known[r + 2, c + 1], known[r + 1, c], known[r + 1, c + 2]):
                if value >= 0:
                    level = min(level, value)
    return level


@njit(cache=True, nogil=True)
def _clear(distance: np.ndarray, r0: int, c0: int, r1: int, c1: int) -> bool:
    """Return True if every cell under the straight line, except the first, is reachable."""
    steps = 2 * max(abs(r1 - r0), abs(c1 - c0))
    for i in range(1, steps + 1):
        r = int(np.floor(r0 + (r1 - r0) * i / steps + 0.5))
        c = int(np.floor(c0 + (c1 - c0) * i / steps + 0.5))
        if not (r == r0 and c == c0) and not distance[r, c] < np.inf:
            return False
    return True


@njit(cache=True, nogil=True)
def _descend(distance: np.ndarray, cell: float, radius: int, path: np.ndarray) -> int:
    rows, cols = distance.shape
    count = 1
    while count < len(path):
        r0, c0 = path[count - 1, 0], path[count - 1, 1]
        here = distance[r0, c0] / cell
        if here == 0.0:
            break
        found = False
        for ring in range(radius, 0, -1):
            best, best_r, best_c = np.inf, -1, -1
            for r in range(max(0, r0 - ring), min(rows, r0 + ring + 1)):
                for c in range(max(0, c0 - ring), min(cols, c0 + ring + 1)):
                    length = np.sqrt(float((r - r0) ** 2 + (c - c0) ** 2))
                    at_goal = distance[r, c] == 0.0 and length > 0
                    if length > ring + 0.5 or (length <= ring - 1 and not at_goal):
                        continue
                    # Length of the whole path through this cell.
                    there = distance[r, c] / cell
                    total = there + length
                    # A path longer than the field overshoots a bend: use a smaller ring.
                    if ring > 1 and total > here + _DETOUR:
                        continue
                    if there < here - _MIN_DROP and total < best and _clear(distance, r0, c0, r, c):
                        best, best_r, best_c = total, r, c
            if best < np.inf:
                path[count, 0], path[count, 1] = best_r, best_c
                count += 1
                found = True
                break
        if not found:
            break
    return count
