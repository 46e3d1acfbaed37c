"""Task 3, planning: is the map good enough to find one's way (section 4.3, and "Planning" of the appendix)?

**Maps.** Planned on the predicted map of 1 cm, where occupied and unknown columns are obstacles grown by 20 cm;
judged on the true map, where everything but free space is an obstacle grown by 18 cm, the robot's radius. An end of a
path that the predicted map blocks gets the released code's cleared disc of 40 cells; an end that is free needs none
(clearing it always would open short cuts through known obstacles, and true maps would fail).

**PointGoal.** Seeded starts, uniform where the robot fits on the true map; a goal, drawn likewise, at a geodesic
distance of at least 2 m. Success: the path ends less than 1 m from the goal and crosses less than 10 cells that are
obstacles.

**ObjectGoal.** The same starts, every class that the true map holds beside ground that the robot can reach: one that no
robot could stand beside (a cup in a sealed corner) is no task. The goals are the free cells beside the predicted
columns of the class: at most 25 cm from them (the released code's disc), or, for what lies deep on a table or behind
other furniture, at most 5 cm farther than the nearest free cell. Each connected patch of columns has its own such ring,
so the planner goes to the nearest; predicted patches with less than a tenth of the columns of the largest of their
class are noise (the released code drops those under 300 cells, and with them every cup). Success: the path ends less
than 1 m from a true column of that class, and crosses less than 10 obstacle cells. A class that was not predicted is
a failure.

**SPL** = mean of S l / max(p, l): p the length of the path, l the shortest on the true map, to the goal or, for an
object, to the ring around its true columns. A start that lies in that ring already (l = 0) has no way to plan, and SPL
would be zero however short the path: it is no episode.

Every failed episode carries a reason: ``class not predicted``, ``no path``, ``through an obstacle`` or ``ended far``.
"""

import weakref
from collections import Counter
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from autonerf_lab.classes import CLASS_NAMES, NUM_CLASSES
from autonerf_lab.evaluators.ground_truth import TrueMap
from autonerf_lab.evaluators.maps import CellState
from autonerf_lab.evaluators.task_result import TaskResult
from autonerf_lab.planning.fast_marching import descend, path_length, travel_distance, weighted_success
from autonerf_lab.utils.resources import threads

PREDICTED_DILATION = 0.20  # metres
TRUE_DILATION = 0.18
CLEARED = 40  # cells, radius of the disc at a blocked end
MIN_GEODESIC = 2.0  # metres
SUCCESS_DISTANCE = 1.0
MAX_OBSTACLE_CELLS = 10  # a path that crosses as many fails
OBJECT_RING = 25  # cells
NOISE_SHARE = 0.1
_RING_WIDTH = 5  # cells beyond the nearest free one
_RING_REACH = 100  # cells: an object farther from free space than success allows is out of reach


@dataclass(frozen=True)
class Episode:
    """One plan and its judgement. ``reason`` is empty for a success."""

    start: np.ndarray  # (2,) cell
    goal: np.ndarray | None  # (2,) cell of a PointGoal
    class_id: int  # of an ObjectGoal, else 0
    reason: str
    path: np.ndarray | None  # (K, 2) float cells, row and column
    length: float  # metres
    shortest: float  # metres

    @property
    def success(self) -> bool:
        """Whether the episode succeeded."""
        return not self.reason

    @property
    def spl(self) -> float:
        """Success weighted by path length, 0 to 1."""
        return weighted_success(self.success, self.length, self.shortest)


@dataclass(frozen=True)
class Tasks:
    """What is planned in a scene: the same for every field that is judged in it."""

    passable: np.ndarray  # (R, C) bool, the robot's centre may be here on the true map
    starts: np.ndarray  # (N, 2) cells
    goals: np.ndarray  # (N, 2) cells
    shortest: np.ndarray  # (N,) metres, start to goal
    classes: tuple[int, ...]  # that are within reach of the starts
    shortest_object: np.ndarray  # (16, N) metres, start to the ring of the class


