"""Labels of a mesh from a second mesh of the same scene, which has another triangulation."""

from typing import Any

import numpy as np

from autonerf_lab.errors import SceneError

_NEAR = 0.05  # metres between the centres of a triangle and the semantic triangle that labels it


def nearest_objects(
    parts: list[dict[str, Any]], labelled: list[dict[str, Any]], ids: list[np.ndarray]
) -> list[np.ndarray]:
    """Return the object id of each face of ``parts`` by the nearest triangle of another mesh, 0 if none is near.

    Args:
        parts: Meshes with ``vertices`` (V, 3) and ``faces`` (F, 3).
        labelled: Meshes of the same scene and frame.
        ids: Object id of each face of ``labelled``, one array per mesh.

    Raises:
        SceneError: A vertex is not finite.
    """
    from scipy.spatial import cKDTree

    def centres(mesh: list[dict[str, Any]]) -> np.ndarray:
        points = np.concatenate([part["vertices"][part["faces"]].mean(axis=1) for part in mesh])
        if not np.isfinite(points).all():
            raise SceneError("a vertex of the mesh or of its semantic mesh is not a finite number")
        return points

    distance, nearest = cKDTree(centres(labelled)).query(centres(parts), distance_upper_bound=_NEAR)
    found = np.append(np.concatenate(ids), 0)[np.where(np.isfinite(distance), nearest, -1)]
    return np.split(found, np.cumsum([len(part["faces"]) for part in parts])[:-1])
