"""Task 3, planning: paths planned on the predicted map (section 4.3, and "Planning" of the appendix).

**Maps.** Paths are planned on the predicted map with 1 cm cells, in which occupied and unknown cells are obstacles,
dilated by 20 cm. They are judged on the true map, in which every cell that is not free is an obstacle, dilated by 18
cm, the robot's radius. If the predicted map blocks the start or the goal, a disc of 40 cells around it is cleared, as
in the released code. A free start or goal is not cleared: clearing would open short cuts through known obstacles, and
paths planned on true maps would fail.

**PointGoal.** The starts are seeded and uniform over the cells in which the robot fits on the true map. The goal is
sampled in the same way, at a geodesic distance of at least 2 m. An episode succeeds if the path ends less than 1 m from
the goal and crosses fewer than 10 obstacle cells.

**ObjectGoal.** The starts are the same, for every class on the true map that has an object beside reachable ground: an
object that no robot can reach (a cup in a sealed corner) is left out. The goal region consists of the free cells at
most 25 cm from the predicted cells of the class (the disc of the released code). If there are none, for an object in
the middle of a table or behind other furniture, it consists of the cells at most 5 cm farther away than the nearest
free cell. Each connected patch of predicted cells has its own goal region, and the path leads to the nearest. Patches
with less than a tenth of the cells of the largest patch of their class are treated as noise (the released code drops
patches under 300 cells, and with them every cup). An episode succeeds if the path ends less than 1 m from a true cell
of the class and crosses fewer than 10 obstacle cells. If the class was not predicted, the episode fails.

**SPL** = mean of S l / max(p, l), with success S, path length p and the shortest path length l on the true map, to the
goal or to the goal region around the true cells of the class. A start inside this region (l = 0) is not an episode: its
SPL would be zero for any path.

Every failed episode has a reason: ``class not predicted``, ``no path``, ``through an obstacle`` or ``ended far``.
"""

import weakref
from collections import Counter
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from autonerf_lab.classes import CLASS_NAMES, NUM_CLASSES
from autonerf_lab.evaluators.ground_truth import TrueMap
from autonerf_lab.evaluators.maps import CellState
from autonerf_lab.evaluators.metrics import metrics_of
from autonerf_lab.evaluators.task import Task, TaskFigure, TaskResult
from autonerf_lab.planning.fast_marching import descend, path_length, travel_distance, weighted_success
from autonerf_lab.utils.resources import threads

if TYPE_CHECKING:
    from autonerf_lab.evaluators.context import EvaluationContext

PREDICTED_DILATION = 0.20  # metres
TRUE_DILATION = 0.18
CLEARED = 40  # cells, radius of the disc cleared around a blocked start or goal
MIN_GEODESIC = 2.0  # metres
SUCCESS_DISTANCE = 1.0
MAX_OBSTACLE_CELLS = 10  # a path that crosses this many cells fails
OBJECT_RING = 25  # cells
NOISE_SHARE = 0.1
_RING_WIDTH = 5  # cells beyond the nearest free cell
_RING_REACH = 100  # cells: an object farther from free space than the success distance is out of reach


@dataclass(frozen=True)
class Episode:
    """One planned path and its outcome."""

    start: np.ndarray  # (2,) cell
    goal: np.ndarray | None  # (2,) cell of a PointGoal
    class_id: int  # of an ObjectGoal, else 0
    reason: str  # of the failure, "" for a success
    path: np.ndarray | None  # (K, 2) float cells, row and column
    length: float  # path length, metres
    shortest: float  # shortest path length on the true map, metres

    @property
    def success(self) -> bool:
        """True if the episode succeeded."""
        return not self.reason

    @property
    def spl(self) -> float:
        """Success weighted by path length, 0 to 1."""
        return weighted_success(self.success, self.length, self.shortest)


