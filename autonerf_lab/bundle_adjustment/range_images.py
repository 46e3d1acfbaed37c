"""Range images of a dataset: depth, normals and brightness of all frames on one small pixel grid each."""

from dataclasses import dataclass

import numpy as np

from autonerf_lab.bundle_adjustment.kernels import fit_planes
from autonerf_lab.data.dataset import Dataset
from autonerf_lab.geometry import Intrinsics

SIDE = 64  # pixels; the longer side of a range image of a large image is at least this, and less than twice as long
LEAST_STEP = 2  # pixels; depth images often repeat pixels, because they have half of the resolution
LUMA = np.array([0.299, 0.587, 0.114], np.float32)  # brightness of red, green and blue (ITU-R BT.601)


@dataclass(frozen=True)
class RangeImages:
    """T range images of h x w pixels, in their camera frames.

    Pixel [r, c] lies at the tangents (c + 0.5 - cx) / fx to the right and (r + 0.5 - cy) / fy downwards.
    """

    camera: np.ndarray  # (T, 4) float64: fx, fy, cx, cy in pixels of the range image
    surface: np.ndarray  # (T, h, w) float32, depth of the plane fitted around a pixel; 0 = not flat
    normals: np.ndarray  # (T, h, w, 3) float32, unit, towards the camera; 0 = not flat
    brightness: np.ndarray  # (T, h, w) float32 in [0, 1]

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.surface)


def range_images(data: Dataset) -> RangeImages:
    """Sample the depth and brightness of each frame at every k-th pixel and fit a plane around each sample.

    Inverse depth is an affine function of the image coordinates on a plane, and its noise does not depend on distance
    for stereo and structured light. So a plane is a least-squares fit of inverse depth in a window.

    Args:
        data: with depth; cameras may differ, also in their lens.
    """
    assert data.depths is not None
    longest = max(max(camera.width, camera.height) for camera in data.intrinsics)
    step = max(LEAST_STEP, longest // SIDE)
    sizes = [(-(-camera.height // step), -(-camera.width // step)) for camera in data.intrinsics]
    shape = (len(data), max(size[0] for size in sizes), max(size[1] for size in sizes))
    depth, brightness = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    cameras = np.empty((len(data), 4))
    lookups: dict[Intrinsics, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}
    for t, camera in enumerate(data.intrinsics):
        cameras[t] = (
            *(camera.fl_x / step, camera.fl_y / step),
            *((camera.cx - 0.5) / step + 0.5, (camera.cy - 0.5) / step + 0.5),
        )
        if camera not in lookups:
            lookups[camera] = _pixels(camera, cameras[t], sizes[t])
        rows, columns, inside = lookups[camera]
        used = inside if data.masks is None else inside & data.masks[t][rows, columns]
        found = np.where(used, data.depths[t][rows, columns], 0)
        height, width = sizes[t]
        depth[t, :height, :width] = np.where(np.isfinite(found), found, 0)
        image = data.images[t].astype(np.float32) @ (LUMA / np.float32(255))
        brightness[t, :height, :width] = _blurred(image, step)[rows, columns]
    surface, normals = np.zeros(shape, np.float32), np.zeros((*shape, 3), np.float32)
    fit_planes(depth, cameras, surface, normals)
    return RangeImages(cameras, surface, normals, brightness)


def _pixels(camera: Intrinsics, small: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the row and column of each pixel of a range image in its frame, and True if it is inside the image."""
    fx, fy, cx, cy = small
    v, u = np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5, indexing="ij")
    points = np.stack([(u - cx) / fx, -(v - cy) / fy, -np.ones_like(u)], axis=-1)
    pixels = camera.project(points.reshape(-1, 3)).reshape(*size, 2)
    inside = np.isfinite(pixels).all(axis=-1)
    at = np.floor(np.where(inside[..., None], pixels, -1) + 1e-6).astype(np.int64)
    inside &= ((at >= 0) & (at < (camera.width, camera.height))).all(axis=-1)
    at = np.clip(at, 0, (camera.width - 1, camera.height - 1))
    return at[..., 1], at[..., 0], inside


def _blurred(image: np.ndarray, step: int) -> np.ndarray:
    """Return the mean of an image over a window of about two steps, so that every step-th pixel does not alias."""
    from scipy.ndimage import gaussian_filter

    return gaussian_filter(image, 0.5 * step, mode="nearest")
