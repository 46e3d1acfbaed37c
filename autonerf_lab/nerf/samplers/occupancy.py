"""Occupancy-grid sampling (Müller et al. 2022, appendix E): a grid stores which cells are empty; rays skip them."""

import numpy as np

from autonerf_lab.errors import DataError
from autonerf_lab.nerf.distance_grid import DistanceGrid, fuse_depth
from autonerf_lab.nerf.kernels import ray_marching, volume_rendering
from autonerf_lab.nerf.model import Field
from autonerf_lab.nerf.pixel_sampler import PixelSampler
from autonerf_lab.nerf.ray_batch import Arrays, Rays, Samples, Targets
from autonerf_lab.nerf.scene_box import SceneBox
from autonerf_lab.nerf.settings import MAX_COUNT, OccupancySettings

FUSED_RAYS = 3_000_000  # largest number of pixels whose depth is fused


class OccupancySampler:
    """Bins of equal length in the occupied space that a ray crosses before it is dark.

    A ray is marched through the occupied cells of a grid, and the field's own density in the marched bins tells where
    the ray is dark. The grid alone cannot tell: it stores the largest density of a cell, which a ray may cross beside
    the surface; so it ends a ray only after ``reach`` metres of occupied space. With 0.3 m the grid fills, and
    trainings end 9 dB lower (documentation, Results).

    The grid covers the contracted cube. Every ``update_every`` steps its densities decay, and the density at a random
    point of each queried cell replaces the stored one where it is larger. A cell is occupied if its density exceeds a
    threshold, or the mean of the grid where that is smaller.

    Args:
        settings: size of the grid, number of bins.
        box: region of full resolution.
        field: its density fills the grid and ends the rays.
    """

    def __init__(self, settings: OccupancySettings, box: SceneBox, field: Field) -> None:
        self.settings, self.box, self.field = settings, box, field
        shape = np.maximum(np.ceil(box.size / settings.cell), 1).astype(np.int64)
        if shape.astype(np.float64).prod() > MAX_COUNT:
            raise DataError(f"settings: cell={settings.cell} is too small: a grid of over {MAX_COUNT} cells")
        self.parameters: Arrays = {}
        self.state: dict[str, np.ndarray] = {
            "occupancy": np.full(shape, settings.occupied, np.float32),  # density per metre
            "occupancy_steps": np.zeros(1, np.int64),
        }
        # False where depth shows that a cell is empty; its stored density stays 0.
        self._unmeasured = np.ones(shape, np.bool_)
        self._grid: DistanceGrid | None = None

    def observe(self, pixels: PixelSampler) -> None:
        """Mark the cells that measured rays have crossed; see :class:`~autonerf_lab.nerf.model.DepthGuidedSampler`."""
        if not self.settings.depth_weight:
            return
        self._grid = grid = fuse_depth(pixels, self.settings.cell / 2, self.settings.cell, FUSED_RAYS)
        shape = self._unmeasured.shape
        centers = (np.stack([*np.indices(shape)], axis=-1).reshape(-1, 3) + 0.5) / shape
        # Inside the box, the corners of a cell are at most 0.87 times its side away. Cells of the shell are longer, and
        # a surface may cross their ends. Unmeasured distances are NaN.
        free = grid(self.box.expand(centers)).reshape(shape) > 0.9 * self.settings.cell
        self._unmeasured = ~free
        self.state["occupancy"][free] = 0

    def filter_depth(self, rays: Rays, depth: np.ndarray) -> np.ndarray:
        """Return the depth to train with; see :class:`~autonerf_lab.nerf.model.DepthGuidedSampler`."""
        return depth if self._grid is None else self._grid.filter_depth(rays, depth)

    def is_empty(self, points: np.ndarray) -> np.ndarray:
        """Return (N,) bool at (N, 3) points; see :class:`~autonerf_lab.nerf.model.DepthGuidedSampler`."""
        density = self.state["occupancy"]
        cells = (self.box.contract(points) * density.shape).astype(np.int64)
        return density[tuple(np.minimum(cells, np.array(density.shape) - 1).T)] == 0

    def sample(self, rays: Rays, jitter: np.ndarray) -> Samples:
        """Place bins on rays; see :class:`~autonerf_lab.nerf.model.Sampler`."""
        s, box, count = self.settings, self.box, len(rays)
        edges = np.empty((count, s.candidates + 1), np.float32)
        volume_rendering.first_edges(np.float32(s.near), np.float32(s.far), np.float32(s.turn), jitter, edges)
        marched = Samples(*np.empty((2, count, s.marched), np.float32))
        density = self.state["occupancy"]
        ray_marching.occupied_bins(
            rays.origins, rays.directions, edges, box.center, box.half, np.float32(box.shell),
            density, min(np.float32(s.occupied), density.mean()), np.float32(s.reach), jitter,
            marched.starts, marched.ends,
        )  # fmt: skip
        samples = Samples(*np.empty((2, count, s.samples), np.float32))
        ray_marching.visible_bins(
            marched.starts, marched.ends, self.field_density(rays, marched), jitter, samples.starts, samples.ends
        )
        return samples

    def field_density(self, rays: Rays, samples: Samples) -> np.ndarray:
        """Return the field's density (R, S) at the midpoints of bins, per metre."""
        points = rays.origins[:, None] + samples.midpoints[..., None] * rays.directions[:, None]
        return self.field.density(points.reshape(-1, 3)).reshape(samples.starts.shape)

    def learn(
        self,
        rays: Rays,
        samples: Samples,
        targets: Targets,
        weights: np.ndarray,
        rng: np.random.Generator,
    ) -> tuple[Arrays, dict[str, float]]:
        """Update the grid when it is due; see :class:`~autonerf_lab.nerf.model.Sampler`."""
        step = int(self.state["occupancy_steps"][0])
        self.state["occupancy_steps"] += 1
        if step % self.settings.update_every == 0:
            density = self.state["occupancy"].reshape(-1)
            cells = np.flatnonzero(self._unmeasured)
            if step >= self.settings.grid_warmup:
                cells = rng.choice(cells, len(cells) // 8, replace=False)
            inside = np.stack(np.unravel_index(cells, self.state["occupancy"].shape), axis=1)
            x = (inside + rng.random(inside.shape)) / self.state["occupancy"].shape
            density *= np.float32(self.settings.decay)
            density[cells] = np.maximum(density[cells], self.field.density(self.box.expand(x)))
        return {}, {}