@dataclass(frozen=True)
class EpisodeSet:
    """Starts and goals of the planning episodes of a scene, the same for every field."""

    passable: np.ndarray  # (R, C) bool, cells in which the centre of the robot may be on the true map
    starts: np.ndarray  # (N, 2) cells
    goals: np.ndarray  # (N, 2) cells
    shortest: np.ndarray  # (N,) metres, start to goal
    classes: tuple[int, ...]  # within reach of the starts
    shortest_object: np.ndarray  # (16, N) metres, start to the goal region of the class


def dilate_obstacles(free: np.ndarray, radius: float, cell: float) -> np.ndarray:
    """Return the free cells that remain after the obstacles are dilated.

    Args:
        free: (R, C) bool.
        radius: metres, between the centres of cells.
        cell: side of a cell, metres.

    Example:
        >>> dilate_obstacles(np.array([[True, True, True, True, False]]), 0.02, 0.01).astype(int)
        array([[1, 1, 0, 0, 0]])
    """
    if free.all():
        return free.copy()
    return ndimage.distance_transform_edt(free) * cell > radius + 1e-9


def spl(episodes: Iterable[Episode]) -> float | None:
    """Compute the mean success weighted by path length, percent; None without episodes."""
    values = [episode.spl for episode in episodes]
    return float(100 * np.mean(values)) if values else None


def object_ring(cells: np.ndarray, passable: np.ndarray, min_share: float = 0.0) -> np.ndarray:
    """Return the goal region around the objects of a class (see the module docstring).

    Args:
        cells: (R, C) bool, the cells of the class.
        passable: (R, C) bool, the cells in which a robot can stand.
        min_share: patches with fewer cells than this share of the largest patch are treated as noise.

    Returns:
        (R, C) bool.
    """
    ring = np.zeros_like(passable)
    if not cells.any():
        return ring
    there = _window(ndimage.find_objects(cells.astype(np.uint8))[0], cells.shape)
    cells, passable = cells[there], passable[there]
    # A map made of points has gaps: cells at a distance of 2 belong to one patch
    labels, patches = ndimage.label(ndimage.binary_dilation(cells, np.ones((3, 3), dtype=bool)), np.ones((3, 3)))
    labels = np.where(cells, labels, 0)
    sizes = np.bincount(labels.ravel(), minlength=patches + 1)[1:]
    for k, box in enumerate(ndimage.find_objects(labels), start=1):
        if sizes[k - 1] < min_share * sizes.max():
            continue
        window = _window(box, cells.shape)
        free = passable[window]
        if free.any():
            distance = ndimage.distance_transform_edt(labels[window] != k)
            nearest = distance[free].min()
            if nearest < _RING_REACH:
                ring[there][window] |= free & (distance <= max(OBJECT_RING, nearest + _RING_WIDTH))
    return ring


def _window(box: tuple[slice, ...], shape: tuple[int, ...]) -> tuple[slice, ...]:
    """Enlarge a box by the reach of a goal region."""
    return tuple(
        slice(max(0, s.start - _RING_REACH), min(size, s.stop + _RING_REACH))
        for s, size in zip(box, shape, strict=True)
    )


def sample_episodes(truth: TrueMap, count: int, seed: int = 0) -> EpisodeSet:
    """Sample ``count`` starts and goals in a scene, and compute the shortest path lengths on its true map."""
    passable = dilate_obstacles(truth.free, TRUE_DILATION, truth.grid.cell)
    labels, regions = ndimage.label(passable)
    if regions:
        passable = labels == 1 + int(np.argmax(np.bincount(labels.ravel())[1:]))
    cells = np.argwhere(passable)
    if not len(cells):
        empty = np.zeros((0, 2), dtype=np.int64)
        return EpisodeSet(passable, empty, empty, np.zeros(0), (), np.zeros((NUM_CLASSES, 0)))
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
                field = travel_distance(passable, starts[i], truth.grid.cell, stop_at=stop)
                distance = field if stop is None else None
            else:
                field = distance
            if field[tuple(goal)] >= MIN_GEODESIC:
                return goal, float(field[tuple(goal)])
        return starts[i], 0.0  # no cell of the apartment is 2 m away

    with ThreadPoolExecutor(threads()) as pool:
        drawn = list(pool.map(draw, range(count)))
        rings = {k: object_ring(truth.semantics[k - 1], passable) for k in truth.classes}
        classes = tuple(k for k, ring in rings.items() if ring.any())
        fields = pool.map(lambda k: travel_distance(passable, rings[k], truth.grid.cell)[tuple(starts.T)], classes)
        shortest_object = np.full((NUM_CLASSES, count), np.inf)
        for k, field in zip(classes, fields, strict=True):
            shortest_object[k] = field
    goals = np.array([goal for goal, _ in drawn])
    return EpisodeSet(passable, starts, goals, np.array([length for _, length in drawn]), classes, shortest_object)


