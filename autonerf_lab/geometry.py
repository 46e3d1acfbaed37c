"""Conventions of frames, cameras and grids, and the functions that convert between them.

* World: right-handed, metres, z up, floor at z = 0.
* Camera: OpenGL, x right, y up, looks along -z. A pose is camera-to-world, (4, 4) float64.
* Heading: radians, counter-clockwise seen from above, 0 looks along world +x.
* Depth: along the optical axis, not along the ray.
* Image: row 0 at the top, pixel centres at half-integers.
* Grid: arrays are indexed [row, column] = [y, x]; ``origin`` is the world x, y of the outer corner of cell [0, 0].
"""

import warnings
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

CAMERA_HEIGHT = 0.88  # metres; this and the next three are the paper's agent
AGENT_RADIUS = 0.18  # metres
FORWARD_STEP = 0.25  # metres
TURN_ANGLE = float(np.radians(30))
OPENCV_AXES = np.diag([1.0, -1.0, -1.0, 1.0])  # converts poses between camera axes of OpenGL and OpenCV, both ways

_CHUNK = 1 << 17  # pixels undistorted at a time, which keeps the temporaries small
_MAX_TANGENT = 1e6  # tangent of the widest angle between a ray and the optical axis


@dataclass(frozen=True)
class Intrinsics:
    """Pinhole camera with the lens distortion of OpenCV's model (all zeros: none).

    A point at x to the right and y down, both divided by its depth, is projected to the pixel (fl_x x' + cx,
    fl_y y' + cy), where r^2 = x^2 + y^2 and::

        x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2)
        y' = y (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p2 x y + p1 (r^2 + 2 y^2)

    Example:
        >>> Intrinsics.from_fov(128, 128, hfov_deg=90).fl_x
        64.0
    """

    width: int
    height: int
    fl_x: float  # focal lengths and principal point, pixels
    fl_y: float
    cx: float
    cy: float
    k1: float = 0.0  # radial distortion
    k2: float = 0.0
    k3: float = 0.0
    p1: float = 0.0  # tangential distortion
    p2: float = 0.0

    @classmethod
    def from_fov(cls, width: int, height: int, hfov_deg: float = 90.0) -> "Intrinsics":
        """Return a camera with square pixels and the principal point in the middle of the image."""
        # round() keeps 90 degrees exact: tan(pi / 4) is not 1 in floating point
        focal = round(width / 2 / float(np.tan(np.radians(hfov_deg) / 2)), 9)
        return cls(width, height, focal, focal, width / 2, height / 2)

    @property
    def lens(self) -> tuple[float, float, float, float, float]:
        """Distortion coefficients k1, k2, k3, p1, p2."""
        return self.k1, self.k2, self.k3, self.p1, self.p2

    def resized(self, width: int, height: int) -> "Intrinsics":
        """Return the same camera with another number of pixels; the distortion does not depend on it."""
        sx, sy = width / self.width, height / self.height
        focal = {"fl_x": self.fl_x * sx, "fl_y": self.fl_y * sy}
        return replace(self, width=width, height=height, **focal, cx=self.cx * sx, cy=self.cy * sy)

    def directions(self) -> np.ndarray:
        """Return the camera-frame directions through the pixel centres, scaled to depth 1 (z = -1).

        :meth:`project` maps them back to the pixel centres. In the corners of a strong wide-angle lens the model may
        fold back, so that no direction corresponds to a pixel. Such a pixel gets the direction at the fold, and a
        UserWarning says how many pixels are affected.

        Returns:
            (H, W, 3) float64.

        Example:
            >>> camera = Intrinsics(2, 2, 1.0, 1.0, 1.0, 1.0, k1=0.1)
            >>> camera.project(camera.directions().reshape(-1, 3)).round(6).tolist()
            [[0.5, 0.5], [1.5, 0.5], [0.5, 1.5], [1.5, 1.5]]
        """
        u, v = np.meshgrid(np.arange(self.width) + 0.5, np.arange(self.height) + 0.5)
        x, y = (u - self.cx) / self.fl_x, (v - self.cy) / self.fl_y
        if any(self.lens):
            flat = np.stack([x.ravel(), y.ravel()])
            tolerance = 1e-8 / max(self.fl_x, self.fl_y)  # of a pixel
            folded = sum(
                _undistort(flat[:, start : start + _CHUNK], self.lens, tolerance)
                for start in range(0, flat.shape[1], _CHUNK)
            )
            if folded:
                warnings.warn(
                    f"the lens distortion cannot be inverted at {folded} of {flat.shape[1]} pixels, which get a "
                    "direction at the edge of the valid region; crop or undistort the images",
                    stacklevel=2,
                )
            x, y = flat.reshape(2, *x.shape)
        return np.stack([x, -y, -np.ones_like(u)], axis=-1)

    def project(self, points: np.ndarray) -> np.ndarray:
        """Project camera-frame points to pixels.

        Args:
            points: (N, 3), camera frame, any unit.

        Returns:
            (N, 2) float64 u, v in pixels, possibly outside the image. NaN for points behind the camera or beyond the
            fold of the lens model (see :meth:`directions`).

        Example:
            >>> Intrinsics.from_fov(128, 128).project(np.array([[1.0, 0.5, -2.0], [0.0, 0.0, 1.0]]))
            array([[96., 48.],
                   [nan, nan]])
        """
        points = np.asarray(points, np.float64)
        depth = np.where(points[:, 2] < 0, -points[:, 2], np.nan)
        x, y = points[:, 0] / depth, -points[:, 1] / depth
        if any(self.lens):
            flat = np.stack([x, y])
            seen = np.hypot(x, y) <= _fold_radius(flat, self.lens) * (1 + 1e-9)
            x, y = np.where(seen, _distort(flat, self.lens)[:2], np.nan)
        return np.stack([self.fl_x * x + self.cx, self.fl_y * y + self.cy], axis=-1)


