"""Space seen by the training views: a voxel grid, carved along rays by the depth that the field renders.

Lengths are in units of the field, which are metres for trajectories.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

VOXEL = 0.05
MAX_VOXELS = 1 << 29  # of a grid, 0.5 GB; 20 times those of an apartment
LEAST_REACH = 8.0  # a grid that is too large ends nearer to the cameras, down to this distance


@dataclass(frozen=True)
class Visibility:
    """Voxel grid of seen space; points outside the grid are unseen."""

    origin: np.ndarray  # (3,) float64, outer corner of voxel [0, 0, 0]
    voxel: float  # side of a voxel
    seen: np.ndarray  # (X, Y, Z) bool

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Return (N,) bool: True for (N, 3) points that were seen."""
        found = np.zeros(len(points), np.bool_)
        _look_up(np.ascontiguousarray(points, np.float64), self.origin, self.voxel, self.seen, found)
        return found


def carve(rays_o: np.ndarray, rays_d: np.ndarray, depth: np.ndarray, voxel: float = VOXEL) -> Visibility:
    """Mark every voxel between a camera and the surface, and the surface itself.

    A few rays through a hole to the sky would make a grid of any size. Of one with over :data:`MAX_VOXELS` voxels, the
    rays end nearer to the cameras, down to :data:`LEAST_REACH`. What lies farther counts as unseen. Where this is not
    enough, because the cameras themselves are far apart, the voxels are larger.

    Args:
        rays_o, rays_d: (N, 3) origins and unit directions.
        depth: (N,) distance along the ray.
        voxel: smallest side of a voxel.

    Example:
        >>> grid = carve(np.zeros((1, 3)), np.array([[1.0, 0, 0]]), np.array([2.0]))
        >>> grid(np.array([[1.0, 0, 0], [2.0, 0, 0], [2.2, 0, 0]])).tolist()
        [True, True, False]
    """
    reach = depth + voxel  # a surface counts as one voxel thick
    longest = float(reach.max(initial=0))
    while True:
        ends = rays_o + reach[:, None] * rays_d
        origin = np.minimum(rays_o.min(axis=0), ends.min(axis=0)) - voxel
        shape = np.ceil((np.maximum(rays_o.max(axis=0), ends.max(axis=0)) - origin) / voxel) + 1
        if not shape.prod(dtype=np.float64) > MAX_VOXELS:
            break
        if longest > LEAST_REACH:
            longest = max(0.9 * longest, LEAST_REACH)
            reach = np.minimum(reach, longest)
        else:
            voxel *= 1.25
    seen = np.zeros(tuple(shape.astype(np.int64)), np.bool_)
    _march((rays_o - origin) / voxel, rays_d, reach / voxel, seen)
    return Visibility(origin.astype(np.float64), voxel, seen)


@njit(cache=True)
def _look_up(points: np.ndarray, origin: np.ndarray, voxel: float, seen: np.ndarray, found: np.ndarray) -> None:
    """Write True for points in seen voxels; ``found`` holds False for the others."""
    for n in range(points.shape[0]):
        x, y, z = (
            (points[n, 0] - origin[0]) / voxel,
            (points[n, 1] - origin[1]) / voxel,
            (points[n, 2] - origin[2]) / voxel,
        )
        if 0 <= x < seen.shape[0] and 0 <= y < seen.shape[1] and 0 <= z < seen.shape[2]:
            found[n] = seen[int(x), int(y), int(z)]


@njit(cache=True)
def _march(start: np.ndarray, direction: np.ndarray, length: np.ndarray, seen: np.ndarray) -> None:
    """Mark the voxels along rays in steps of half a voxel, which may miss a corner that a ray grazes."""
    for n in range(start.shape[0]):
        t = 0.0
        while t <= length[n]:
            i = int(start[n, 0] + t * direction[n, 0])
            j = int(start[n, 1] + t * direction[n, 1])
            k = int(start[n, 2] + t * direction[n, 2])
            if 0 <= i < seen.shape[0] and 0 <= j < seen.shape[1] and 0 <= k < seen.shape[2]:  # rounded far away
                seen[i, j, k] = True
            t += 0.5
