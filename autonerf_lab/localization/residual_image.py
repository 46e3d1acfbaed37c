"""Image of residuals between two successive scans: the later one, moved by a measured motion, on planes of the earlier.

A residual is the difference of two inverse depths in the frame of the earlier scan, in which the noise of the sensor
has the same size at all distances. Its derivatives by the motion are stored with it.
"""

import numpy as np
from numba import njit

from autonerf_lab.localization.scan import INVERSE_DEPTH_SIGMA, Scan, project

CHANNELS = 5  # residual, standard deviations; derivatives by x, y (1/m2) and heading (1/(m rad)); 1 where it is known
LARGEST = 0.05  # 1/m; larger residuals belong to another surface


def residual_image(scan: Scan, reference: Scan, motion: np.ndarray) -> np.ndarray:
    """Return the residuals of a scan before the planes of the previous one, and their derivatives.

    Args:
        scan: new scan, R x C points.
        reference: previous scan.
        motion: (3,) measured motion between them: forward, left, counter-clockwise; metres and radians.

    Returns:
        (5, R, C) float32, see :data:`CHANNELS`; 0 where the point is not on a plane of the reference.

    Example:
        A wall at 2 m, and 10 cm nearer after a motion that was measured as 9 cm: 1/2 - 1/1.99 per metre.

        >>> from autonerf_lab.geometry import Intrinsics
        >>> from autonerf_lab.localization.scan import make_scan
        >>> wall, nearer = (make_scan(np.full((64, 64), d), Intrinsics.from_fov(64, 64)) for d in (2.0, 1.9))
        >>> image = residual_image(nearer, wall, np.array([0.09, 0.0, 0.0]))
        >>> (image[:, 16, 16] * [INVERSE_DEPTH_SIGMA, 1, 1, 1, 1]).round(4) + 0
        array([-0.0025,  0.2513,  0.    ,  0.0075,  1.    ])
    """
    image = np.zeros((CHANNELS, *scan.points.shape[:2]), np.float32)
    _fill(scan.points, reference.planes, reference.camera, motion[0], motion[1], motion[2], image)
    return image


@njit(cache=True)
def _fill(
    points: np.ndarray,
    planes: np.ndarray,
    camera: np.ndarray,
    x: float,
    y: float,
    heading: float,
    image: np.ndarray,
) -> None:
    rows, cols = planes.shape[:2]
    c, s = np.cos(heading), np.sin(heading)
    for row in range(points.shape[0]):
        for col in range(points.shape[1]):
            px, py, pz = points[row, col, 0], points[row, col, 1], points[row, col, 2]
            if px <= 0:
                continue
            rx, ry = c * px - s * py, s * px + c * py
            qx, qy = rx + x, ry + y
            v, u = project(qx, qy, pz, camera)
            if u < 0 or v < 0 or u >= cols or v >= rows:
                continue
            nx, ny, nz = planes[v, u, 0], planes[v, u, 1], planes[v, u, 2]
            if nx == 0.0 and ny == 0.0:
                continue
            residual = (nx * qx + ny * qy + nz * pz - 1.0) / qx
            if abs(residual) > LARGEST:
                continue
            image[0, row, col] = residual / INVERSE_DEPTH_SIGMA
            image[1, row, col] = nx / qx
            image[2, row, col] = ny / qx
            image[3, row, col] = (ny * rx - nx * ry) / qx
            image[4, row, col] = 1.0
