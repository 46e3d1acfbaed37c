"""Oracle: the true geometry with the interface of a radiance field, as an upper bound in every task."""

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from autonerf_lab.classes import NUM_CLASSES
from autonerf_lab.evaluators.ground_truth import BAND, MapGrid
from autonerf_lab.evaluators.maps import LEVELS
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.nerf.field_frame import FieldFrame
from autonerf_lab.scenes.height_band import occupied_cells
from autonerf_lab.types import Rendering

if TYPE_CHECKING:
    import trimesh

    from autonerf_lab.scenes.scene import Scene
    from autonerf_lab.simulator import Simulator

SOLID = 1000.0  # per metre, the density where there is a surface
_LEVEL = (BAND[1] - BAND[0]) / LEVELS  # height of a voxel, metres
_VIEWS = 600
_REACH = 0.05  # metres between a point and the origin of the ray that determines its colour


@njit(cache=True)
def _texture_colors(
    points: np.ndarray, face: np.ndarray, triangles: np.ndarray, uv: np.ndarray, texture: np.ndarray, out: np.ndarray
) -> None:
    rows, cols = texture.shape[0], texture.shape[1]
    for i in range(points.shape[0]):
        f = face[i]
        if f < 0:
            continue
        a, b, c = triangles[f, 0], triangles[f, 1], triangles[f, 2]
        d00 = d01 = d11 = d20 = d21 = 0.0
        for k in range(3):
            e0, e1, e2 = b[k] - a[k], c[k] - a[k], points[i, k] - a[k]
            d00 += e0 * e0
            d01 += e0 * e1
            d11 += e1 * e1
            d20 += e2 * e0
            d21 += e2 * e1
        det = d00 * d11 - d01 * d01
        if det <= 0:
            continue
        v = (d11 * d20 - d01 * d21) / det
        w = (d00 * d21 - d01 * d20) / det
        x = ((1 - v - w) * uv[f, 0, 0] + v * uv[f, 1, 0] + w * uv[f, 2, 0]) * cols - 0.5
        y = ((1 - v - w) * uv[f, 0, 1] + v * uv[f, 1, 1] + w * uv[f, 2, 1]) * rows - 0.5
        x, y = min(max(x, 0.0), cols - 1.0), min(max(y, 0.0), rows - 1.0)
        x0, y0 = int(x), int(y)
        x1, y1 = min(x0 + 1, cols - 1), min(y0 + 1, rows - 1)
        fx, fy = x - x0, y - y0
        for k in range(3):
            top = texture[y0, x0, k] * (1 - fx) + texture[y0, x1, k] * fx
            bottom = texture[y1, x0, k] * (1 - fx) + texture[y1, x1, k] * fx
            out[i, k] = (top * (1 - fy) + bottom * fy) / 255