def grow(free: np.ndarray, radius: float, cell: float) -> np.ndarray:
    """(R, C) bool: free cells whose centre is farther than ``radius`` (metres) from that of any obstacle cell.

    Example:
        >>> grow(np.array([[True, True, True, True, False]]), 0.02, 0.01).astype(int)
        array([[1, 1, 0, 0, 0]])
    """
    if free.all():
        return free.copy()
    return ndimage.distance_transform_edt(free) * cell > radius + 1e-9


def spl(episodes: Iterable[Episode]) -> float | None:
    """Mean success weighted by path length, percent; None without episodes."""
    values = [episode.spl for episode in episodes]
    return float(100 * np.mean(values)) if values else None


def _mask(shape: tuple[int, ...], cells: np.ndarray) -> np.ndarray:
    mask = np.zeros(shape, dtype=bool)
    mask[tuple(np.atleast_2d(cells).T)] = True
    return mask


def object_ring(columns: np.ndarray, passable: np.ndarray, min_share: float = 0.0) -> np.ndarray:
    """Where to stop beside an object (see the module's text).

    Args:
        columns: (R, C) bool, the columns of one class.
        passable: (R, C) bool, where one can stand.
        min_share: patches with fewer columns than this share of the largest patch are taken for noise.

    Returns:
        (R, C) bool.
    """
    ring = np.zeros_like(passable)
    if not columns.any():
        return ring
    there = _window(ndimage.find_objects(columns.astype(np.uint8))[0], columns.shape)
    columns, passable = columns[there], passable[there]
    # A map made of points has gaps: columns 2 cells apart belong together
    labels, patches = ndimage.label(ndimage.binary_dilation(columns, np.ones((3, 3), dtype=bool)), np.ones((3, 3)))
    labels = np.where(columns, labels, 0)
    sizes = np.bincount(labels.ravel(), minlength=patches + 1)[1:]
    for k, box in enumerate(ndimage.find_objects(labels), start=1):
        if sizes[k - 1] < min_share * sizes.max():
            continue
        window = _window(box, columns.shape)
        free = passable[window]
        if free.any():
            distance = ndimage.distance_transform_edt(labels[window] != k)
            nearest = distance[free].min()
            if nearest < _RING_REACH:
                ring[there][window] |= free & (distance <= max(OBJECT_RING, nearest + _RING_WIDTH))
    return ring


def _window(box: tuple[slice, ...], shape: tuple[int, ...]) -> tuple[slice, ...]:
    """The box with everything around it that an object ring may reach."""
    return tuple(
        slice(max(0, s.start - _RING_REACH), min(size, s.stop + _RING_REACH))
        for s, size in zip(box, shape, strict=True)
    )


def make_tasks(truth: TrueMap, count: int, seed: int = 0) -> Tasks:
    """Seeded starts and goals of a scene, with the lengths of their shortest true paths."""
    passable = grow(truth.free, TRUE_DILATION, truth.grid.cell)
    labels, regions = ndimage.label(passable)
    if regions:
        passable = labels == 1 + int(np.argmax(np.bincount(labels.ravel())[1:]))
    cells = np.argwhere(passable)
    if not len(cells):
        empty = np.zeros((0, 2), dtype=np.int64)
        return Tasks(passable, empty, empty, np.zeros(0), (), np.zeros((NUM_CLASSES, 0)))
    rng = np.random.default_rng([seed, 3])
    starts = cells[rng.integers(len(cells), size=count)]
    # Each episode draws from a stream of its own, so that threads cannot change the goals
    streams = rng.spawn(count)

    def draw(i: int) -> tuple[np.ndarray, float]:
        distance = None
        for _ in range(100):
            goal = cells[streams[i].integers(len(cells))]
            if distance is None:
                stop = None if np.hypot(*(goal - starts[i])) * truth.grid.cell < MIN_GEODESIC else goal
                field = travel_distance(passable, _mask(passable.shape, starts[i]), truth.grid.cell, stop_at=stop)
                distance = field if stop is None else None
            else:
                field = distance
            if field[tuple(goal)] >= MIN_GEODESIC:
                return goal, float(field[tuple(goal)])
        return starts[i], 0.0  # an apartment where nothing is 2 m away

    with ThreadPoolExecutor(threads()) as pool:
        drawn = list(pool.map(draw, range(count)))
        rings = {k: object_ring(truth.semantics[k - 1], passable) for k in truth.classes}
        classes = tuple(k for k, ring in rings.items() if ring.any())
        fields = pool.map(lambda k: travel_distance(passable, rings[k], truth.grid.cell)[tuple(starts.T)], classes)
        shortest_object = np.full((NUM_CLASSES, count), np.inf)
        for k, field in zip(classes, fields, strict=True):
            shortest_object[k] = field
    goals = np.array([goal for goal, _ in drawn])
    return Tasks(passable, starts, goals, np.array([length for _, length in drawn]), classes, shortest_object)


