"""Task 6, navigation in the mesh: can a robot that moves step by step use the reconstruction as a place to walk in?

After "Navigating inside a NeRF-generated mesh" of the paper's appendix. The mesh of the field gets the floor that the
robot rolled on (:func:`lay_floor`), is written, imported as any scan is, and put back to where it was. The same
PointGoal episodes are walked in it and in the true scene: seeded starts and goals where the robot fits in both, at
least 2 m apart on the shortest true way. The robot begins with an empty map, maps the depth it sees (64 x 64 pixels),
and follows the local policy's fast marching by forward steps and turns. It stops within 0.36 m of the goal, which is
success, or fails after 500 steps:

* ``no way``: on its map, nothing leads to the goal;
* ``stuck``: half of its last 50 steps were collisions;
* ``out of steps``: neither.

``SPL = mean of S l / max(p, l)``: S success, p the way that was walked, l the shortest to the goal itself in the place
that is walked in. Where the robot does not fit in the reconstruction no episode begins: a mesh with little ground has
easy ones, so look at the ground too (``ground.area``).
"""

import tempfile
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from autonerf_lab.errors import DataError, SceneError
from autonerf_lab.evaluators.mesh import export_mesh
from autonerf_lab.evaluators.radiance_field import Field
from autonerf_lab.evaluators.task_result import TaskResult
from autonerf_lab.geometry import Intrinsics, cell_to_world, planar_pose, world_to_cell
from autonerf_lab.mapping import Mapper, empty_map
from autonerf_lab.mapping.semantic_map import MAP_CELL
from autonerf_lab.nerf.visibility import VOXEL
from autonerf_lab.planning.fast_marching import path_length, travel_distance, weighted_success
from autonerf_lab.planning.local_policy import LocalPolicy
from autonerf_lab.scenes.mesh_import import import_scene
from autonerf_lab.scenes.scene import Scene
from autonerf_lab.simulator import Simulator
from autonerf_lab.simulator.navigation import CLIMB

if TYPE_CHECKING:
    import trimesh

SUCCESS_RADIUS = 0.36  # metres, twice the robot's radius
MAX_STEPS = 500
MIN_GEODESIC = 2.0  # metres
METRICS = ("success", "spl", "success_true_mesh", "spl_true_mesh")
_PIXELS = 64
_LAST = 50  # steps that tell why it did not arrive
_TRIES = 100  # draws of a goal for each episode
_MARGIN = 6.0  # metres of map around the place: as far as the robot sees, and a bit


@dataclass(frozen=True)
class Walk:
    """One episode. ``reason`` is empty for a success."""

    goal: np.ndarray  # (2,) world x, y
    path: np.ndarray  # (K, 2) world x, y, from the start on
    shortest: float  # metres
    reason: str

    @property
    def success(self) -> bool:
        """Whether it arrived."""
        return not self.reason

    @property
    def spl(self) -> float:
        """Success weighted by path length, 0 to 1."""
        return weighted_success(self.success, path_length(self.path), self.shortest)


def lay_floor(mesh: "trimesh.Trimesh", field: Field) -> "trimesh.Trimesh":
    """The reconstruction with the floor that a robot on wheels knows of: the plane z = 0, where its cameras saw it.

    What a field learned from colours makes of a plain floor has bumps, pits and holes that a camera 88 cm above it
    hardly sees and a robot cannot pass. What lies within 20 cm of the plane, which Habitat's robots climb, is put into
    it, and where a training ray came as far as the plane, there is floor. Furniture that stands there stays.

    Args:
        mesh: world frame, metres.
        field: it came from, whose :meth:`~autonerf_lab.evaluators.radiance_field.Field.seen` says where rays came.

    Returns:
        Geometry alone, without colours; an empty mesh as it is.
    """
    import trimesh

    if not len(mesh.faces):
        return mesh
    vertices = np.array(mesh.vertices)
    vertices[np.abs(vertices[:, 2]) < CLIMB, 2] = 0.0
    low, high = mesh.bounds[:, :2]
    cols, rows = np.ceil((high - low) / VOXEL).astype(int)
    middles = np.pad(cell_to_world(np.argwhere(np.ones((rows, cols), bool)), low, VOXEL), ((0, 0), (0, 1)))
    middles = middles[field.seen(middles)]
    tiles = middles[:, None] + VOXEL / 2 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    first = len(vertices) + 4 * np.arange(len(tiles))[:, None]
    faces = np.concatenate([mesh.faces, first + np.array([0, 1, 2]), first + np.array([0, 2, 3])])
    return trimesh.Trimesh(np.concatenate([vertices, tiles.reshape(-1, 3)]), faces, process=False)


