"""Scan matching in SE(2): point to plane, with projective association (Chen and Medioni 1992; Blais and Levine 1995).

A point of the new scan is projected into the image of a reference scan and compared with the plane at that pixel. The
camera is level and the robot moves on a floor, so that three numbers are estimated: x, y and heading. Residuals are
weighted by the noise of the depth sensor and by a robust kernel, whose width shrinks from iteration to iteration.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from autonerf_lab.localization.scan import INVERSE_DEPTH_SIGMA, Scan, project
from autonerf_lab.localization.se2 import between, rotation

WIDTHS = (0.3, 0.2, 0.1, 0.06, 0.04, 0.04, 0.04)  # metres, of the robust kernel in each iteration
CORRELATION = 400.0  # number of points that count as one: neighbouring points share plane, quantisation and bias
_FLOOR = 0.004  # metres, errors of planes and surfaces that do not depend on the distance


@dataclass(frozen=True)
class ScanFactor:
    """Quadratic approximation of the error of a match: ``1/2 d' H d + b' d``, d the deviation from ``motion``.

    It also describes matches that do not fix all of the pose, as in a corridor.
    """

    motion: np.ndarray  # (3,) from the reference to the new scan, in the frame of the reference
    information: np.ndarray  # (3, 3) H, in the frame of the reference
    gradient: np.ndarray  # (3,) b
    overlap: int  # points of the new scan that project onto a plane of the reference
    inliers: int  # points within three standard deviations of the plane


@dataclass(frozen=True)
class Match:
    """Pose of a scan that fits the reference scans."""

    pose: np.ndarray  # (3,) x, y, heading
    information: np.ndarray  # (3, 3) of the scans alone, world frame
    factors: list[ScanFactor]  # one for each reference


def match(
    scan: Scan,
    guess: np.ndarray,
    covariance: np.ndarray,
    references: Sequence[tuple[np.ndarray, Scan]],
    widths: Sequence[float] = WIDTHS,
) -> Match:
    """Estimate the pose of a scan from reference scans and a prior, by Gauss-Newton steps.

    Args:
        scan: new scan.
        guess: (3,) pose of the prior: x, y, heading.
        covariance: (3, 3) of the prior, world frame.
        references: pose and scan of each reference.
        widths: of the robust kernel in each iteration, metres.

    Example:
        >>> from autonerf_lab.geometry import Intrinsics
        >>> from autonerf_lab.localization.scan import make_scan
        >>> wall, nearer = (make_scan(np.full((64, 64), d), Intrinsics.from_fov(64, 64)) for d in (2.0, 1.9))
        >>> result = match(nearer, np.zeros(3), np.diag([0.01, 0.01, 0.01]), [(np.zeros(3), wall)])
        >>> result.pose.round(3) + 0
        array([0.1, 0. , 0. ])
    """
    prior = np.linalg.inv(covariance)
    pose = np.array(guess, dtype=np.float64)
    information = np.zeros((3, 3))
    factors: list[ScanFactor] = []
    for i, width in enumerate(widths):
        information, gradient, factors = np.zeros((3, 3)), np.zeros(3), []
        every = 2 if i < len(widths) // 2 else 1  # half of the rows and columns are enough at first
        for reference, other in references:
            factor = compare(scan, other, between(reference, pose), width, every)
            factors.append(factor)
            turn = np.eye(3)
            turn[:2, :2] = rotation(reference[2])
            information += turn @ factor.information @ turn.T
            gradient += turn @ factor.gradient
        offset = pose - guess
        step = np.linalg.solve(information + prior, -gradient - prior @ offset)
        pose = pose + step
    return Match(pose, information, factors)


def compare(scan: Scan, reference: Scan, motion: np.ndarray, width: float, every: int = 1) -> ScanFactor:
    """Compare a scan with a reference at a given motion between them.

    Args:
        scan: new scan.
        reference: reference scan.
        motion: (3,) pose of the new scan in the frame of the reference.
        width: of the robust kernel, metres.
        every: use every n-th row and column of the new scan.
    """
    sums = np.zeros(11)
    _accumulate(
        scan.points, scan.planes, reference.points, reference.planes, reference.camera,
        motion[0], motion[1], motion[2], width, every, sums,
    )  # fmt: skip
    scale = every**2 / CORRELATION
    h = sums[:6] * scale
    information = np.array([[h[0], h[1], h[2]], [h[1], h[3], h[4]], [h[2], h[4], h[5]]])
    return ScanFactor(
        np.array(motion), information, sums[6:9] * scale, int(sums[9] * every**2), int(sums[10] * every**2)
    )


@njit(cache=True, fastmath=True)
def _accumulate(
    points: np.ndarray,
    own_planes: np.ndarray,
    seen: np.ndarray,
    planes: np.ndarray,
    camera: np.ndarray,
    x: float,
    y: float,
    heading: float,
    width: float,
    every: int,
    sums: np.ndarray,
) -> None:
    """Add up the six entries of the information, the gradient, and the numbers of overlapping points and inliers."""
    rows, cols = planes.shape[:2]
    c, s = np.cos(heading), np.sin(heading)
    for row in range(0, points.shape[0], every):
        for col in range(0, points.shape[1], every):
            if own_planes[row, col, 0] == 0.0 and own_planes[row, col, 1] == 0.0:
                continue
            px, py, pz = points[row, col, 0], points[row, col, 1], points[row, col, 2]
            rx, ry = c * px - s * py, s * px + c * py
            qx, qy = rx + x, ry + y
            v, u = project(qx, qy, pz, camera)
            if u < 0 or v < 0 or u >= cols or v >= rows:
                continue
            nx, ny, nz = planes[v, u, 0], planes[v, u, 1], planes[v, u, 2]
            if nx == 0.0 and ny == 0.0:
                continue
            if qx > seen[v, u, 0] + 3 * width + 0.1:  # hidden behind the reference's surface
                continue
            scale = 1.0 / np.sqrt(nx * nx + ny * ny + nz * nz)
            residual = (nx * qx + ny * qy + nz * pz - 1.0) * scale
            sums[9] += 1.0
            nx, ny, nz = nx * scale, ny * scale, nz * scale
            # The two surfaces must face the same side.
            ox, oy, oz = own_planes[row, col, 0], own_planes[row, col, 1], own_planes[row, col, 2]
            facing = (c * ox - s * oy) * nx + (s * ox + c * oy) * ny + oz * nz
            if facing < 0.7 * np.sqrt(ox * ox + oy * oy + oz * oz):
                continue
            # Noise of the point along the normal: depth noise moves it along its ray.
            along = (nx * rx + ny * ry + nz * pz) / px
            sigma = INVERSE_DEPTH_SIGMA * px * px * along
            variance = sigma * sigma + _FLOOR * _FLOOR
            if residual * residual < 9.0 * variance + _FLOOR * _FLOOR:
                sums[10] += 1.0
            kernel = width * width + variance
            w = kernel / (kernel + residual * residual)
            w = w * w / variance
            jh = ny * rx - nx * ry
            sums[0] += w * nx * nx
            sums[1] += w * nx * ny
            sums[2] += w * nx * jh
            sums[3] += w * ny * ny
            sums[4] += w * ny * jh
            sums[5] += w * jh * jh
            sums[6] += w * nx * residual
            sums[7] += w * ny * residual
            sums[8] += w * jh * residual
