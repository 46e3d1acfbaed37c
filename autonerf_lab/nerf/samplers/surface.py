"""Sampling around measured surfaces, for fields trained on RGB-D images (compare Co-SLAM, Wang et al. 2023)."""

import numpy as np

from autonerf_lab.nerf.distance_grid import DistanceGrid, fuse_depth
from autonerf_lab.nerf.kernels.distance_grid import surface_bins
from autonerf_lab.nerf.pixel_sampler import PixelSampler
from autonerf_lab.nerf.ray_batch import Arrays, Rays, Samples, Targets
from autonerf_lab.nerf.settings import SurfaceSettings


class SurfaceSampler:
    """Most bins around the surface of each ray, the others spread over the space in front of it.

    Training rays know their measured depth. Other rays, of new views or without a measurement, search their surface in
    a distance grid, into which the depth of the training images is fused before the training. Where nothing was
    measured, bins are spread evenly.

    Args:
        settings: number of bins and sizes of the grid.
    """

    def __init__(self, settings: SurfaceSettings) -> None:
        self.settings = settings
        self.parameters: Arrays = {}
        self.state: dict[str, np.ndarray] = {}
        self._grid: DistanceGrid | None = None
        self.observed: dict[str, np.ndarray] = {
            # (X, Y, Z) millimetres, see :mod:`autonerf_lab.nerf.kernels.distance_grid`
            "distances": np.zeros((0, 0, 0), np.int16),
            "distances_origin": np.zeros(3, np.float32),  # outer corner of the first voxel, coordinates of the field
        }

    def observe(self, pixels: PixelSampler) -> None:
        """Fuse the depth of training images; see :class:`~autonerf_lab.nerf.model.DepthGuidedSampler`."""
        s = self.settings
        self._grid = grid = fuse_depth(pixels, s.voxel, s.truncation, s.fused_rays)
        self.observed["distances"], self.observed["distances_origin"] = grid.distances, grid.origin

    def filter_depth(self, rays: Rays, depth: np.ndarray) -> np.ndarray:
        """Return the depth to train with; see :class:`~autonerf_lab.nerf.model.DepthGuidedSampler`."""
        return depth if self._grid is None else self._grid.filter_depth(rays, depth)

    def is_empty(self, points: np.ndarray) -> np.ndarray:
        """Return (N,) bool at (N, 3) points; see :class:`~autonerf_lab.nerf.model.DepthGuidedSampler`."""
        s = self.settings
        # Not ``self._grid``: a loaded field has observed nothing itself.
        grid = DistanceGrid(self.observed["distances"], self.observed["distances_origin"], s.voxel, s.truncation)
        # Nearly all rays must agree: a smaller mean distance also occurs at thin objects that most rays pass.
        return grid(points) > 0.9 * s.truncation

    def sample(self, rays: Rays, jitter: np.ndarray) -> Samples:
        """Place bins on rays; see :class:`~autonerf_lab.nerf.model.Sampler`."""
        s, count = self.settings, len(rays)
        training = rays.depth is not None
        depth = rays.depth if training else np.zeros(count, np.float32)
        edges = np.empty((count, (s.samples if training else s.evaluation_samples) + 1), np.float32)
        surface_bins(
            rays.origins, rays.directions, depth, self.observed["distances_origin"], np.float32(s.voxel),
            self.observed["distances"], np.float32(s.near), np.float32(s.far), np.float32(s.band), np.float32(s.before),
            np.float32(s.behind), jitter, edges,
        )  # fmt: skip
        return Samples.between(edges)

    def learn(
        self,
        rays: Rays,
        samples: Samples,
        targets: Targets,
        weights: np.ndarray,
        rng: np.random.Generator,
    ) -> tuple[Arrays, dict[str, float]]:
        """Return nothing: there is nothing to train; see :class:`~autonerf_lab.nerf.model.Sampler`."""
        return {}, {}