_TASKS: dict[tuple[int, int, int], Tasks] = {}  # by id of the true map, count and seed: all fields get the same


def scene_tasks(truth: TrueMap, count: int, seed: int = 0) -> Tasks:
    """:func:`make_tasks`, made once for each true map."""
    key = (id(truth), count, seed)
    if key not in _TASKS:
        _TASKS[key] = make_tasks(truth, count, seed)
        weakref.finalize(truth, _TASKS.pop, key, None)
    return _TASKS[key]


def _disc(center: np.ndarray, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Cells of the cleared disc, and their distances from its centre in cells."""
    offsets = np.indices((2 * CLEARED + 1, 2 * CLEARED + 1)).reshape(2, -1).T - CLEARED
    offsets = offsets[np.hypot(*offsets.T) <= CLEARED]
    cells = center + offsets
    inside = np.all((cells >= 0) & (cells < np.array(shape)), axis=1)
    return cells[inside], np.hypot(*offsets[inside].T)


def _follow(distance: np.ndarray, start: np.ndarray, cell: float) -> np.ndarray | None:
    """Path from a start down a field of distances; None when there is none.

    In a cleared disc nothing is in the way, so the way out of it is straight: to the cell with the shortest sum.
    """
    if np.isfinite(distance[tuple(start)]):
        return descend(distance, start, cell)
    cells, radius = _disc(start, distance.shape)
    total = radius * cell + distance[tuple(cells.T)]
    best = int(np.argmin(total))
    if not np.isfinite(total[best]):
        return None
    return np.concatenate([np.asarray(start, dtype=np.float64)[None], descend(distance, cells[best], cell)])


def obstacle_cells(path: np.ndarray, passable: np.ndarray) -> int:
    """How many distinct cells of a (K, 2) path in cells are not passable.

    Example:
        >>> free = np.ones((5, 5), bool); free[:, 2] = False
        >>> obstacle_cells(np.array([[1.0, 0.0], [1.0, 4.0]]), free)
        1
    """
    steps = np.maximum(1, np.ceil(np.abs(np.diff(path, axis=0)).max(axis=1) * 4).astype(int)) if len(path) > 1 else []
    dense = [path[:1]]
    for a, b, n in zip(path[:-1], path[1:], steps, strict=True):
        dense.append(a + (b - a) * np.arange(1, n + 1)[:, None] / n)
    cells = np.unique(np.rint(np.concatenate(dense)).astype(np.int64), axis=0)
    return int(np.sum(~passable[tuple(cells.T)]))


def _judge(path: np.ndarray | None, tasks: Tasks, i: int, end_distance: Callable[[np.ndarray], float]) -> str:
    if path is None:
        return "no path"
    if obstacle_cells(path, tasks.passable) >= MAX_OBSTACLE_CELLS:
        return "through an obstacle"
    return "" if end_distance(path[-1]) < SUCCESS_DISTANCE else "ended far"


def plan_points(free: np.ndarray, tasks: Tasks, cell: float) -> list[Episode]:
    """Plan and judge every PointGoal on a map of free cells that is already grown."""

    def episode(i: int) -> Episode:
        start, goal = tasks.starts[i], tasks.goals[i]
        here = free
        if not free[tuple(goal)]:
            here = free.copy()
            here[tuple(_disc(goal, free.shape)[0].T)] = True
        stop = start if here[tuple(start)] else None
        path = _follow(travel_distance(here, _mask(free.shape, goal), cell, stop_at=stop), start, cell)
        reason = _judge(path, tasks, i, lambda end: float(np.hypot(*(end - goal)) * cell))
        length = np.inf if path is None else path_length(path, cell)
        return Episode(start, goal, 0, reason, path, length, float(tasks.shortest[i]))

    reachable = np.flatnonzero(tasks.shortest > 0)
    with ThreadPoolExecutor(threads()) as pool:
        return list(pool.map(episode, reachable.tolist()))


def plan_objects(free: np.ndarray, labels: np.ndarray, truth: TrueMap, tasks: Tasks) -> list[Episode]:
    """Plan and judge every ObjectGoal; ``labels`` (R, C) is the predicted class of each column."""
    cell = truth.grid.cell

    def of_class(k: int) -> list[Episode]:
        columns = labels == k
        field = travel_distance(free, object_ring(columns, free, NOISE_SHARE), cell) if columns.any() else None
        tree = cKDTree(np.argwhere(truth.semantics[k - 1]))
        episodes = []
        for i in np.flatnonzero(tasks.shortest_object[k] > 0).tolist():
            start = tasks.starts[i]
            path = None if field is None else _follow(field, start, cell)
            reason = _judge(path, tasks, i, lambda end: float(tree.query(end)[0] * cell))
            reason = "class not predicted" if field is None else reason
            length = np.inf if path is None else path_length(path, cell)
            episodes.append(Episode(start, None, k, reason, path, length, float(tasks.shortest_object[k, i])))
        return episodes

    with ThreadPoolExecutor(threads()) as pool:
        return [episode for group in pool.map(of_class, tasks.classes) for episode in group]


def evaluate_planning(
    states: np.ndarray, labels: np.ndarray, truth: TrueMap, tasks: Tasks, dilation: float = PREDICTED_DILATION
) -> TaskResult:
    """Plan on a predicted map and judge on the true one.

    Args:
        states: (R, C) of :class:`~autonerf_lab.evaluators.maps.CellState`.
        labels: (R, C) predicted class of each column, 0 for none.
        truth: on the same grid.
        tasks: of :func:`make_tasks`.
        dilation: metres by which the predicted obstacles are grown.
    """
    free = grow(states == CellState.FREE, dilation, truth.grid.cell)
    points, objects = plan_points(free, tasks, truth.grid.cell), plan_objects(free, labels, truth, tasks)
    result = planning_scores(points, objects, truth)
    return replace(result, artifact=result.artifact | {"free": free})


def planning_scores(points: list[Episode], objects: list[Episode], truth: TrueMap) -> TaskResult:
    """The four scores of judged episodes, and how many ended how."""
    values: dict[str, float | None] = {}
    n, status = {}, {}
    both = {"pointgoal": points, "objectgoal": objects}
    for name, episodes in both.items():
        rate = float(100 * np.mean([e.success for e in episodes])) if episodes else None
        values |= {f"{name}_success": rate, f"{name}_spl": spl(episodes)}
        for metric in (f"{name}_success", f"{name}_spl"):
            n[metric] = len(episodes)
            if not episodes:
                nothing = name == "objectgoal" and not truth.classes
                status[metric] = "no object in the scene" if nothing else "no goal within reach"
    reasons = {name: _reasons(episodes) for name, episodes in both.items()}
    named = {"PointGoal": reasons["pointgoal"], "ObjectGoal": reasons["objectgoal"]}
    for k in sorted({e.class_id for e in objects}):
        named[f"ObjectGoal: {CLASS_NAMES[k]}"] = _reasons(e for e in objects if e.class_id == k)
    artifact = {"points": points, "objects": objects, "reasons": reasons}
    return TaskResult(values, n, status, artifact, {"reasons": named})


def _reasons(episodes: Iterable[Episode]) -> dict[str, int]:
    return dict(sorted(Counter(episode.reason or "success" for episode in episodes).items()))
