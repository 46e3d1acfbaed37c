"""PointNav and ObjectNav episodes of Habitat, run in this package's simulator and scored by Habitat's definitions.

An episode ends when the policy stops, or after ``max_steps`` actions. It succeeds when the policy stopped at a shortest
path length of at most 0.2 m to the goal (PointNav), or 0.1 m to a view point of an object of the class (ObjectNav).
``SPL = mean of S l / max(p, l)`` (Anderson et al. 2018) with success S, path length p, and the length l of the shortest
path from start to goal, on the navigable floor of this simulator.

The robot is that of this package: 0.25 m forward, 30 degree turns, a disc of 0.18 m.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Protocol

import numpy as np
from scipy.spatial.transform import Rotation
from tqdm import tqdm

from autonerf_lab.classes import CLASS_NAMES
from autonerf_lab.data.episodes import Episode, Vector, scene_name
from autonerf_lab.errors import DataError, UnknownNameError
from autonerf_lab.evaluators.scores import Scores
from autonerf_lab.geometry import Intrinsics, cell_to_world, planar_pose, world_to_cell
from autonerf_lab.mapping import Mapper, empty_map
from autonerf_lab.mapping.semantic_map import MAP_CELL
from autonerf_lab.planning import LocalPolicy, travel_distance, weighted_success
from autonerf_lab.scenes.class_aliases import class_of
from autonerf_lab.scenes.import_report import STOREY
from autonerf_lab.scenes.scene import Scene
from autonerf_lab.simulator import Simulator
from autonerf_lab.types import Action, MapState, Observation, Score

STOP = len(Action)
SUCCESS_DISTANCE = {"pointnav": 0.2, "objectnav": 0.1}  # metres
MAX_STEPS = 500
_SNAP = 0.5  # metres, largest distance of a start or goal to the navigable floor
_LEVEL = 0.5  # metres, largest height of a start or goal above or below the floor of the robot
_SIGHT = 1.0  # metres between a view point and the box of its object
_NEAR = 1.0  # metres, least length of a sampled shortest path


@dataclass(frozen=True)
class Goal:
    """Goal that a policy is given."""

    position: np.ndarray | None  # (2,) world x, y by odometry, metres; None for ObjectNav
    category: str  # class of the object; empty for PointNav


class GoalPolicy(Protocol):
    """Policy for episodes: any object with these two methods."""

    def reset(self, goal: Goal, observation: Observation, seed: int) -> None:
        """Begin an episode."""

    def act(self, observation: Observation) -> int:
        """Return 0 forward, 1 turn left, 2 turn right, or 3 stop."""


class FastMarching:
    """Fast marching on a map that the robot builds itself; goes to the goal, or to the nearest seen object."""

    def __init__(self) -> None:
        self._goal = Goal(np.zeros(2), "")
        self._mapper: Mapper | None = None
        self._local = LocalPolicy()
        self._camera: Intrinsics | None = None
        self._rng = np.random.default_rng(0)
        self._waypoint: np.ndarray | None = None

    def reset(self, goal: Goal, observation: Observation, seed: int) -> None:
        """Begin an episode with an empty map of 48 m, which grows."""
        height, width = observation.depth.shape
        self._goal, self._local, self._rng, self._waypoint = goal, LocalPolicy(), np.random.default_rng(seed), None
        start, camera = empty_map(observation.pose, round(48 / MAP_CELL)), Intrinsics.from_fov(width, height)
        self._mapper = Mapper(start, camera, grows=True)

    def act(self, observation: Observation) -> int:
        """Follow the path to the goal, and stop there."""
        assert self._mapper is not None, "reset the policy first"
        _, known = self._mapper.add(observation)
        here = observation.pose[:2, 3]
        target = self._goal.position
        if target is None:
            cells = np.argwhere(known.semantics[CLASS_NAMES.index(self._goal.category) - 1])
            seen = cell_to_world(cells, known.origin, known.cell)
            if len(seen):
                target = seen[np.argmin(np.linalg.norm(seen - here, axis=1))]
                if np.linalg.norm(target - here) < _SIGHT:
                    return STOP
            else:
                target = self._random_waypoint(known, here)
        elif np.linalg.norm(target - here) < SUCCESS_DISTANCE["pointnav"]:
            return STOP
        return int(self._local.act(known, target))

    def _random_waypoint(self, known: MapState, here: np.ndarray) -> np.ndarray:
        """Return a random explored free cell as waypoint, chosen again when it is reached."""
        if self._waypoint is None or np.linalg.norm(self._waypoint - here) < 0.5 or self._rng.random() < 0.02:
            free = np.argwhere(known.explored & ~known.occupied)
            self._waypoint = cell_to_world(free[self._rng.integers(len(free))], known.origin, known.cell)
        return self._waypoint


class RandomActions:
    """Uniformly random actions, with a stop in one of 50."""

    def __init__(self) -> None:
        self._rng = np.random.default_rng(0)

    def reset(self, goal: Goal, observation: Observation, seed: int) -> None:
        """Begin an episode."""
        self._rng = np.random.default_rng(seed)

    def act(self, observation: Observation) -> int:
        """Return a random action."""
        return STOP if self._rng.random() < 0.02 else int(self._rng.integers(STOP))


GOAL_POLICIES: dict[str, Callable[[], GoalPolicy]] = {"fast-marching": FastMarching, "random": RandomActions}


def make_goal_policy(policy: str | GoalPolicy | Callable[[], GoalPolicy]) -> GoalPolicy:
    """Return a policy by name, by ``module:Class``, by class, or as it is.

    Raises:
        UnknownNameError: there is no such name, module or class.
    """
    made: Any = policy
    if isinstance(policy, str):
        module, _, name = policy.partition(":")
        try:
            made = getattr(import_module(module), name) if name else GOAL_POLICIES[policy]
        except (ImportError, AttributeError, KeyError) as error:
            raise UnknownNameError("policy", policy, [*GOAL_POLICIES, "module:Class"]) from error
    return made() if isinstance(made, type) or not hasattr(made, "act") else made


def evaluate_episodes(
    policy: str | GoalPolicy | Callable[[], GoalPolicy],
    episodes: Sequence[Episode],
    scene: Scene,
    *,
    size: int = 128,
    max_steps: int = MAX_STEPS,
    success_distance: float | None = None,
    seed: int = 0,
    progress: bool = True,
) -> Scores:
    """Run episodes in their scene, and return success, SPL and the distance to the goal by Habitat's definitions.

    Args:
        policy: a name (``fast-marching``, ``random``), ``module:Class``, a class, or an object with ``reset`` and
            ``act``, see :class:`GoalPolicy`.
        episodes: episodes of one kind, see :func:`~autonerf_lab.data.episodes.read_episodes`; those of other scenes
            are left out.
        scene: an imported scene, to which the positions of the episodes are moved, or a scene of this package.
        size: pixels a side of the robot's images, 90 degrees wide.
        max_steps: number of actions after which an episode fails.
        success_distance: metres; default: 0.2 for PointNav, 0.1 for ObjectNav.
        seed: random seed of the policy.
        progress: show a progress bar.

    Returns:
        Rows ``success`` and ``spl`` in percent, ``distance_to_goal`` in metres. ``scores.artifacts["episodes"]`` holds
        the values of each episode. Episodes whose start or goal is not on the navigable floor or on another floor of
        the building, or whose class is not known, are left out, and counted in the status.

    Raises:
        DataError: no episode belongs to the scene, or the episodes are of both kinds.
        UnknownNameError: unknown policy.
    """
    chosen = [episode for episode in episodes if episode.scene in (scene_name(scene.name), "")]
    if not chosen:
        names = ", ".join(sorted({episode.scene for episode in episodes})[:10])
        raise DataError(f"no episode belongs to scene {scene.name!r}; the episodes have the scenes {names or 'none'}")
    kinds = {"objectnav" if episode.category else "pointnav" for episode in chosen}
    if len(kinds) > 1:
        raise DataError("the episodes are of both kinds, PointNav and ObjectNav; evaluate them separately")
    kind = kinds.pop()
    limit = SUCCESS_DISTANCE[kind] if success_distance is None else success_distance
    actor = make_goal_policy(policy)
    sim = Simulator(scene, Intrinsics.from_fov(size, size), supersample=1)
    rows: list[dict[str, Any]] = []
    for number, episode in enumerate(tqdm(chosen, disable=not progress, leave=False, desc="episodes")):
        rows.append(_run(sim, actor, episode, limit, max_steps, seed + number))
    valid = [row for row in rows if not row["status"]]
    left_out = [row["status"] for row in rows if row["status"]]
    status = f"{len(left_out)} episodes left out: {left_out[0]}" if left_out else "ok"
    name = policy if isinstance(policy, str) else type(actor).__name__

    def row(metric: str, factor: float, unit: str) -> Score:
        value = factor * float(np.mean([row[metric] for row in valid])) if valid else None
        return Score(kind, metric, value, unit, status, len(valid), scene=scene.name, policy=name, seed=seed)

    found = [row("success", 100.0, "%"), row("spl", 100.0, "%"), row("distance_to_goal", 1.0, "m")]
    return Scores(found, {"episodes": {"rows": rows}})


def _run(
    sim: Simulator, policy: GoalPolicy, episode: Episode, limit: float, max_steps: int, seed: int
) -> dict[str, Any]:
    x, y, heading = start_of(episode, sim.scene)
    ground = sim.navigation
    row = {"episode_id": episode.episode_id, "status": "", "success": 0.0, "spl": 0.0, "distance_to_goal": np.nan}
    positions = np.stack([to_scene(goal, sim.scene) for goal in episode.goals])
    highest = STOREY if episode.category else _LEVEL  # without view points, a goal is the centre of an object
    positions = positions[(positions[:, 2] > -_LEVEL) & (positions[:, 2] < highest)]
    if not len(positions) or abs(to_scene(episode.start_position, sim.scene)[2]) > _LEVEL:
        return row | {"status": "start or goal is on another floor of the building than the robot"}
    goals = _snapped(sim, positions[:, :2])
    starts = _snapped(sim, np.array([[x, y]]))
    if not len(goals) or not len(starts):
        return row | {"status": "start or goal is not on the navigable floor"}
    distance = travel_distance(ground.navigable, goals, ground.cell)
    shortest = float(distance[tuple(starts[0])])
    if not np.isfinite(shortest):
        return row | {"status": "there is no path to the goal"}
    own_cell = world_to_cell(np.array([x, y]), ground.origin, ground.cell)
    if not ground.is_navigable(x, y) or (own_cell != starts[0]).any():  # the robot may fit, but in a closed-off corner
        x, y = (float(v) for v in cell_to_world(starts[0], ground.origin, ground.cell))
    observation = sim.reset(pose=planar_pose(x, y, heading))
    category = CLASS_NAMES[class_of(episode.category)] if episode.category else ""  # "sofa" is "couch" here
    if category == CLASS_NAMES[0]:
        return row | {"status": f"{episode.category!r} is none of the 15 classes"}
    point = None if episode.category else to_scene(episode.goals[0], sim.scene)[:2]
    policy.reset(Goal(point, category), observation, seed)
    path, stopped = 0.0, False
    for _ in range(max_steps):
        action = int(policy.act(observation))
        if action == STOP:
            stopped = True
            break
        before = sim.pose[:2, 3].copy()
        observation = sim.step(action)
        path += float(np.linalg.norm(sim.pose[:2, 3] - before))
    here = _snapped(sim, sim.pose[None, :2, 3])
    left = float(distance[tuple(here[0])]) if len(here) else np.inf
    success = stopped and left <= limit
    spl = weighted_success(success, path, shortest)
    return row | {"success": float(success), "spl": spl, "distance_to_goal": left, "path": path, "shortest": shortest}


def to_scene(position: Vector | np.ndarray, scene: Scene) -> np.ndarray:
    """Return the (3,) position in a scene of a position in Habitat's world."""
    x, y, z = position
    offset = scene.import_report.offset if scene.import_report else (0.0, 0.0, 0.0)
    return np.array([x, -z, y]) - offset