def mesh_scene(mesh: "trimesh.Trimesh") -> Scene:
    """A mesh as a scene that one can walk in, through the same file and the same import as a scan from elsewhere.

    Args:
        mesh: world frame, metres.

    Returns:
        The scene, where the mesh was; its floor is at z = 0.

    Raises:
        SceneError: it has no floor.
        DataError: it is empty.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mesh.glb"
        try:
            scene = import_scene(export_mesh(mesh, path))
        except DataError as error:  # the name of a file that nobody will ever see again
            raise type(error)(str(error).replace(str(path), "the mesh")) from error
    middle = mesh.bounds.mean(axis=0) * (1, 1, 0)  # the import puts it to zero, and its floor
    return replace(scene, vertices=(scene.vertices + middle).astype(np.float32))


def draw_episodes(true: Simulator, other: Simulator, count: int, seed: int = 0) -> list[tuple[np.ndarray, np.ndarray]]:
    """Seeded pairs of starts and goals, (2,) world x, y, where the robot fits in both places; fewer where none are."""
    ground, second = true.navigation, other.navigation
    cells = np.argwhere(ground.navigable)
    places = cell_to_world(cells, ground.origin, ground.cell)
    there = world_to_cell(places, second.origin, second.cell)
    inside = np.all((there >= 0) & (there < second.navigable.shape), axis=1)
    both = np.flatnonzero(inside)
    both = both[second.navigable[tuple(there[both].T)]]
    both = np.array([k for k in both if second.is_navigable(*places[k])], dtype=np.int64)
    rng = np.random.default_rng([seed, 6])
    episodes: list[tuple[np.ndarray, np.ndarray]] = []
    for _ in range(count if len(both) else 0):
        start = rng.choice(both)
        distance = travel_distance(ground.navigable, cells[start][None], ground.cell)
        goals = rng.choice(both, size=_TRIES)
        far = goals[distance[tuple(cells[goals].T)] >= MIN_GEODESIC]
        if len(far):
            episodes.append((places[start], places[far[0]]))
    return episodes


def walk_to(sim: Simulator, start: np.ndarray, goal: np.ndarray, heading: float, max_steps: int = MAX_STEPS) -> Walk:
    """Walk from a start to a goal, both (2,) world x, y, by a map that is made on the way."""
    ground = sim.navigation
    ends = world_to_cell(np.stack([start, goal]), ground.origin, ground.cell)
    shortest = float(travel_distance(ground.navigable, ends[1:], ground.cell, stop_at=ends[0])[tuple(ends[0])])
    observation = sim.reset(pose=planar_pose(float(start[0]), float(start[1]), heading))
    size = float(np.abs(sim.scene.bounds[:, :2] - start).max()) + _MARGIN
    mapper, policy = Mapper(empty_map(observation.pose, 2 * round(size / MAP_CELL)), sim.intrinsics), LocalPolicy()
    path, collided = [sim.pose[:2, 3].copy()], list[bool]()
    while np.linalg.norm(path[-1] - goal) > SUCCESS_RADIUS:
        if len(collided) == max_steps:
            stuck = sum(collided[-_LAST:]) >= _LAST / 2
            reason = "no way" if policy.blocked else "stuck" if stuck else "out of steps"
            return Walk(goal, np.array(path), shortest, reason)
        _, known = mapper.add(observation)
        observation = sim.step(policy.act(known, goal))
        path.append(sim.pose[:2, 3].copy())
        collided.append(observation.collided)
    return Walk(goal, np.array(path), shortest, "")


def evaluate_navigation(mesh: "trimesh.Trimesh", scene: Scene, count: int, seed: int = 0) -> TaskResult:
    """Walk the same episodes in a reconstruction and in the scene it shows.

    Args:
        mesh: world frame, metres.
        scene: the truth.
        count: episodes.
        seed: of starts, goals and headings.
    """
    camera = Intrinsics.from_fov(_PIXELS, _PIXELS)
    true = Simulator(scene, camera, supersample=1, rgb=False)
    if not len(mesh.faces):
        return _nothing("empty mesh")
    try:
        found = Simulator(mesh_scene(mesh), camera, supersample=1, rgb=False)
    except SceneError as error:
        return _nothing(f"not walkable: {error}")
    episodes = draw_episodes(true, found, count, seed)
    if not episodes:
        return _nothing("no common ground")
    headings = np.random.default_rng([seed, 7]).uniform(-np.pi, np.pi, len(episodes))
    walks = {
        suffix: [walk_to(sim, *ends, heading) for ends, heading in zip(episodes, headings.tolist(), strict=True)]
        for suffix, sim in (("", found), ("_true_mesh", true))
    }
    values: dict[str, float | None] = {}
    for suffix, found_walks in walks.items():
        values[f"success{suffix}"] = 100 * float(np.mean([walk.success for walk in found_walks]))
        values[f"spl{suffix}"] = 100 * float(np.mean([walk.spl for walk in found_walks]))
    reasons = {name: dict(Counter(walk.reason or "success" for walk in group)) for name, group in walks.items()}
    artifact = {
        "walks": walks[""],
        "walks_true_mesh": walks["_true_mesh"],
        "reasons": reasons[""],
        "reasons_true_mesh": reasons["_true_mesh"],
        "ground": found.navigation,
        "ground_true_mesh": true.navigation,
    }
    details = {
        "reasons": {"in the mesh": reasons[""], "in the true scene": reasons["_true_mesh"]},
        "ground_m2": {"in the mesh": found.navigation.area, "in the true scene": true.navigation.area},
    }
    return TaskResult(values, dict.fromkeys(values, len(episodes)), {}, artifact, details)


def _nothing(why: str) -> TaskResult:
    empty: dict[str, float | None] = dict.fromkeys(METRICS)
    return TaskResult(empty, dict.fromkeys(METRICS, 0), dict.fromkeys(METRICS, why))
