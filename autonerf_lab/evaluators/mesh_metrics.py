"""Task 5, mesh metrics: distances between a reconstructed mesh and the true mesh.

The paper shows meshes without measuring them. The metrics are those of neural mapping since iMAP (Sucar et al. 2021)
and, for normals, of occupancy networks (Mescheder et al. 2019). R are 100,000 seeded samples on the reconstruction and
T as many on the true mesh. d(p, M) is the exact distance of a sample p to the triangles of a mesh M. n(p) is the normal
at p, and n(p, M) the normal of M at its nearest point:

* ``accuracy_m`` = mean over r in R of d(r, truth);
* ``completion_m`` = mean over t in T of d(t, reconstruction), ``completion_ratio`` = share of T with d < 5 cm;
* ``normal_consistency`` = ``(mean_R |n(r) . n(r, truth)| + mean_T |n(t) . n(t, reconstruction)|) / 2``.

T is restricted to the parts that training views have seen (``field.seen``); with the suffix ``_all`` it covers the
whole floor of the robot, for example the tops of cupboards, but no second floor. The reconstruction
contains seen parts only, so accuracy has no such variant.
"""

from typing import TYPE_CHECKING

import numpy as np

from autonerf_lab.evaluators.ground_truth import faces_of_the_floor
from autonerf_lab.evaluators.metrics import metrics_of
from autonerf_lab.evaluators.radiance_field import RadianceField
from autonerf_lab.evaluators.task import Task, TaskFigure, TaskResult

if TYPE_CHECKING:
    import trimesh

    from autonerf_lab.evaluators.context import EvaluationContext
    from autonerf_lab.scenes.scene import Scene

SAMPLES = 100_000
COMPLETE = 0.05  # metres, threshold of the completion ratio
_NAMES = tuple(metric.name for metric in metrics_of("mesh"))


def sample_surface(triangles: np.ndarray, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Sample (count, 3) points uniformly on (F, 3, 3) triangles; also return the (count,) index of their triangles."""
    area = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1)
    total = np.cumsum(area)
    face = np.minimum(np.searchsorted(total, rng.random(count) * total[-1], side="right"), len(total) - 1)
    u, v = np.sqrt(rng.random(count)), rng.random(count)
    weights = np.stack([1 - u, u * (1 - v), u * v], axis=1)
    return np.einsum("nk,nkd->nd", weights, triangles[face]), face


def normals(triangles: np.ndarray) -> np.ndarray:
    """Compute the (F, 3) unit normals of (F, 3, 3) triangles; zero for a degenerate triangle."""
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-20)


def nearest_on(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute the distances of points to a surface.

    Args:
        points: (N, 3).
        triangles: (F, 3, 3), the surface.

    Returns:
        (N,) distances and (N,) indices of the nearest triangles.
    """
    import igl

    faces = np.arange(3 * len(triangles)).reshape(-1, 3)
    squared, index, _ = igl.point_mesh_squared_distance(points, triangles.reshape(-1, 3), faces)
    return np.sqrt(squared), index


def evaluate_mesh(
    mesh: "trimesh.Trimesh", field: RadianceField, scene: "Scene", seed: int = 0, samples: int = SAMPLES
) -> TaskResult:
    """Compare a reconstruction with its scene.

    Args:
        mesh: world frame, metres.
        field: its method ``seen`` restricts the ground truth.
        scene: the ground truth.
        seed: random seed of the samples.
        samples: number of samples on each mesh.
    """
    if not len(mesh.faces):
        empty: dict[str, float | None] = dict.fromkeys(_NAMES)
        return TaskResult(empty, dict.fromkeys(_NAMES, 0), dict.fromkeys(_NAMES, "empty mesh"), {"mesh": mesh})
    rng = np.random.default_rng([seed, 5])
    true = scene.vertices[scene.faces[faces_of_the_floor(scene)]].astype(np.float64)
    found = np.asarray(mesh.triangles, dtype=np.float64)
    true_points, true_face = sample_surface(true, samples, rng)
    found_points, found_face = sample_surface(found, samples, rng)
    accuracy, true_match = nearest_on(found_points, true)
    completion, found_match = nearest_on(true_points, found)
    true_normals, found_normals = normals(true), normals(found)
    forward = np.abs(np.einsum("nd,nd->n", found_normals[found_face], true_normals[true_match]))
    backward = np.abs(np.einsum("nd,nd->n", true_normals[true_face], found_normals[found_match]))
    seen = np.asarray(field.seen(true_points.astype(np.float32)), dtype=bool)
    values: dict[str, float | None] = {"accuracy_m": float(accuracy.mean())}
    for suffix, part in (("", seen), ("_all", np.ones(samples, dtype=bool))):
        some = bool(part.any())
        values["completion_m" + suffix] = float(completion[part].mean()) if some else None
        values["completion_ratio" + suffix] = float(100 * np.mean(completion[part] < COMPLETE)) if some else None
        values["normal_consistency" + suffix] = float((forward.mean() + backward[part].mean()) / 2) if some else None
    n = {name: int(seen.sum()) for name in _NAMES} | {name: samples for name in _NAMES if name.endswith("_all")}
    status = {name: "nothing seen" for name, value in values.items() if value is None}
    artifact = {"mesh": mesh, "points": found_points, "distance": accuracy, "limit": 2 * COMPLETE}
    return TaskResult(values, n | {"accuracy_m": samples}, status, artifact)


class MeshTask(Task):
    """Task 5: mesh extraction and comparison with the true mesh."""

    name, metrics, title = "mesh", metrics_of("mesh"), "Mesh"
    text = (
        "The surface of the field is extracted as a triangle mesh with colours and classes, and compared with the true "
        "mesh. Accuracy is the mean distance from the reconstruction to the true mesh, completion the mean distance in "
        "the other direction."
    )
    figures = (
        TaskFigure(
            "views",
            "mesh_view",
            title="Reconstructed mesh",
            caption="View from above without ceiling and near walls: colours, classes, and distance to the true "
            "surface.",
            alt="Views into the reconstructed apartment from above: in colour, by class, and by distance to the true "
            "surface in centimetres",
        ),
    )

    def run(self, context: "EvaluationContext") -> TaskResult:
        """Compare the mesh of the field with the scene."""
        return evaluate_mesh(context.surface, context.field, context.scene, context.seed)