class TrueField:
    """Radiance field that represents a scene without error.

    * ``render`` returns the image of the simulator.
    * ``density`` is 1000 per metre in each voxel of 1 x 1 x 3 cm that a surface crosses, else 0. The voxels are those
      of the maps.
    * ``seen`` is True everywhere.
    * ``mesh`` is the true mesh. Marching cubes cannot extract it from the density, which is not solid inside objects.
    * ``ray_gradients`` differentiates the textured surface numerically, over half a pixel.
    * ``poses`` are ``views`` random camera poses, uniform over the scene.

    Args:
        scene: the ground truth.
        sim: a simulator of this scene; by default one with the training camera is created.
        views: number of poses.
        seed: random seed of the poses.

    Example:
        >>> from autonerf_lab.scenes import load_scene
        >>> field = TrueField(load_scene("val-0"), views=2)
        >>> field.density(np.array([[1e3, 1e3, 0.5]]))
        array([0.], dtype=float32)
    """

    def __init__(self, scene: "Scene", sim: "Simulator | None" = None, views: int = _VIEWS, seed: int = 0) -> None:
        from autonerf_lab.simulator import Simulator

        self.scene = scene
        self.sim = sim or Simulator(scene)
        self.intrinsics = self.sim.intrinsics
        self.meta = {"scene": scene.name, "model": "true geometry"}
        self.frame, self.classes = FieldFrame(), NUM_CLASSES
        rng = np.random.default_rng([seed, 600])
        self.poses = np.stack([self.sim.sample_pose(rng) for _ in range(views)])
        self._grid = MapGrid.over(scene.bounds)
        self._resized_sim: Simulator | None = None  # simulator with other intrinsics
        self._levels: dict[int, np.ndarray] = {}
        self._triangles = scene.vertices[scene.faces].astype(np.float64)

    def render(self, c2w: np.ndarray, intrinsics: Intrinsics) -> Rendering:
        """Return the image of the simulator."""
        from autonerf_lab.simulator import Simulator

        sim = self.sim
        if intrinsics != sim.intrinsics:
            if self._resized_sim is None or self._resized_sim.intrinsics != intrinsics:
                self._resized_sim = Simulator(self.scene, intrinsics, supersample=1)
            sim = self._resized_sim
        frame = sim.render(c2w)
        return Rendering(
            frame.rgb.astype(np.float32) / 255, frame.depth, frame.semantics, (frame.depth > 0).astype(np.float32)
        )

    def _level(self, index: int) -> np.ndarray:
        if index not in self._levels:
            low = BAND[0] + index * _LEVEL
            # Surfaces on the limits of the height band belong to it, so that the map of these voxels is the true map.
            low, high = (BAND[0] if index == 0 else low), (BAND[1] if index == LEVELS - 1 else low + _LEVEL)
            vertices, faces = self.scene.vertices, self.scene.faces
            self._levels[index] = occupied_cells(
                vertices, faces, low, high, self._grid.origin, self._grid.cell, self._grid.shape
            )
        return self._levels[index]

    def density(self, points: np.ndarray) -> np.ndarray:
        """Return the (N,) float32 density at (N, 3) points, per metre."""
        sigma = np.zeros(len(points), dtype=np.float32)
        cells, inside = self._grid.cells(points)
        index = np.floor((points[inside, 2] - BAND[0]) / _LEVEL).astype(np.int64)
        values = np.zeros(len(cells), dtype=np.float32)
        for level in np.unique(index):
            here = index == level
            values[here] = SOLID * self._level(int(level))[cells[here, 0], cells[here, 1]]
        sigma[inside] = values
        return sigma

    def _cast(self, points: np.ndarray, directions: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Cast a ray towards each point (default: downwards); return the faces that are hit, and the hit points."""
        directions = np.array([[0.0, 0.0, -1.0]]) if directions is None else directions
        directions = np.broadcast_to(directions, points.shape)
        origins = points - _REACH * directions
        hits = self.sim.cast(origins, directions)
        return hits.face, origins + np.where(np.isfinite(hits.t), hits.t, 0)[:, None] * directions

    def color(self, points: np.ndarray, directions: np.ndarray | None = None) -> np.ndarray:
        """Return the (N, 3) float32 colour of the surface that a ray hits, cast from 5 cm before each point.

        Args:
            points: (N, 3).
            directions: (N, 3) unit vectors; default: downwards.
        """
        face, surface = self._cast(points, directions)
        return self._colors(surface, face)

    def semantics(self, points: np.ndarray) -> np.ndarray:
        """Return (N, 16) float32 one-hot classes of the surface that a downward ray hits, from 5 cm above."""
        face, _ = self._cast(points, None)
        return np.eye(NUM_CLASSES, dtype=np.float32)[np.where(face < 0, 0, self.scene.face_class[face])]

    def seen(self, points: np.ndarray) -> np.ndarray:
        """Return (N,) True: every point counts as seen."""
        return np.ones(len(points), dtype=bool)

    def mesh(self) -> "trimesh.Trimesh":
        """Return the true mesh, without colours."""
        import trimesh

        return trimesh.Trimesh(self.scene.vertices, self.scene.faces, process=False)

    def _colors(self, points: np.ndarray, face: np.ndarray) -> np.ndarray:
        out = np.zeros((len(points), 3), dtype=np.float32)
        _texture_colors(points.astype(np.float64), face, self._triangles, self.scene.uv, self.scene.texture, out)
        return out

    def ray_gradients(
        self, rays_o: np.ndarray, rays_d: np.ndarray, target: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the squared error of the mean of 2 x 2 samples per pixel, and its gradients by finite differences.

        Shapes are those of :class:`~autonerf_lab.evaluators.RadianceField`. A change of the direction moves the end
        point of a ray of length ``t`` by ``t`` times that change. The same change of the origin moves it only once as
        far, and moving the origin along the ray has no effect. Therefore ``dL/do = dL/dd / t``.
        """
        quarter = 0.25 / self.sim.intrinsics.fl_x
        helper = np.where(np.abs(rays_d[:, 2:]) < 0.9 * np.linalg.norm(rays_d, axis=1, keepdims=True), 1.0, 0.0)
        up = np.concatenate([1 - helper, np.zeros_like(helper), helper], axis=1)
        e1 = np.cross(rays_d, up)
        e1 /= np.linalg.norm(e1, axis=1, keepdims=True)
        e2 = np.cross(e1, rays_d)
        e2 /= np.linalg.norm(e2, axis=1, keepdims=True)
        signs = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])
        probes = rays_d + quarter * (signs[:, :1, None] * e1 + signs[:, 1:, None] * e2)  # (4, N, 3)
        origins = np.broadcast_to(rays_o, probes.shape).reshape(-1, 3)
        hits = self.sim.cast(origins, probes.reshape(-1, 3))
        t = np.where(np.isfinite(hits.t), hits.t, 0)
        colors = self._colors(origins + t[:, None] * probes.reshape(-1, 3), hits.face).reshape(probes.shape)
        slope1, slope2 = (np.einsum("s,snk->nk", signs[:, a], colors) / (4 * quarter) for a in (0, 1))
        error = colors.mean(axis=0) - target
        along1, along2 = ((2 / 3) * (error * slope).sum(axis=1, keepdims=True) for slope in (slope1, slope2))
        grad_d = along1 * e1 + along2 * e2
        distance = t.reshape(4, -1).mean(axis=0)[:, None]
        grad_o = np.divide(grad_d, distance, out=np.zeros_like(grad_d), where=distance > 0)
        return (error**2).mean(axis=1), grad_o, grad_d
