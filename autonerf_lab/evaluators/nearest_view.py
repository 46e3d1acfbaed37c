"""A baseline for rendering: show the nearest training image instead of a rendering."""

import numpy as np
from PIL import Image as Picture

from autonerf_lab.data.dataset import Dataset
from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.evaluators.radiance_field import Image
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.nerf.frame import FieldFrame

METRES_PER_RADIAN = 2.0


class NearestView:
    """Answers ``render`` with the training image whose pose is nearest.

    The distance of two poses is ``|position - position'| + 2 m/rad (angle between the rotations)``: at a depth of 2 m,
    a typical one indoors, a turn by an angle moves the picture as much as a sideways step of 2 m times that angle. Of
    photographs, a metre is what a field takes for one.

    Args:
        data: the walk or the photographs that the field was trained on.

    Example:
        >>> walk = Trajectory(np.eye(4)[None], np.full((1, 4, 4, 3), 255, np.uint8), None, None,
        ...                   Intrinsics.from_fov(4, 4))
        >>> NearestView(walk).render(np.eye(4), walk.intrinsics).rgb.mean()
        np.float32(1.0)
    """

    def __init__(self, data: Trajectory | Dataset) -> None:
        self.data = data = Dataset.of(data) if isinstance(data, Trajectory) else data
        self.cameras, self.intrinsics, self.meta = data.poses, data.cameras[0], data.meta
        self.frame = FieldFrame.of(data)

    def nearest(self, c2w: np.ndarray) -> int:
        """Index of the training view nearest to a pose."""
        moved = np.linalg.norm(self.cameras[:, :3, 3] - c2w[:3, 3], axis=1) / self.frame.unit
        chord = np.linalg.norm(self.cameras[:, :3, :3] - c2w[:3, :3], axis=(1, 2))  # of a turn by a: sqrt(8) sin(a / 2)
        turned = 2 * np.arcsin(np.clip(chord / np.sqrt(8), 0, 1))
        return int(np.argmin(moved + METRES_PER_RADIAN * turned))

    def render(self, c2w: np.ndarray, intrinsics: Intrinsics) -> Image:
        """The nearest training image, resized; depth 0 where there was none."""
        k, size = self.nearest(c2w), (intrinsics.width, intrinsics.height)
        shape = (intrinsics.height, intrinsics.width)
        rgb = np.asarray(Picture.fromarray(self.data.images[k]).resize(size, Picture.Resampling.BOX))
        depth, semantics = (
            None if layer is None else np.asarray(Picture.fromarray(layer[k]).resize(size, Picture.Resampling.NEAREST))
            for layer in (self.data.depths, self.data.semantics)
        )
        return Image(
            rgb.astype(np.float32) / 255,
            np.zeros(shape, np.float32) if depth is None else depth,
            semantics,
            np.ones(shape, np.float32),
        )