def from_scene(position: np.ndarray, scene: Scene) -> Vector:
    """Return the position in Habitat's world of a (3,) position in a scene; inverse of :func:`to_scene`."""
    x, y, z = np.asarray(position) + (scene.import_report.offset if scene.import_report else (0.0, 0.0, 0.0))
    return float(x), float(z), float(-y)


def start_of(episode: Episode, scene: Scene) -> tuple[float, float, float]:
    """Return x, y and heading of the start of an episode in its scene."""
    position = to_scene(episode.start_position, scene)
    fx, _, fz = Rotation.from_quat(episode.start_rotation).apply([0.0, 0.0, -1.0])
    return float(position[0]), float(position[1]), float(np.arctan2(-fz, fx))


def _snapped(sim: Simulator, points: np.ndarray) -> np.ndarray:
    """Return the (K, 2) nearest navigable cells of (N, 2) positions, without those farther than 0.5 m."""
    ground = sim.navigation
    cells = np.argwhere(ground.navigable)
    centres = cell_to_world(cells, ground.origin, ground.cell)
    found = []
    for point in points:
        gaps = np.linalg.norm(centres - point, axis=1)
        nearest = int(np.argmin(gaps))
        if gaps[nearest] <= _SNAP:
            found.append(cells[nearest])
    return np.array(found, dtype=np.int64).reshape(-1, 2)


