"""A yardstick for rendering: show the nearest training image instead of a rendering."""

from typing import TYPE_CHECKING

import numpy as np
from PIL import Image as Picture

from autonerf_lab.evaluators.field import Image
from autonerf_lab.geometry import Intrinsics, planar_from_pose

if TYPE_CHECKING:
    from autonerf_lab.trajectory import Trajectory

METRES_PER_RADIAN = 2.0


class NearestView:
    """Answers ``render`` with the training image whose pose is nearest.

    The distance of two poses is ``|xy - xy'| + 2 m/rad |heading - heading'|``: at a depth of 2 m, a typical one
    indoors, a turn by an angle moves the picture as much as a sideways step of 2 m times that angle.

    Args:
        trajectory: the walk that the field was trained on.

    Example:
        >>> from autonerf_lab.trajectory import Trajectory
        >>> walk = Trajectory(np.eye(4)[None], np.full((1, 4, 4, 3), 255, np.uint8), None, None,
        ...                   Intrinsics.from_fov(4, 4))
        >>> NearestView(walk).render(np.eye(4), walk.intrinsics).rgb.mean()
        np.float32(1.0)
    """

    def __init__(self, trajectory: "Trajectory") -> None:
        self.trajectory = trajectory
        self.cameras, self.intrinsics, self.meta = trajectory.poses, trajectory.intrinsics, trajectory.meta
        self._planar = np.array([planar_from_pose(c2w) for c2w in trajectory.poses])

    def nearest(self, c2w: np.ndarray) -> int:
        """Index of the training view nearest to a pose."""
        x, y, heading = planar_from_pose(c2w)
        turn = np.abs((self._planar[:, 2] - heading + np.pi) % (2 * np.pi) - np.pi)
        return int(np.argmin(np.hypot(self._planar[:, 0] - x, self._planar[:, 1] - y) + METRES_PER_RADIAN * turn))

    def render(self, c2w: np.ndarray, intrinsics: Intrinsics) -> Image:
        """The nearest training image, resized; depth 0 and class 0 where the walk kept none."""
        k, size = self.nearest(c2w), (intrinsics.width, intrinsics.height)
        shape = (intrinsics.height, intrinsics.width)
        rgb = np.asarray(Picture.fromarray(self.trajectory.rgb[k]).resize(size, Picture.Resampling.BOX))
        layers = [
            np.zeros(shape, np.float32)
            if layer is None
            else np.asarray(Picture.fromarray(layer[k]).resize(size, Picture.Resampling.NEAREST))
            for layer in (self.trajectory.depth, self.trajectory.semantics)
        ]
        opacity = np.ones(shape, np.float32)
        return Image(rgb.astype(np.float32) / 255, layers[0], layers[1].astype(np.uint8), opacity)
