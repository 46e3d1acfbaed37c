"""Coordinates of the field: centred on the scene and of the size of a room, for poses in any units."""

from dataclasses import dataclass, field

import numpy as np

from autonerf_lab.data.dataset import Dataset

SPREAD = 2.0  # median distance of photographs from the point they look at, in units of the field
OUTLIER = 10.0  # poses farther out than this multiple of the typical distance are ignored


@dataclass(frozen=True)
class FieldFrame:
    """Translation and scale between the world frame of the poses and the coordinates of the field; no rotation.

    Example:
        >>> frame = FieldFrame(np.array([100.0, 0.0, 0.0]), 5.0)
        >>> frame.to_field(np.array([[110.0, 5.0, 0.0]]))
        array([[2., 1., 0.]])
    """

    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))  # (3,) float64, world frame, user units
    unit: float = 1.0  # length of one unit of the field, user units

    @classmethod
    def from_dataset(cls, data: Dataset) -> "FieldFrame":
        """Return the frame of a dataset: the identity for trajectories, which are metric.

        For photographs, whose origin and scale are arbitrary, the origin is the median camera position. The scale makes
        the median distance to the focus :data:`SPREAD`, or the median distance to the origin where that is larger. The
        focus is the point nearest to all optical axes; it is used only if the axes are not nearly parallel and it lies
        in front of the cameras.

        Example:
            >>> from autonerf_lab.geometry import Intrinsics, planar_pose
            >>> from autonerf_lab.data.trajectory import Trajectory
            >>> ring = np.linspace(0, 6, 8)
            >>> poses = np.stack([planar_pose(9 * np.cos(a), 9 * np.sin(a), a + np.pi) for a in ring])
            >>> trajectory = Trajectory(poses, np.zeros((8, 2, 2, 3), np.uint8), None, None, Intrinsics.from_fov(2, 2))
            >>> data = Dataset.from_trajectory(trajectory)
            >>> from dataclasses import replace
            >>> FieldFrame.from_dataset(data).unit
            1.0
            >>> round(FieldFrame.from_dataset(replace(data, metric=False)).unit, 2)
            4.5
        """
        if data.metric:
            return cls()
        near = inliers(data.poses[:, :3, 3])
        positions, axes = data.poses[near, :3, 3], -data.poses[near, :3, 2]
        middle = np.median(positions, axis=0)
        spread = _typical(positions - middle)
        across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
        mean = across.mean(axis=0)
        if np.linalg.eigvalsh(mean)[0] > 1e-3:
            nearby = positions - middle  # large map coordinates would leave too few digits
            focus = np.linalg.solve(mean, np.einsum("tij,tj->i", across, nearby) / len(nearby))
            if np.median(((focus - nearby) * axes).sum(axis=1)) > 0:
                spread = max(spread, _typical(nearby - focus))
        return cls(middle, spread / SPREAD if spread > 0 else 1.0)

    def to_field(self, points: np.ndarray) -> np.ndarray:
        """Convert (..., 3) world points, in user units, to float64 field coordinates."""
        if self.unit == 1 and not self.origin.any():
            return np.asarray(points, np.float64)
        return (points - self.origin) / self.unit

    def to_world(self, points: np.ndarray) -> np.ndarray:
        """Convert (..., 3) field coordinates to world points; inverse of :meth:`to_field`."""
        return points * self.unit + self.origin

    def poses_to_field(self, c2w: np.ndarray) -> np.ndarray:
        """Convert (..., 4, 4) camera-to-world poses to field coordinates."""
        return _with_positions(c2w, self.to_field(c2w[..., :3, 3]))

    def poses_to_world(self, c2w: np.ndarray) -> np.ndarray:
        """Convert (..., 4, 4) poses to the world; inverse of :meth:`poses_to_field`."""
        return _with_positions(c2w, self.to_world(c2w[..., :3, 3]))


def _with_positions(c2w: np.ndarray, positions: np.ndarray) -> np.ndarray:
    poses = c2w.copy()
    poses[..., :3, 3] = positions
    return poses


def inliers(positions: np.ndarray) -> np.ndarray:
    """Return (T,) bool: True for positions (T, 3) within :data:`OUTLIER` times the typical distance from the median.

    Structure from motion sometimes places a photograph far away from the others.
    """
    offsets = positions - np.median(positions, axis=0)
    return np.linalg.norm(offsets, axis=1) <= OUTLIER * _typical(offsets)


def _typical(offsets: np.ndarray) -> float:
    """Return the median length of (T, 3) offsets, or the mean if more than half are zero (a camera on a tripod)."""
    lengths = np.linalg.norm(offsets, axis=1)
    return float(np.median(lengths) or lengths.mean())
