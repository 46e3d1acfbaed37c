"""Baseline for rendering: the nearest training image."""

import numpy as np
from PIL import Image as PillowImage

from autonerf_lab.data.dataset import Dataset
from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.nerf.field_frame import FieldFrame
from autonerf_lab.types import Rendering

METRES_PER_RADIAN = 2.0


class NearestView:
    """Baseline with the interface of a radiance field: ``render`` returns the nearest training image.

    The distance between two poses is ``|position - position'| + 2 m/rad * (angle between the rotations)``. At a depth
    of 2 m, typical indoors, a rotation by an angle moves the image as much as a translation by 2 m times that angle.
    For photographs, the unit is the metre as estimated by the field.

    Args:
        data: trajectory or photographs on which the field was trained.

    Example:
        >>> trajectory = Trajectory(np.eye(4)[None], np.full((1, 4, 4, 3), 255, np.uint8), None, None,
        ...                   Intrinsics.from_fov(4, 4))
        >>> NearestView(trajectory).render(np.eye(4), trajectory.intrinsics).rgb.mean()
        np.float32(1.0)
    """

    def __init__(self, data: Trajectory | Dataset) -> None:
        self.data = data = Dataset.from_trajectory(data) if isinstance(data, Trajectory) else data
        self.poses, self.intrinsics, self.meta = data.poses, data.intrinsics[0], data.meta
        self.frame = FieldFrame.from_dataset(data)

    def nearest(self, c2w: np.ndarray) -> int:
        """Return the index of the training view nearest to a (4, 4) pose."""
        distance = np.linalg.norm(self.poses[:, :3, 3] - c2w[:3, 3], axis=1) / self.frame.unit
        chord = np.linalg.norm(
            self.poses[:, :3, :3] - c2w[:3, :3], axis=(1, 2)
        )  # of a rotation by a: sqrt(8) sin(a / 2)
        angle = 2 * np.arcsin(np.clip(chord / np.sqrt(8), 0, 1))
        return int(np.argmin(distance + METRES_PER_RADIAN * angle))

    def render(self, c2w: np.ndarray, intrinsics: Intrinsics) -> Rendering:
        """Return the nearest training image, resized; depth is 0 if the image has none."""
        k, size = self.nearest(c2w), (intrinsics.width, intrinsics.height)
        shape = (intrinsics.height, intrinsics.width)
        rgb = np.asarray(PillowImage.fromarray(self.data.images[k]).resize(size, PillowImage.Resampling.BOX))
        depth, semantics = (
            None
            if layer is None
            else np.asarray(PillowImage.fromarray(layer[k]).resize(size, PillowImage.Resampling.NEAREST))
            for layer in (self.data.depths, self.data.semantics)
        )
        return Rendering(
            rgb.astype(np.float32) / 255,
            np.zeros(shape, np.float32) if depth is None else depth,
            semantics,
            np.ones(shape, np.float32),
        )
