"""Fisheye lenses by OpenCV's model, and the rectification of their images."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from autonerf_lab.geometry import Intrinsics


@dataclass(frozen=True)
class Fisheye:
    """Lens that shows a ray at the angle a to its axis a (1 + k1 a^2 + ... + k4 a^8) focal lengths from the centre."""

    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0

    def radius(self, angle: np.ndarray) -> np.ndarray:
        """Return the distance to the principal point, in focal lengths, of rays at angles in radians."""
        a2 = angle * angle
        return angle * (1 + a2 * (self.k1 + a2 * (self.k2 + a2 * (self.k3 + a2 * self.k4))))


def rectify(
    image: np.ndarray, camera: Intrinsics, lens: Fisheye, nearest: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Return the image that a pinhole camera with the same intrinsics sees.

    Args:
        image: (H, W) or (H, W, 3) image of the fisheye.
        camera: its focal lengths and principal point.
        lens: its distortion.
        nearest: take the nearest pixel instead of interpolating bilinearly.

    Returns:
        The image, of the same shape and type, and (H, W) bool, False where the fisheye saw nothing.

    Example:
        >>> camera = Intrinsics(4, 2, 100.0, 100.0, 2.0, 1.0)  # so narrow that the models agree
        >>> image = np.arange(8, dtype=np.uint8).reshape(2, 4)
        >>> np.array_equal(rectify(image, camera, Fisheye(), nearest=True)[0], image)
        True
    """
    u, v = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    x, y = (u - camera.cx) / camera.fl_x, (v - camera.cy) / camera.fl_y
    tangent = np.hypot(x, y)
    scale = lens.radius(np.arctan(tangent)) / np.maximum(tangent, 1e-12)
    scale = np.where(tangent < 1e-9, 1.0, scale)
    column, row = camera.fl_x * x * scale + camera.cx, camera.fl_y * y * scale + camera.cy
    inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height) & (scale > 0)
    if nearest:
        columns = np.clip(column, 0, camera.width - 1).astype(int)
        rows = np.clip(row, 0, camera.height - 1).astype(int)
        values = image[rows, columns]
        mask = inside[..., None] if image.ndim == 3 else inside
        return np.where(mask, values, np.zeros((), image.dtype)), inside
    channels = [
        ndimage.map_coordinates(image[..., k].astype(np.float32), (row - 0.5, column - 0.5), order=1, mode="nearest")
        for k in range(image.shape[-1])
    ]
    found = np.round(np.stack(channels, axis=-1)).astype(image.dtype)
    return np.where(inside[..., None], found, np.zeros((), image.dtype)), inside
