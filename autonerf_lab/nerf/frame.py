"""The field's own coordinates: a room's size around zero, whatever the frame and the scale of the cameras are."""

from dataclasses import dataclass, field

import numpy as np

from autonerf_lab.data.dataset import Dataset

SPREAD = 2.0  # what the typical distance of photographs' cameras from what they look at becomes, in the field's units
OUTLIER = 10.0  # cameras so many times farther out than the typical one say nothing about where the scene is


@dataclass(frozen=True)
class FieldFrame:
    """Where the field's zero lies in the cameras' world, and what the field calls one metre there. Nothing is turned.

    Example:
        >>> frame = FieldFrame(np.array([100.0, 0.0, 0.0]), 5.0)
        >>> frame.enter(np.array([[110.0, 5.0, 0.0]]))
        array([[2., 1., 0.]])
    """

    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))  # (3,) float64, world frame, user units
    unit: float = 1.0  # user units

    @classmethod
    def of(cls, data: Dataset) -> "FieldFrame":
        """That of a walk is the world: metres. Photographs have any scale and any zero.

        Zero becomes the middle of the cameras, and :data:`SPREAD` their distance from the focus, or from the middle
        where that is more. The focus is the point nearest to all optical axes, where they are not too parallel to
        have one, and where it lies in front of the cameras.

        Example:
            >>> from autonerf_lab.geometry import Intrinsics, planar_pose
            >>> from autonerf_lab.data.trajectory import Trajectory
            >>> ring = np.linspace(0, 6, 8)
            >>> poses = np.stack([planar_pose(9 * np.cos(a), 9 * np.sin(a), a + np.pi) for a in ring])
            >>> walk = Trajectory(poses, np.zeros((8, 2, 2, 3), np.uint8), None, None, Intrinsics.from_fov(2, 2))
            >>> data = Dataset.of(walk)
            >>> import dataclasses
            >>> FieldFrame.of(data).unit, round(FieldFrame.of(dataclasses.replace(data, metric=False)).unit, 2)
            (1.0, 4.5)
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
            nearby = positions - middle  # numbers as large as those of a map would leave no digits to solve with
            focus = np.linalg.solve(mean, np.einsum("tij,tj->i", across, nearby) / len(nearby))
            if np.median(((focus - nearby) * axes).sum(axis=1)) > 0:
                spread = max(spread, _typical(nearby - focus))
        return cls(middle, spread / SPREAD if spread > 0 else 1.0)

    def enter(self, points: np.ndarray) -> np.ndarray:
        """(..., 3) world points in user units -> float64 in the field's coordinates."""
        return (points - self.origin) / self.unit

    def leave(self, points: np.ndarray) -> np.ndarray:
        """The inverse of :meth:`enter`."""
        return points * self.unit + self.origin

    def enter_poses(self, c2w: np.ndarray) -> np.ndarray:
        """(..., 4, 4) camera-to-world poses -> the same in the field's coordinates."""
        return _with_positions(c2w, self.enter(c2w[..., :3, 3]))

    def leave_poses(self, c2w: np.ndarray) -> np.ndarray:
        """The inverse of :meth:`enter_poses`."""
        return _with_positions(c2w, self.leave(c2w[..., :3, 3]))


def _with_positions(c2w: np.ndarray, positions: np.ndarray) -> np.ndarray:
    poses = c2w.copy()
    poses[..., :3, 3] = positions
    return poses


def inliers(positions: np.ndarray) -> np.ndarray:
    """(T,) bool: which of (T, 3) cameras are not :data:`OUTLIER` times farther from the middle than is typical.

    Programs that find poses now and then put a photograph nowhere near the others.
    """
    offsets = positions - np.median(positions, axis=0)
    return np.linalg.norm(offsets, axis=1) <= OUTLIER * _typical(offsets)


def _typical(offsets: np.ndarray) -> float:
    """The median length of (T, 3) offsets; the mean where more than half are zero, as those of a tripod are."""
    lengths = np.linalg.norm(offsets, axis=1)
    return float(np.median(lengths) or lengths.mean())
