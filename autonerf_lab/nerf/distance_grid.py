"""Distance grid: the depth of the training images, fused into truncated signed distances."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from autonerf_lab.errors import DataError
from autonerf_lab.nerf.kernels import distance_grid
from autonerf_lab.nerf.pixel_sampler import PixelSampler
from autonerf_lab.nerf.ray_batch import Rays

CHUNK = 1 << 18  # rays fused at once
CARVE_EVERY = 8  # one in so many fused rays marks the free space in front of its surface
NOISE_RAYS = 50_000  # whose depth is compared with the fused surface
NOISY = 0.2  # voxels. The surface is about 0.05 voxels from exact depth, and 0.4 from that of the noise `redwood`
MAX_CELLS = 1 << 28  # of a grid, 2.7 GB during the fusion; 30 times those of a home of 300 m² at 3 cm


@dataclass(frozen=True)
class DistanceGrid:
    """Signed distances to measured surfaces; see :mod:`autonerf_lab.nerf.kernels.distance_grid`."""

    distances: np.ndarray  # (X, Y, Z) int16, millimetres
    origin: np.ndarray  # (3,) float32 outer corner of the first voxel, coordinates of the field
    voxel: float  # metres
    truncation: float  # largest distance to a surface that is averaged, metres
    noise: float = 0.0  # median distance of the measured depth from the fused surface, along the ray, metres

    def filter_depth(self, rays: Rays, depth: np.ndarray) -> np.ndarray:
        """Return the depth to train with: if it is noisy, that of the fused surface, the average of many images.

        Where the surface is not near, as at edges that a camera sees beside their place, the depth is none. The surface
        is not used for exact depth, because it is coarser.

        Args:
            rays: R rays.
            depth: (R,) float32 measured distances along the rays, metres; 0 for none.
        """
        return depth if self.noise < NOISY * self.voxel else self.surface_depth(rays, depth)

    def surface_depth(self, rays: Rays, depth: np.ndarray) -> np.ndarray:
        """Return where rays meet the fused surface near their measured depth; see the kernel of this name."""
        found = np.empty_like(depth)
        distance_grid.surface_depth(
            rays.origins, rays.directions, depth, self.origin, np.float32(self.voxel), self.distances,
            np.float32(1.5 * self.truncation), found,
        )  # fmt: skip
        return found

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
        return DistanceGrid(np.zeros((0, 0, 0), np.int16), np.zeros(3, np.float32), voxel, truncation)
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
    grid = DistanceGrid(distances, low, voxel, truncation)
    return replace(grid, noise=_noise(grid, pixels))


def _noise(grid: DistanceGrid, pixels: PixelSampler) -> float:
    """Return the median distance of the measured depth of training images from the fused surface, metres."""
    moved = [np.zeros(0, np.float32)]
    for origins, directions, depth in _measured(pixels, pixels.spread(NOISE_RAYS)):
        found = grid.surface_depth(Rays(origins, directions), depth)
        moved.append(np.abs(found - depth)[found > 0])
    every = np.concatenate(moved)
    return float(np.median(every)) if len(every) else 0.0


def _measured(pixels: PixelSampler, chosen: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield the origins, directions and depths of those of the chosen pixels that have a depth, in chunks."""
    for first in range(0, len(chosen), CHUNK):
        part = chosen[first : first + CHUNK]
        rays, depth = pixels.measured(part)
        known = depth > 0
        if known.any():
            yield rays.origins[known], rays.directions[known], depth[known]
