"""Distance grid: the depth of the training images, fused into truncated signed distances."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from autonerf_lab.errors import DataError
from autonerf_lab.nerf.kernels import distance_grid
from autonerf_lab.nerf.pixel_sampler import PixelSampler

CHUNK = 1 << 18  # rays fused at once
CARVE_EVERY = 8  # one in so many fused rays marks the free space in front of its surface
MAX_CELLS = 1 << 28  # of a grid, 2.7 GB during the fusion; 30 times those of a home of 300 m² at 3 cm


@dataclass(frozen=True)
class DistanceGrid:
    """Signed distances to measured surfaces; see :mod:`autonerf_lab.nerf.kernels.distance_grid`."""

    distances: np.ndarray  # (X, Y, Z) int16, millimetres
    origin: np.ndarray  # (3,) float32 outer corner of the first voxel, coordinates of the field
    voxel: float  # metres

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Return the (N,) distances of the voxels that hold (N, 3) points, metres; NaN where nothing was measured."""
        cells = np.floor((points - self.origin) / self.voxel).astype(np.int64)
        inside = ((cells >= 0) & (cells < self.distances.shape)).all(axis=1)
        found = np.full(len(points), np.nan)
        found[inside] = self.distances[tuple(cells[inside].T)] * 1e-3
        return np.where(found >= distance_grid.CERTAIN, np.nan, found)


def fuse_depth(pixels: PixelSampler, voxel: float, truncation: float, max_rays: int) -> DistanceGrid:
    """Fuse the measured depth of training images.

    A few wrong depths far away would make a grid of any size: over :data:`MAX_CELLS`, it ends nearer to the cameras.

    Args:
        pixels: with depth.
        voxel: side of a voxel, metres.
        truncation: largest distance to a surface that is averaged, metres.
        max_rays: of more pixels, so many are fused, evenly spaced.

    Raises:
        DataError: the cameras alone need a larger grid.
    """
    chosen = pixels.spread(max_rays)
    reach, cameras, corners = np.float32(truncation + voxel), [], []
    for origins, directions, depth in _measured(pixels, chosen[::16]):
        ends = origins + (depth[:, None] + reach) * directions
        cameras += [origins.min(axis=0), origins.max(axis=0)]
        corners += [ends.min(axis=0), ends.max(axis=0)]
    if not corners:
        return DistanceGrid(np.zeros((0, 0, 0), np.int16), np.zeros(3, np.float32), voxel)
    low, high = np.min(cameras + corners, axis=0), np.max(cameras + corners, axis=0)
    around = np.float32((high - low).max())
    while ((high.astype(np.float64) - low) / voxel + 2).prod() > MAX_CELLS:
        if around < reach:
            raise DataError(f"the cameras with a depth are too far apart for voxels of {voxel:g} m; choose larger ones")
        around *= np.float32(0.8)
        low = np.maximum(low, np.min(cameras, axis=0) - around)
        high = np.minimum(high, np.max(cameras, axis=0) + around)
    shape = tuple(np.ceil((high - low) / voxel).astype(np.int64) + 1)
    total, weight = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    for origins, directions, depth in _measured(pixels, chosen):
        distance_grid.fuse(
            origins, directions, depth, low, np.float32(voxel), np.float32(truncation), CARVE_EVERY, total, weight
        )
    distances = np.empty(shape, np.int16)
    distance_grid.finish(total, weight, np.float32(voxel), np.float32(truncation), distances)
    return DistanceGrid(distances, low, voxel)


def _measured(pixels: PixelSampler, chosen: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield the origins, directions and depths of those of the chosen pixels that have a depth, in chunks."""
    for first in range(0, len(chosen), CHUNK):
        part = chosen[first : first + CHUNK]
        rays, depth = pixels.rays(part), pixels.targets(part).depth
        known = depth > 0
        if known.any():
            yield rays.origins[known], rays.directions[known], depth[known]
