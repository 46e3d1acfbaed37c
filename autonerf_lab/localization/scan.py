"""Scans: points of a depth image with the planes on which they lie.

The inverse depth of a plane is linear in the pixel coordinates, and the noise of triangulating depth sensors has the
same size everywhere in inverse depth. So a plane is fitted to the inverse depth of a window of pixels by linear least
squares: with the ray ``r = (1, y / x, z / x)`` of a pixel, ``1 / x = q . r``, and the plane is ``q . p = 1``. The frame
of a scan is that of the robot: x forward, y left, z up, origin at the camera.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from autonerf_lab.geometry import Intrinsics

STRIDE = 2  # pixels; structured-light sensors resolve no more
NEAR, FAR = 0.2, 6.0  # metres, range of the depths that are used
INVERSE_DEPTH_SIGMA = 0.0015  # 1/m, of a depth
_FRONT = 0.1  # metres, nearest point that is projected
_EDGE = 0.01  # 1/m, larger deviations from a plane belong to another surface
_ENOUGH = 13  # of the 25 pixels of a window
_LEVEL = 0.3  # smallest horizontal part of a normal; flatter surfaces say nothing about a planar motion


@dataclass(frozen=True)
class Scan:
    """Points and planes of one depth image, on a grid of every second pixel."""

    points: np.ndarray  # (R, C, 3) float64, metres, robot frame; x = 0 for none
    planes: np.ndarray  # (R, C, 3) float64, normal divided by the distance of the plane, 1/m; 0 for none
    camera: np.ndarray  # (4,) fl_x, fl_y, cx, cy of the grid, pixels

    @property
    def count(self) -> int:
        """Number of points on surfaces that are steep enough to be matched."""
        return int(np.count_nonzero(self.planes.any(axis=2)))


def make_scan(depth: np.ndarray, intrinsics: Intrinsics) -> Scan:
    """Make a scan of a depth image.

    Args:
        depth: (H, W) metres along the optical axis of a level camera, 0 for none.
        intrinsics: of the camera.

    Example:
        >>> scan = make_scan(np.full((64, 64), 2.0, np.float32), Intrinsics.from_fov(64, 64))
        >>> scan.points.shape, scan.planes[16, 16].round(3) + 0
        ((32, 32, 3), array([0.5, 0. , 0. ]))
    """
    depth = np.ascontiguousarray(depth[::STRIDE, ::STRIDE], dtype=np.float64)
    k = intrinsics
    # The pixel 2 k of the image, with its centre at 2 k + 0.5, is the pixel k of the grid, with its centre at k.
    camera = np.array([k.fl_x, k.fl_y, k.cx - 0.5, k.cy - 0.5]) / STRIDE
    points, planes = np.zeros((*depth.shape, 3)), np.zeros((*depth.shape, 3))
    _fill(depth, camera, points, planes)
    return Scan(points, planes, camera)


@njit(inline="always")  # compiled into its callers, with their arithmetic
def project(x: float, y: float, z: float, camera: np.ndarray) -> tuple[int, int]:
    """Return the row and column on which a point of the robot frame is seen, (-1, -1) if it is not in front."""
    row = col = -1
    if x >= _FRONT:
        row = int(np.rint(camera[3] - camera[1] * z / x))
        col = int(np.rint(camera[2] - camera[0] * y / x))
    return row, col


@njit(cache=True)
def _fit_plane(
    inverse: np.ndarray, row: int, col: int, reach: int, first: np.ndarray, rough: bool, plane: np.ndarray
) -> float:
    """Fit ``inverse = c + a i + b j`` around a pixel; write (c, a, b) and return the number of pixels, or 0."""
    height, width = inverse.shape
    s = np.zeros((3, 3))
    t = np.zeros(3)
    for i in range(max(row - reach, 0), min(row + reach + 1, height)):
        for j in range(max(col - reach, 0), min(col + reach + 1, width)):
            value = inverse[i, j]
            y, x = float(i - row), float(j - col)
            if value <= 0 or (not rough and abs(first[0] + first[1] * y + first[2] * x - value) > _EDGE):
                continue
            s[0, 0] += 1
            s[0, 1] += y
            s[0, 2] += x
            s[1, 1] += y * y
            s[1, 2] += y * x
            s[2, 2] += x * x
            t[0] += value
            t[1] += y * value
            t[2] += x * value
    a, b, c, d, e, f = s[0, 0], s[0, 1], s[0, 2], s[1, 1], s[1, 2], s[2, 2]
    m00, m01, m02 = d * f - e * e, c * e - b * f, b * e - c * d
    det = a * m00 + b * m01 + c * m02
    if a < 6 or abs(det) < 1e-6:
        return 0.0
    m11, m12, m22 = a * f - c * c, b * c - a * e, a * d - b * b
    plane[0] = (m00 * t[0] + m01 * t[1] + m02 * t[2]) / det
    plane[1] = (m01 * t[0] + m11 * t[1] + m12 * t[2]) / det
    plane[2] = (m02 * t[0] + m12 * t[1] + m22 * t[2]) / det
    return a


@njit(cache=True)
def _fill(depth: np.ndarray, camera: np.ndarray, points: np.ndarray, planes: np.ndarray) -> None:
    height, width = depth.shape
    inverse = np.zeros((height, width))
    for row in range(height):
        for col in range(width):
            d = depth[row, col]
            if NEAR <= d <= FAR:
                inverse[row, col] = 1.0 / d
                points[row, col, 0] = d
                points[row, col, 1] = d * (camera[2] - col) / camera[0]
                points[row, col, 2] = d * (camera[3] - row) / camera[1]
    rough, fine = np.zeros(3), np.zeros(3)
    for row in range(height):
        for col in range(width):
            if inverse[row, col] <= 0 or _fit_plane(inverse, row, col, 1, rough, True, rough) < 6:
                continue
            if abs(rough[0] - inverse[row, col]) > _EDGE:
                continue
            if _fit_plane(inverse, row, col, 2, rough, False, fine) < _ENOUGH:
                continue
            # c + a i + b j = q . r with r = (1, (cx - col - j) / fl_x, (cy - row - i) / fl_y)
            qy, qz = -fine[2] * camera[0], -fine[1] * camera[1]
            qx = fine[0] - qy * (camera[2] - col) / camera[0] - qz * (camera[3] - row) / camera[1]
            if qx * qx + qy * qy > _LEVEL**2 * (qx * qx + qy * qy + qz * qz):
                planes[row, col, 0], planes[row, col, 1], planes[row, col, 2] = qx, qy, qz
