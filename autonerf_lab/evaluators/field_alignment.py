"""Fields in the frame of estimated poses, aligned with the scene.

A field that was trained on measured or estimated poses lives in their frame. Before it is scored, this frame is moved
onto that of the scene by the planar rigid motion that fits its training poses to the true ones
(:func:`autonerf_lab.localization.align`). The errors of single poses remain, and so does what they do to the field.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from autonerf_lab.data.dataset import Dataset
from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.errors import DataError
from autonerf_lab.evaluators.radiance_field import RadianceField
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.localization.se2 import to_planar
from autonerf_lab.localization.trajectory_alignment import align, motion_matrix
from autonerf_lab.types import Rendering


def alignment_of(poses: np.ndarray, meta: dict[str, Any]) -> np.ndarray | None:
    """Return the planar motion (3,) that moves training poses onto the true ones; None if they are the true ones.

    Args:
        poses: (T, 4, 4) training poses.
        meta: of the field, with ``pose_source`` and ``true_poses`` (x, y, heading) if the poses are not the true ones.

    Raises:
        DataError: the true poses are not known, or not valid.

    Example:
        >>> from autonerf_lab.localization.se2 import to_matrices
        >>> alignment_of(to_matrices(np.array([[1.0, 0, 0], [2, 0, 0]])),
        ...              {"pose_source": "odometry", "true_poses": [[0.0, 0, 0], [1, 0, 0]]}).round(6) + 0
        array([-1.,  0.,  0.])
    """
    source, rows = meta.get("pose_source", "true"), meta.get("true_poses")
    if source == "true":
        return None
    if rows is None:
        raise DataError(
            f"this field is in the frame of its {source} poses, which cannot be aligned with a scene: its true poses "
            "are not known; evaluate it on held-out images instead"
        )
    return align(to_planar(poses), true_poses(meta, len(poses)))


def true_poses(meta: dict[str, Any], count: int) -> np.ndarray:
    """Return the (T, 3) true poses in the metadata of a field.

    Raises:
        DataError: they are not ``count`` rows of three numbers.
    """
    try:
        rows = np.array(meta.get("true_poses"), dtype=np.float64)
    except (TypeError, ValueError):
        rows = np.empty(0)
    if rows.shape != (count, 3) or not np.isfinite(rows).all():
        raise DataError(f"'true_poses' of this field must be {count} rows of x, y and heading; fit again")
    return rows


def aligned_field(field: RadianceField) -> RadianceField:
    """Return a field in the frame of its scene; the field itself if it was trained on true poses.

    Raises:
        DataError: the true poses are not known, or not valid.
    """
    motion = alignment_of(field.poses, field.meta)
    return field if motion is None else AlignedField(field, motion)


def aligned_data(data: Trajectory | Dataset) -> Trajectory | Dataset:
    """Return training data with poses in the frame of their scene; the data themselves if they have true poses."""
    true = data.other_poses.get("true") if isinstance(data, Trajectory) else data.true_poses
    if data.pose_source == "true" or true is None:
        return data
    return replace(data, poses=motion_matrix(align(to_planar(data.poses), to_planar(true))) @ data.poses)


class AlignedField:
    """Field after a planar rigid motion: an object with the interface of a radiance field.

    Args:
        field: metric field, whose ``frame`` is the identity.
        motion: (3,) x, y (metres) and heading (radians) that move the frame of the field onto that of the scene.
    """

    def __init__(self, field: RadianceField, motion: np.ndarray) -> None:
        self.field, self.motion = field, motion
        self._matrix = motion_matrix(motion)
        self._rotation, self._shift = self._matrix[:3, :3], self._matrix[:3, 3]
        self.poses: np.ndarray = self._matrix @ field.poses
        self.intrinsics, self.meta, self.classes, self.frame = field.intrinsics, field.meta, field.classes, field.frame

    def _points(self, points: np.ndarray) -> np.ndarray:
        return ((points - self._shift) @ self._rotation).astype(points.dtype)

    def render(self, c2w: np.ndarray, intrinsics: Intrinsics | None = None) -> Rendering:
        """Render the view from a (4, 4) pose in the frame of the scene."""
        return self.field.render(np.linalg.inv(self._matrix) @ c2w, intrinsics or self.intrinsics)

    def density(self, points: np.ndarray) -> np.ndarray:
        """Return the (N,) densities at (N, 3) points."""
        return self.field.density(self._points(points))

    def color(self, points: np.ndarray, directions: np.ndarray | None = None) -> np.ndarray:
        """Return the (N, 3) colours at (N, 3) points, seen along ``directions``."""
        return self.field.color(self._points(points), None if directions is None else directions @ self._rotation)

    def semantics(self, points: np.ndarray) -> np.ndarray:
        """Return the (N, 16) class probabilities at (N, 3) points."""
        return self.field.semantics(self._points(points))

    def seen(self, points: np.ndarray) -> np.ndarray:
        """Return (N,) bool: True if a point was seen by a training view."""
        return self.field.seen(self._points(points))

    def ray_gradients(
        self, rays_o: np.ndarray, rays_d: np.ndarray, target: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the errors of (N, 3) rays and their gradients, in the frame of the scene."""
        error, origins, directions = self.field.ray_gradients(
            self._points(rays_o), (rays_d @ self._rotation).astype(rays_d.dtype), target
        )
        turn = self._rotation.T.astype(origins.dtype)
        return error, origins @ turn, directions @ turn
