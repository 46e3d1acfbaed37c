"""Ray casting against a triangle mesh (embree)."""

from dataclasses import dataclass

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

_BLOCK = 1 << 18  # rays per call: bounds the memory of embreex's outputs
_FAR = 1e30  # larger distances mean no hit


@dataclass(frozen=True)
class Hits:
    """First intersections of N rays with a mesh."""

    t: np.ndarray  # (N,) float32, the hit is at rays_o + t * rays_d; inf = no hit
    face: np.ndarray  # (N,) int32, index of the face, -1 = no hit


class RayCaster:
    """Ray caster for a triangle mesh.

    Args:
        triangles: (F, 3, 3) corners, world frame, metres.

    Example:
        >>> caster = RayCaster(np.array([[[0, 0, 1], [1, 0, 1], [0, 1, 1]]], np.float32))
        >>> hits = caster.cast(np.array([[0.2, 0.2, 0], [5, 5, 0]]), np.array([[0, 0, 0.5], [0, 0, 1]]))
        >>> hits.t.round(3), hits.face
        (array([ 2., inf], dtype=float32), array([ 0, -1], dtype=int32))
    """

    def __init__(self, triangles: np.ndarray) -> None:
        self._scene = EmbreeScene()
        self._mesh = TriangleMesh(self._scene, np.ascontiguousarray(triangles, dtype=np.float32))

    def cast(self, rays_o: np.ndarray, rays_d: np.ndarray) -> Hits:
        """Return the first hits of rays.

        Args:
            rays_o: (N, 3) origins, world frame, metres.
            rays_d: (N, 3) directions of any length.
        """
        rays_o = np.ascontiguousarray(rays_o, dtype=np.float32).reshape(-1, 3)
        rays_d = np.ascontiguousarray(rays_d, dtype=np.float32).reshape(-1, 3)
        t = np.empty(len(rays_o), np.float32)
        face = np.empty(len(rays_o), np.int32)
        for start in range(0, len(rays_o), _BLOCK):
            block = slice(start, start + _BLOCK)
            out = self._scene.run(rays_o[block], rays_d[block], output=True)
            t[block], face[block] = out["tfar"], out["primID"]
        t[(face < 0) | (t > _FAR)] = np.inf
        return Hits(t, face)
