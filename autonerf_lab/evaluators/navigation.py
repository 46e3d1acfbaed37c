"""Task 6, navigation in the mesh: a simulated robot navigates in the reconstruction.

The task follows "Navigating inside a NeRF-generated mesh" of the paper's appendix. The mesh of the field gets a flat
floor (:func:`add_floor`) and is imported through a file, like a scan. The same PointGoal episodes run in the mesh and
in the true scene. Starts and goals are seeded, in cells in which the robot fits in both, at least 2 m apart on the
shortest path of the true scene. The robot begins with an empty map, maps the depth of its camera (64 x 64 pixels), and
follows the fast-marching path of the local policy by forward steps and rotations. An episode succeeds when the robot is
within 0.36 m of the goal. It fails after 500 steps, for one of these reasons:

* ``no path``: no path on the robot's map leads to the goal;
* ``stuck``: at least half of the last 50 steps were collisions;
* ``out of steps``: all others.

``SPL = mean of S l / max(p, l)`` with success S, path length p and the length l of the shortest path to the goal in the
same mesh. Episodes only use cells in which the robot fits in the reconstruction. A mesh with a small navigable area has
easy episodes, so the navigable areas are reported too (``ground_m2`` in the details).
"""

import tempfile
import warnings
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from autonerf_lab.errors import DataError, SceneError
from autonerf_lab.evaluators.mesh import export_mesh
from autonerf_lab.evaluators.metrics import metrics_of
from autonerf_lab.evaluators.radiance_field import RadianceField
from autonerf_lab.evaluators.task import Task, TaskFigure, TaskResult
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

    from autonerf_lab.evaluators.context import EvaluationContext

SUCCESS_RADIUS = 0.36  # metres, twice the robot's radius
MAX_STEPS = 500
MIN_GEODESIC = 2.0  # metres
_NAMES = tuple(metric.name for metric in metrics_of("navigation"))
_PIXELS = 64
_LAST = 50  # steps that decide the reason of a failure
_TRIES = 100  # sampled goals per episode
_MARGIN = 6.0  # metres of map around the scene: slightly more than the sensor range


@dataclass(frozen=True)
class NavigationEpisode:
    """One episode and its outcome."""

    goal: np.ndarray  # (2,) world x, y
    path: np.ndarray  # (K, 2) world x, y, from the start
    shortest: float  # shortest path length, metres
    reason: str  # of the failure, "" for a success

    @property
    def success(self) -> bool:
        """True if the robot reached the goal."""
        return not self.reason

    @property
    def spl(self) -> float:
        """Success weighted by path length, 0 to 1."""
        return weighted_success(self.success, path_length(self.path), self.shortest)


def add_floor(mesh: "trimesh.Trimesh", field: RadianceField) -> "trimesh.Trimesh":
    """Add a flat floor to a reconstruction: the plane z = 0, where training views saw it.

    A field that is trained on colours represents a plain floor with bumps, pits and holes. A camera 0.88 m above it
    hardly sees them, but a robot cannot pass. Vertices within 20 cm of the plane, the height that robots in Habitat
    climb, are moved into the plane, and floor tiles are added where training rays reached the plane. Furniture is not
    changed.

    Args:
        mesh: world frame, metres.
        field: its method :meth:`~autonerf_lab.evaluators.radiance_field.RadianceField.seen` selects the floor tiles.

    Returns:
        The geometry without colours; an empty mesh is returned unchanged.
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
    """Import a mesh as a scene, through a file, like a scan.

    Args:
        mesh: world frame, metres.

    Returns:
        The scene, at the position of the mesh, with the floor at z = 0.

    Raises:
        SceneError: the mesh has no floor.
        DataError: the mesh is empty.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mesh.glb"
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)  # a poor reconstruction is an implausible scan
                scene = import_scene(export_mesh(mesh, path), up="y")
        except DataError as error:  # do not name the temporary file
            raise type(error)(str(error).replace(str(path), "the mesh")) from error
    center = mesh.bounds.mean(axis=0) * (1, 1, 0)  # the import moves the centre and the floor to zero
    return replace(scene, vertices=(scene.vertices + center).astype(np.float32))


