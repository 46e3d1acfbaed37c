"""Frames, cameras and grids: every convention of the project is stated here, once.

* World: right-handed, metres, z up, floor at z = 0.
* Camera: OpenGL, x right, y up, looks along -z. A pose is camera-to-world, (4, 4) float64.
* Heading: radians, counter-clockwise seen from above, 0 looks along world +x.
* Depth: along the optical axis, not along the ray.
* Image: row 0 at the top, pixel centres at half-integers.
* Grid: arrays are indexed [row, column] = [y, x]; ``origin`` is the world x, y of the outer corner of cell [0, 0].
"""

from dataclasses import dataclass

import numpy as np

CAMERA_HEIGHT = 0.88  # metres, facts of the paper's agent
AGENT_RADIUS = 0.18
FORWARD_STEP = 0.25
TURN_ANGLE = float(np.radians(30))


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole camera.

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

    @classmethod
    def from_fov(cls, width: int, height: int, hfov_deg: float = 90.0) -> "Intrinsics":
        """Square pixels, principal point in the middle."""
        # round() keeps 90 degrees exact: tan(pi / 4) is not 1 in floating point
        focal = round(width / 2 / float(np.tan(np.radians(hfov_deg) / 2)), 9)
        return cls(width, height, focal, focal, width / 2, height / 2)

    def resized(self, width: int, height: int) -> "Intrinsics":
        """The same camera with another number of pixels."""
        sx, sy = width / self.width, height / self.height
        return Intrinsics(width, height, self.fl_x * sx, self.fl_y * sy, self.cx * sx, self.cy * sy)

    def directions(self) -> np.ndarray:
        """(H, W, 3) float64 camera-frame directions through the pixel centres, scaled to depth 1 (z = -1)."""
        u, v = np.meshgrid(np.arange(self.width) + 0.5, np.arange(self.height) + 0.5)
        return np.stack([(u - self.cx) / self.fl_x, -(v - self.cy) / self.fl_y, -np.ones_like(u)], axis=-1)


def camera_rays(intrinsics: Intrinsics, c2w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rays through every pixel.

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
    """Camera-to-world pose of a level camera at (x, y) that looks along ``heading`` (radians).

    Example:
        >>> forward = -planar_pose(1, 2, 0.0)[:3, 2]
        >>> forward.round(6) + 0
        array([1., 0., 0.])
    """
    c, s = np.cos(heading), np.sin(heading)
    return np.array([[s, 0, -c, x], [-c, 0, -s, y], [0, 1, 0, height], [0, 0, 0, 1]], dtype=np.float64)


def planar_from_pose(c2w: np.ndarray) -> tuple[float, float, float]:
    """(x, y, heading) of a camera, the inverse of :func:`planar_pose` for a level one.

    Example:
        >>> [round(v, 6) for v in planar_from_pose(planar_pose(1, 2, 0.5))]
        [1.0, 2.0, 0.5]
    """
    return float(c2w[0, 3]), float(c2w[1, 3]), float(np.arctan2(-c2w[1, 2], -c2w[0, 2]))


def wrap_angle(angle: float) -> float:
    """The same angle in [-pi, pi).

    Example:
        >>> round(wrap_angle(2 * np.pi + 0.25), 6)
        0.25
    """
    return float((angle + np.pi) % (2 * np.pi) - np.pi)


def world_to_cell(points: np.ndarray, origin: np.ndarray, cell: float) -> np.ndarray:
    """(..., 2) world x, y -> (..., 2) integer [row, column]. Not clipped to any grid.

    Example:
        >>> world_to_cell(np.array([0.12, 0.01]), np.zeros(2), 0.05)
        array([0, 2])
    """
    return np.floor((np.asarray(points)[..., :2] - origin) / cell).astype(np.int64)[..., ::-1]


def cell_to_world(cells: np.ndarray, origin: np.ndarray, cell: float) -> np.ndarray:
    """(..., 2) [row, column] -> (..., 2) world x, y of the cell centres.

    Example:
        >>> cell_to_world(np.array([0, 2]), np.zeros(2), 0.5)
        array([1.25, 0.25])
    """
    return (np.asarray(cells)[..., ::-1] + 0.5) * cell + origin


def skew(v: np.ndarray) -> np.ndarray:
    """(3,) -> (3, 3) cross-product matrix."""
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def so3_exp(omega: np.ndarray) -> np.ndarray:
    """Rotation matrix of a rotation vector (radians), Rodrigues' formula.

    Example:
        >>> so3_exp(np.array([0, 0, np.pi / 2])).round(6)[0] + 0
        array([ 0., -1.,  0.])
    """
    angle = float(np.linalg.norm(omega))
    k = skew(omega)
    if angle < 1e-8:
        return np.eye(3) + k + k @ k / 2
    return np.eye(3) + np.sin(angle) / angle * k + (1 - np.cos(angle)) / angle**2 * (k @ k)


def rotation_angle(a: np.ndarray, b: np.ndarray) -> float:
    """Geodesic distance between two rotations, radians.

    Computed from the sine and the cosine, because arccos alone loses half the digits near zero.

    Example:
        >>> round(rotation_angle(np.eye(3), so3_exp(np.array([0, 1e-9, 0]))) * 1e9, 6)
        1.0
    """
    r = a[:3, :3].T @ b[:3, :3]
    sine = np.linalg.norm([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]]) / 2
    return float(np.arctan2(sine, (np.trace(r) - 1) / 2))