def sample_episodes(scene: Scene, count: int, seed: int = 0, kind: str = "pointnav") -> list[Episode]:
    """Sample episodes in a scene, for :func:`~autonerf_lab.data.episodes.write_episodes`.

    Args:
        scene: the scene.
        count: number of episodes.
        seed: random seed.
        kind: ``pointnav``: uniform goals with a shortest path of at least 1 m; ``objectnav``: the classes of the scene
            in turn, whose view points are navigable positions within 1 m of an object's box.

    Raises:
        UnknownNameError: unknown kind.
        DataError: the scene has no object of the 15 classes near the navigable floor.
    """
    if kind not in SUCCESS_DISTANCE:
        raise UnknownNameError("kind of episode", kind, SUCCESS_DISTANCE)
    ground = Simulator(scene, Intrinsics.from_fov(8, 8), supersample=1, rgb=False).navigation
    cells = np.argwhere(ground.navigable)
    centres = cell_to_world(cells, ground.origin, ground.cell)
    rng = np.random.default_rng([seed, 9])
    places: dict[str, np.ndarray] = {}
    for item in scene.instances if kind == "objectnav" else ():
        gap = np.linalg.norm(np.maximum(np.abs(centres - item.center[:2]) - item.size[:2] / 2, 0), axis=1)
        near = np.flatnonzero(gap < _SIGHT)[::20]
        if item.class_id and len(near):
            name = CLASS_NAMES[item.class_id]
            places[name] = np.concatenate([places.get(name, np.zeros(0, np.int64)), near])
    if kind == "objectnav" and not places:
        raise DataError(f"scene {scene.name!r} has no object of the 15 classes near the navigable floor")
    found: list[Episode] = []
    while len(found) < count:
        category = sorted(places)[len(found) % len(places)] if places else ""
        goals = places[category] if places else rng.integers(len(cells), size=1)
        distance = travel_distance(ground.navigable, cells[goals], ground.cell)
        far = np.flatnonzero((distance[tuple(cells.T)] >= _NEAR) & np.isfinite(distance[tuple(cells.T)]))
        start = int(rng.choice(far if len(far) else np.arange(len(cells))))
        heading = float(rng.uniform(-np.pi, np.pi))
        half = (heading - np.pi / 2) / 2  # about y, from -z
        found.append(
            Episode(
                str(len(found)),
                scene.name,
                from_scene(np.array([*centres[start], 0.0]), scene),
                (0.0, float(np.sin(half)), 0.0, float(np.cos(half))),
                tuple(from_scene(np.array([*centres[goal], 0.0]), scene) for goal in goals.tolist()),
                category,
                float(distance[tuple(cells[start])]),
            )
        )
    return found