def sample_navigation_episodes(
    true: Simulator, other: Simulator, count: int, seed: int = 0
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Sample starts and goals at which the robot fits in two scenes.

    Args:
        true: simulator of the true scene, in which distances are measured.
        other: simulator of the reconstruction.
        count: number of episodes.
        seed: random seed.

    Returns:
        Pairs of start and goal, (2,) world x, y; fewer than ``count`` if no goal is found for some starts.
    """
    ground, second = true.navigation, other.navigation
    cells = np.argwhere(ground.navigable)
    positions = cell_to_world(cells, ground.origin, ground.cell)
    there = world_to_cell(positions, second.origin, second.cell)
    inside = np.all((there >= 0) & (there < second.navigable.shape), axis=1)
    both = np.flatnonzero(inside)
    both = both[second.navigable[tuple(there[both].T)]]
    both = np.array([k for k in both if second.is_navigable(*positions[k])], dtype=np.int64)
    rng = np.random.default_rng([seed, 6])
    episodes: list[tuple[np.ndarray, np.ndarray]] = []
    for _ in range(count if len(both) else 0):
        start = rng.choice(both)
        distance = travel_distance(ground.navigable, cells[start][None], ground.cell)
        goals = rng.choice(both, size=_TRIES)
        far = goals[distance[tuple(cells[goals].T)] >= MIN_GEODESIC]
        if len(far):
            episodes.append((positions[start], positions[far[0]]))
    return episodes


def navigate(
    sim: Simulator, start: np.ndarray, goal: np.ndarray, heading: float, max_steps: int = MAX_STEPS
) -> NavigationEpisode:
    """Run one episode with a map that the robot builds itself.

    Args:
        sim: simulator of the scene.
        start: (2,) world x, y.
        goal: (2,) world x, y.
        heading: initial heading, radians.
        max_steps: number of steps after which the episode fails.
    """
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
            reason = "no path" if policy.blocked else "stuck" if stuck else "out of steps"
            return NavigationEpisode(goal, np.array(path), shortest, reason)
        _, known = mapper.add(observation)
        observation = sim.step(policy.act(known, goal))
        path.append(sim.pose[:2, 3].copy())
        collided.append(observation.collided)
    return NavigationEpisode(goal, np.array(path), shortest, "")


def evaluate_navigation(mesh: "trimesh.Trimesh", scene: Scene, count: int, seed: int = 0) -> TaskResult:
    """Run the same episodes in a reconstruction and in its scene.

    Args:
        mesh: world frame, metres.
        scene: the ground truth.
        count: number of episodes.
        seed: random seed of starts, goals and headings.
    """
    camera = Intrinsics.from_fov(_PIXELS, _PIXELS)
    true = Simulator(scene, camera, supersample=1, rgb=False)
    if not len(mesh.faces):
        return _without_values("empty mesh")
    try:
        found = Simulator(mesh_scene(mesh), camera, supersample=1, rgb=False)
    except SceneError as error:
        return _without_values(f"not walkable: {error}")
    episodes = sample_navigation_episodes(true, found, count, seed)
    if not episodes:
        return _without_values("no common ground")
    headings = np.random.default_rng([seed, 7]).uniform(-np.pi, np.pi, len(episodes))
    results = {
        suffix: [navigate(sim, *ends, heading) for ends, heading in zip(episodes, headings.tolist(), strict=True)]
        for suffix, sim in (("", found), ("_true_mesh", true))
    }
    values: dict[str, float | None] = {}
    for suffix, group in results.items():
        values[f"success{suffix}"] = 100 * float(np.mean([episode.success for episode in group]))
        values[f"spl{suffix}"] = 100 * float(np.mean([episode.spl for episode in group]))
    reasons = {name: dict(Counter(e.reason or "success" for e in group)) for name, group in results.items()}
    artifact = {
        "episodes": results[""],
        "episodes_true_mesh": results["_true_mesh"],
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


def _without_values(status: str) -> TaskResult:
    empty: dict[str, float | None] = dict.fromkeys(_NAMES)
    return TaskResult(empty, dict.fromkeys(_NAMES, 0), dict.fromkeys(_NAMES, status))


class NavigationTask(Task):
    """Task 6: navigation in the mesh."""

    name, metrics, title = "navigation", metrics_of("navigation"), "Navigation in the mesh"
    optional = True
    text = (
        "A simulated robot navigates to goal positions in the reconstructed mesh, and in the true scene for "
        "comparison. It builds its own map during each episode."
    )
    figures = (
        TaskFigure(
            "navigation",
            "navigation_paths",
            title="The same episodes in the mesh and in the true scene",
            caption="Successful paths are green. The other colours show why an episode failed. The robot does not fit "
            "in the grey areas.",
            alt="Two floor plans with the paths of the robot: in the reconstructed mesh and in the true scene",
        ),
    )

    def run(self, context: "EvaluationContext") -> TaskResult:
        """Run the episodes in the mesh of the field and in the scene."""
        starts = context.preset.planning_starts
        return evaluate_navigation(context.surface_with_floor, context.scene, starts, context.seed)
