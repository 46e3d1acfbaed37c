"""Task 5, judgement: how far is a reconstructed mesh from the true one?

The paper shows meshes and does not measure them. These are the scores of neural mapping since iMAP (Sucar et al. 2021)
and, for normals, of occupancy networks (Mescheder et al. 2019). R are 100,000 seeded samples on the reconstruction, T
as many on the truth, d(p, M) the distance of a sample to a mesh (exact for the triangles that 8 points nearest to it
lie on, of samples and middles of triangles), n(p) its normal and n(p, M) that of M where it is nearest:

* ``accuracy_m`` = mean over r in R of d(r, truth);
* ``completion_m`` = mean over t in T of d(t, reconstruction), ``completion_ratio`` = share of T with d < 5 cm;
* ``normal_consistency`` = (mean_R |n(r) . n(r, truth)| + mean_T |n(t) . n(t, reconstruction)|) / 2.

The truth is restricted to what the training views saw (``field.seen``); with the suffix ``_all`` it is the whole scene,
cupboard tops included. A reconstruction holds seen parts only, so accuracy has no such variant.
"""

from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from autonerf_lab.evaluators.radiance_field import Field
from autonerf_lab.evaluators.task_result import TaskResult

if TYPE_CHECKING:
    import trimesh

    from autonerf_lab.scenes.scene import Scene

SAMPLES = 100_000
COMPLETE = 0.05  # metres
_NEIGHBOURS = 8
METRICS = (
    "accuracy_m",
    "completion_m",
    "completion_ratio",
    "normal_consistency",
    "completion_m_all",
    "completion_ratio_all",
    "normal_consistency_all",
)


def sample_surface(triangles: np.ndarray, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """(count, 3) points uniform over (F, 3, 3) triangles, and (count,) which triangle each lies on."""
    area = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1)
    total = np.cumsum(area)
    face = np.minimum(np.searchsorted(total, rng.random(count) * total[-1], side="right"), len(total) - 1)
    u, v = np.sqrt(rng.random(count)), rng.random(count)
    weights = np.stack([1 - u, u * (1 - v), u * v], axis=1)
    return np.einsum("nk,nkd->nd", weights, triangles[face]), face


def normals(triangles: np.ndarray) -> np.ndarray:
    """(F, 3) unit normals of (F, 3, 3) triangles; zero for a degenerate one."""
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-20)


def nearest_on(
    points: np.ndarray, triangles: np.ndarray, samples: np.ndarray, face: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(N,) distance of points to a surface, and (N,) its triangle there; ``samples`` on ``face`` cover the surface."""
    from trimesh.triangles import closest_point

    _, index = cKDTree(samples).query(points, k=min(_NEIGHBOURS, len(samples)))
    candidates = face[index.reshape(len(points), -1)]
    best, which = np.full(len(points), np.inf), candidates[:, 0].copy()
    for k in range(candidates.shape[1]):
        fresh = np.flatnonzero((candidates[:, k] != candidates[:, k - 1]) if k else np.ones(len(points), dtype=bool))
        there = closest_point(triangles[candidates[fresh, k]], points[fresh])
        distance = np.linalg.norm(there - points[fresh], axis=1)
        closer = distance < best[fresh]
        best[fresh[closer]], which[fresh[closer]] = distance[closer], candidates[fresh[closer], k]
    return best, which


def _cover(triangles: np.ndarray, points: np.ndarray, face: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Samples and the middles of all triangles: marching cubes make more triangles than there are samples, and the
    nearest one that a sample happens to lie on is centimetres beside the nearest one.
    """
    return np.concatenate([points, triangles.mean(axis=1)]), np.concatenate([face, np.arange(len(triangles))])


def evaluate_mesh(
    mesh: "trimesh.Trimesh", field: Field, scene: "Scene", seed: int = 0, samples: int = SAMPLES
) -> TaskResult:
    """Compare a reconstruction with the scene it shows.

    Args:
        mesh: world frame, metres.
        field: tells which parts of the truth were seen.
        scene: the truth.
        seed: of the samples.
        samples: on each mesh.
    """
    if not len(mesh.faces):
        empty: dict[str, float | None] = dict.fromkeys(METRICS)
        return TaskResult(empty, dict.fromkeys(METRICS, 0), dict.fromkeys(METRICS, "empty mesh"), {"mesh": mesh})
    rng = np.random.default_rng([seed, 5])
    true, found = scene.vertices[scene.faces].astype(np.float64), np.asarray(mesh.triangles, dtype=np.float64)
    true_points, true_face = sample_surface(true, samples, rng)
    found_points, found_face = sample_surface(found, samples, rng)
    accuracy, true_match = nearest_on(found_points, true, *_cover(true, true_points, true_face))
    completion, found_match = nearest_on(true_points, found, *_cover(found, found_points, found_face))
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
    n = {name: int(seen.sum()) for name in METRICS} | {name: samples for name in METRICS if name.endswith("_all")}
    status = {name: "nothing seen" for name, value in values.items() if value is None}
    artifact = {"mesh": mesh, "points": found_points, "distance": accuracy, "limit": 2 * COMPLETE}
    return TaskResult(values, n | {"accuracy_m": samples}, status, artifact)