_EPISODES: dict[tuple[int, int, int], EpisodeSet] = {}  # by id of the true map, count and seed


def scene_episodes(truth: TrueMap, count: int, seed: int = 0) -> EpisodeSet:
    """Return the result of :func:`sample_episodes`, cached as long as the true map exists."""
    key = (id(truth), count, seed)
    if key not in _EPISODES:
        _EPISODES[key] = sample_episodes(truth, count, seed)
        weakref.finalize(truth, _EPISODES.pop, key, None)
    return _EPISODES[key]


def _disc(center: np.ndarray, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return the cells of the cleared disc, and their distances from its centre in cells."""
    offsets = np.indices((2 * CLEARED + 1, 2 * CLEARED + 1)).reshape(2, -1).T - CLEARED
    offsets = offsets[np.hypot(*offsets.T) <= CLEARED]
    cells = center + offsets
    inside = np.all((cells >= 0) & (cells < np.array(shape)), axis=1)
    return cells[inside], np.hypot(*offsets[inside].T)


def _follow(distance: np.ndarray, start: np.ndarray, cell: float) -> np.ndarray | None:
    """Follow a distance field downhill; a blocked start is left on a straight line. None if there is no path."""
    if np.isfinite(distance[tuple(start)]):
        return descend(distance, start, cell)
    cells, radius = _disc(start, distance.shape)
    total = radius * cell + distance[tuple(cells.T)]
    best = int(np.argmin(total))
    if not np.isfinite(total[best]):
        return None
    return np.concatenate([np.asarray(start, dtype=np.float64)[None], descend(distance, cells[best], cell)])


def obstacle_cells(path: np.ndarray, passable: np.ndarray) -> int:
    """Count the distinct cells on a (K, 2) path, in cells, that are not passable.

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


def _judge(
    path: np.ndarray | None, episode_set: EpisodeSet, i: int, end_distance: Callable[[np.ndarray], float]
) -> str:
    if path is None:
        return "no path"
    if obstacle_cells(path, episode_set.passable) >= MAX_OBSTACLE_CELLS:
        return "through an obstacle"
    return "" if end_distance(path[-1]) < SUCCESS_DISTANCE else "ended far"


def plan_points(free: np.ndarray, episode_set: EpisodeSet, cell: float) -> list[Episode]:
    """Plan and judge all PointGoal episodes.

    Args:
        free: (R, C) bool, free cells of the predicted map after the obstacles are dilated.
        episode_set: starts and goals.
        cell: side of a cell, metres.
    """

    def episode(i: int) -> Episode:
        start, goal = episode_set.starts[i], episode_set.goals[i]
        here = free
        if not free[tuple(goal)]:
            here = free.copy()
            here[tuple(_disc(goal, free.shape)[0].T)] = True
        stop = start if here[tuple(start)] else None
        path = _follow(travel_distance(here, goal, cell, stop_at=stop), start, cell)
        reason = _judge(path, episode_set, i, lambda end: float(np.hypot(*(end - goal)) * cell))
        length = np.inf if path is None else path_length(path, cell)
        return Episode(start, goal, 0, reason, path, length, float(episode_set.shortest[i]))

    reachable = np.flatnonzero(episode_set.shortest > 0)
    with ThreadPoolExecutor(threads()) as pool:
        return list(pool.map(episode, reachable.tolist()))


def plan_objects(free: np.ndarray, labels: np.ndarray, truth: TrueMap, episode_set: EpisodeSet) -> list[Episode]:
    """Plan and judge all ObjectGoal episodes.

    Args:
        free: as in :func:`plan_points`.
        labels: (R, C) predicted class of each map cell.
        truth: ground truth on the same grid.
        episode_set: starts and classes.
    """
    cell = truth.grid.cell

    def of_class(k: int) -> list[Episode]:
        cells = labels == k
        field = travel_distance(free, object_ring(cells, free, NOISE_SHARE), cell) if cells.any() else None
        tree = cKDTree(np.argwhere(truth.semantics[k - 1]))
        episodes = []
        for i in np.flatnonzero(episode_set.shortest_object[k] > 0).tolist():
            start = episode_set.starts[i]
            path = None if field is None else _follow(field, start, cell)
            reason = _judge(path, episode_set, i, lambda end: float(tree.query(end)[0] * cell))
            reason = "class not predicted" if field is None else reason
            length = np.inf if path is None else path_length(path, cell)
            episodes.append(Episode(start, None, k, reason, path, length, float(episode_set.shortest_object[k, i])))
        return episodes

    with ThreadPoolExecutor(threads()) as pool:
        return [episode for group in pool.map(of_class, episode_set.classes) for episode in group]


def evaluate_planning(
    states: np.ndarray,
    labels: np.ndarray,
    truth: TrueMap,
    episode_set: EpisodeSet,
    dilation: float = PREDICTED_DILATION,
) -> TaskResult:
    """Plan paths on a predicted map and judge them on the true one.

    Args:
        states: (R, C) predicted :class:`~autonerf_lab.evaluators.maps.CellState`.
        labels: (R, C) predicted class of each map cell, 0 for none.
        truth: ground truth on the same grid.
        episode_set: starts and goals of :func:`sample_episodes`.
        dilation: of the predicted obstacles, metres.
    """
    free = dilate_obstacles(states == CellState.FREE, dilation, truth.grid.cell)
    points, objects = plan_points(free, episode_set, truth.grid.cell), plan_objects(free, labels, truth, episode_set)
    result = planning_scores(points, objects, truth)
    return replace(result, artifact=result.artifact | {"free": free})


def planning_scores(points: list[Episode], objects: list[Episode], truth: TrueMap) -> TaskResult:
    """Compute the four scores of judged episodes, and count the outcomes."""
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


class PlanningTask(Task):
    """Task 3: PointGoal and ObjectGoal planning."""

    name, metrics, title = "planning", metrics_of("planning"), "Path planning"
    text = (
        "Paths to points (PointGoal) and to objects (ObjectGoal) are planned on the predicted map and judged on the "
        "true map. A path succeeds if it ends less than 1 m from its goal and crosses fewer than 10 obstacle cells of "
        "1 cm. SPL is success weighted by path length: a successful path counts the length of the shortest path "
        "divided by its own length, a failed path counts 0."
    )
    figures = (
        TaskFigure(
            "paths",
            "planned_paths",
            title="Planned paths on the true map",
            caption="Successful paths are green. The other colours show why a path failed.",
            alt="Two floor plans with planned paths: to points on the left, to objects on the right",
        ),
    )

    def run(self, context: "EvaluationContext") -> TaskResult:
        """Plan on the predicted map of the field."""
        episode_set = scene_episodes(context.truth, context.preset.planning_starts, context.seed)
        result = evaluate_planning(context.states, context.labels, context.truth, episode_set)
        return replace(result, artifact=result.artifact | {"truth": context.truth, "episode_set": episode_set})