def _distort(points: np.ndarray, lens: tuple[float, ...]) -> np.ndarray:
    """Map (2, N) x, y to (5, N): x', y' of OpenCV's model and its derivatives dx'/dx, dx'/dy = dy'/dx, dy'/dy."""
    x, y = points
    k1, k2, k3, p1, p2 = lens
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))
    return np.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + 2 * p2 * x * y + p1 * (r2 + 2 * y * y),
            radial + slope * x * x + 2 * p1 * y + 6 * p2 * x,
            slope * x * y + 2 * p1 * x + 2 * p2 * y,
            radial + slope * y * y + 2 * p2 * x + 6 * p1 * y,
        ]
    )


@lru_cache(maxsize=256)
def _folds(lens: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return angles, and for each angle the radius beyond which the lens model is not invertible.

    The model folds where the determinant of its derivatives reaches zero. At radius t in the direction (cos, sin)
    of an angle, with a = p1 sin + p2 cos and b = p1 cos - p2 sin, that determinant is the polynomial
    (1 + 6 a t + 3 k1 t^2 + 5 k2 t^4 + 7 k3 t^6) (1 + 2 a t + k1 t^2 + k2 t^4 + k3 t^6) - 4 b^2 t^2.
    """
    k1, k2, k3, p1, p2 = lens
    angles = np.linspace(-np.pi, np.pi, 128 if p1 or p2 else 1, endpoint=False)
    radii = np.full(len(angles), _MAX_TANGENT)
    for i, angle in enumerate(angles):
        a, b = p1 * np.sin(angle) + p2 * np.cos(angle), p1 * np.cos(angle) - p2 * np.sin(angle)
        determinant = np.polynomial.polynomial.polymul(
            [1, 6 * a, 3 * k1, 0, 5 * k2, 0, 7 * k3], [1, 2 * a, k1, 0, k2, 0, k3]
        )
        determinant[2] -= 4 * b * b
        # Reversed, it is a polynomial in 1 / t with the leading coefficient 1, so that none can be too small.
        inverse = np.roots(determinant)
        real = inverse.real[(abs(inverse.imag) <= 1e-7 * abs(inverse)) & (inverse.real > 1 / _MAX_TANGENT)]
        if real.size:
            radii[i] = 1 / real.max()
    return angles, radii


def _fold_radius(points: np.ndarray, lens: tuple[float, ...]) -> np.ndarray | float:
    """Return the radius of the fold in the direction of each of the (2, N) points."""
    angles, radii = _folds(lens)
    if len(radii) == 1:
        return float(radii[0])
    return np.interp(np.arctan2(points[1], points[0]), angles, radii, period=2 * np.pi)


def _undistort(points: np.ndarray, lens: tuple[float, ...], tolerance: float) -> int:
    """Undistort (2, N) x', y' in place and return the number of pixels clamped to the fold.

    Newton's method. A step is halved if it leaves the region where the lens is invertible or brings no improvement.
    Where the derivatives are regular some shorter step always improves, so only pixels beyond the fold stall.
    """
    nearest = _folds(lens)[1].min()
    with np.errstate(all="ignore"):
        edge = _fold_radius(points, lens)
        target = points.copy()
        points *= np.minimum(1, 0.5 * edge / np.maximum(np.hypot(*points), 1e-300))
        todo = np.arange(points.shape[1])
        at, value, step = points.copy(), _distort(points, lens), np.ones(points.shape[1])
        for _ in range(200):
            error = value[:2] - target[:, todo]
            size = np.hypot(*error)
            points[:, todo] = at
            going = (size > tolerance) & (step > 1e-9)
            if not going.all():
                todo, at, value, step = todo[going], at[:, going], value[:, going], step[going]
                error, size = error[:, going], size[going]
            if not todo.size:
                break
            xx, xy, yy = value[2:]
            move = np.stack([yy * error[0] - xy * error[1], xx * error[1] - xy * error[0]]) / (xx * yy - xy * xy)
            trial = at - step * move
            there = _distort(trial, lens)
            radius = np.hypot(*trial)
            better = np.hypot(*(there[:2] - target[:, todo])) < size
            if not (radius <= nearest).all():
                better &= radius <= _fold_radius(trial, lens)
            at, value = np.where(better, trial, at), np.where(better, there, value)
            step = np.where(better, np.minimum(1, 2 * step), step / 2)
        miss = _distort(points, lens)[:2] - target
        folded = ~(np.hypot(*miss) <= tolerance)
        if folded.any():
            angle = np.arctan2(target[1, folded], target[0, folded])
            clamped = np.broadcast_to(edge, folded.shape)[folded]
            points[:, folded] = clamped * np.cos(angle), clamped * np.sin(angle)
    return int(folded.sum())


def camera_rays(intrinsics: Intrinsics, c2w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the rays through all pixel centres.

    Args:
        intrinsics: the camera.
        c2w: (4, 4) camera-to-world.

    Returns:
        rays_o (H, W, 3) and rays_d (H, W, 3) in the world frame. ``rays_d`` is scaled to depth 1, so that
        ``rays_o + depth * rays_d`` is the point at that depth.

    Example:
        >>> o, d = camera_rays(Intrinsics.from_fov(2, 2), np.eye(4))
        >>> d[0, 0]
        array([-0.5,  0.5, -1. ])
    """
    rays_d = intrinsics.directions() @ c2w[:3, :3].T
    return np.broadcast_to(c2w[:3, 3], rays_d.shape), rays_d


def planar_pose(x: float, y: float, heading: float, height: float = CAMERA_HEIGHT) -> np.ndarray:
    """Return the (4, 4) camera-to-world pose of a level camera.

    Args:
        x: world x, metres.
        y: world y, metres.
        heading: viewing direction, radians.
        height: of the camera above the floor, metres.

    Example:
        >>> forward = -planar_pose(1, 2, 0.0)[:3, 2]
        >>> forward.round(6) + 0
        array([1., 0., 0.])
    """
    c, s = np.cos(heading), np.sin(heading)
    return np.array([[s, 0, -c, x], [-c, 0, -s, y], [0, 1, 0, height], [0, 0, 0, 1]], dtype=np.float64)


def planar_from_pose(c2w: np.ndarray) -> tuple[float, float, float]:
    """Return x, y (metres) and heading (radians) of a camera; inverse of :func:`planar_pose` for a level camera.

    Example:
        >>> [round(v, 6) for v in planar_from_pose(planar_pose(1, 2, 0.5))]
        [1.0, 2.0, 0.5]
    """
    return float(c2w[0, 3]), float(c2w[1, 3]), float(np.arctan2(-c2w[1, 2], -c2w[0, 2]))


def is_planar(poses: np.ndarray) -> bool:
    """Return True if (T, 4, 4) cameras differ only in x, y and a rotation about z, within 0.1 mm and 0.1 mrad.

    Example:
        >>> poses = np.stack([planar_pose(0, 0, 0), planar_pose(1, 2, 0.5)])
        >>> is_planar(poses)
        True
        >>> poses[1, 2, 3] += 0.01
        >>> is_planar(poses)
        False
    """
    fixed = poses[:, 2]  # height, and the direction of world z in the camera frame
    return bool((np.abs(fixed - fixed[:1]) < 1e-4).all())


def wrap_angle(angle: float) -> float:
    """Return the equivalent angle in [-pi, pi).

    Example:
        >>> round(wrap_angle(2 * np.pi + 0.25), 6)
        0.25
    """
    return float((angle + np.pi) % (2 * np.pi) - np.pi)


def world_to_cell(points: np.ndarray, origin: np.ndarray, cell: float) -> np.ndarray:
    """Convert world x, y to cells.

    Args:
        points: (..., 2 or more) world x, y, metres.
        origin: (2,) world x, y of the outer corner of cell [0, 0].
        cell: side of a cell, metres.

    Returns:
        (..., 2) int64 [row, column], not clipped to any grid.

    Example:
        >>> world_to_cell(np.array([0.12, 0.01]), np.zeros(2), 0.05)
        array([0, 2])
    """
    return np.floor((np.asarray(points)[..., :2] - origin) / cell).astype(np.int64)[..., ::-1]


def cell_to_world(cells: np.ndarray, origin: np.ndarray, cell: float) -> np.ndarray:
    """Convert (..., 2) cells [row, column] to the (..., 2) world x, y of their centres.

    Example:
        >>> cell_to_world(np.array([0, 2]), np.zeros(2), 0.5)
        array([1.25, 0.25])
    """
    return (np.asarray(cells)[..., ::-1] + 0.5) * cell + origin


def block_shares(cells: np.ndarray, block: int) -> np.ndarray:
    """Return the fraction of set cells in each square block.

    Args:
        cells: (C, M, M) bool.
        block: side of a block in cells; divides M.

    Returns:
        (C, G, G) float32, 0 to 1.

    Example:
        >>> block_shares(np.eye(4, dtype=bool)[None], 2)[0].tolist()
        [[0.5, 0.0], [0.0, 0.5]]
    """
    grid = cells.shape[1] // block
    # Sums of whole slices: a reduction over the short axes of a block takes ten times as long.
    blocks = cells.reshape(len(cells), grid, block, -1)
    rows = sum((blocks[:, :, k] for k in range(block)), np.uint16(0)).reshape(len(cells), grid, grid, block)
    counts = sum((rows[..., k] for k in range(block)), np.zeros(rows.shape[:-1], np.float32))
    return counts / np.float32(block**2)


def so3_exp(omega: np.ndarray) -> np.ndarray:
    """Return the (..., 3, 3) rotation matrices of (..., 3) rotation vectors in radians.

    Example:
        >>> so3_exp(np.array([0, 0, np.pi / 2])).round(6)[0] + 0
        array([ 0., -1.,  0.])
    """
    return Rotation.from_rotvec(omega).as_matrix()


def rotation_angle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the geodesic distances between the rotations of (..., 4, 4) poses, radians, shape (...).

    Example:
        >>> a, b = np.eye(4), np.eye(4)
        >>> b[:3, :3] = so3_exp(np.array([0, 1e-9, 0]))
        >>> round(float(rotation_angle(a, b)) * 1e9, 6)
        1.0
    """
    return Rotation.from_matrix(np.swapaxes(a[..., :3, :3], -1, -2) @ b[..., :3, :3]).magnitude()
