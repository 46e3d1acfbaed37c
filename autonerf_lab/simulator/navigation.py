"""Navigable floor of a scene, and motion of the robot along obstacles.

The robot is a disc. On a grid of distances to the nearest obstacle, the disc fits where the distance is at least its
radius, and the gradient of the distance is the direction in which an obstacle pushes it. The robot drives on level
floor and, because reconstructed floors are uneven, through dips and over bumps up to the limits of Habitat's navigation
meshes (``agent_max_climb``, ``agent_max_slope``). Steps stop it.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy import ndimage

from autonerf_lab.errors import SceneError
from autonerf_lab.geometry import AGENT_RADIUS, cell_to_world
from autonerf_lab.scenes.height_band import occupied_cells
from autonerf_lab.scenes.scene import Scene

CELL = 0.025  # metres, side of a cell
BODY = (0.05, 1.0)  # metres above the floor, height range of obstacles
CLIMB = 0.2  # metres, largest deviation of the floor from z = 0
_SLOPE = np.cos(np.deg2rad(45))  # cosine of the steepest slope
_SPAN = 0.25  # metres, widest gap in the floor that the robot crosses
_MARGIN = 0.2  # metres around the scene, so that every obstacle has a cell on its far side
_SUBSTEP = 0.01  # metres, step of the collision test
_MAX_SIDE = 8000  # cells, 200 m
_BLOCK = 1 << 18  # faces at once: bounds the memory for a large mesh


@dataclass(frozen=True, eq=False)
class NavigationGrid:
    """Navigable floor of a scene for a disc-shaped robot, as a grid indexed [row = y, column = x]."""

    navigable: np.ndarray  # (rows, cols) bool, positions of the disc's centre; one connected region
    distance: np.ndarray  # (rows, cols) float64, metres from the cell centre to the nearest obstacle
    origin: np.ndarray  # (2,) world x, y of the outer corner of cell [0, 0]
    cell: float  # side of a cell, metres
    radius: float  # of the robot, metres

    def is_navigable(self, x: float, y: float) -> bool:
        """Return True if the robot fits with its centre at world (x, y), metres."""
        return bool(_distance_at(self.distance, self.origin, self.cell, float(x), float(y)) >= self.radius)

    def sample(self, rng: np.random.Generator) -> tuple[float, float]:
        """Sample a world position (x, y), metres, uniformly over the navigable floor."""
        cells = np.argwhere(self.navigable)
        cell = cells[rng.integers(len(cells))]
        centre = cell_to_world(cell, self.origin, self.cell)
        point = centre + (rng.random(2) - 0.5) * self.cell
        x, y = point if self.is_navigable(point[0], point[1]) else centre  # a cell centre is always navigable
        return float(x), float(y)

    def move(self, x: float, y: float, dx: float, dy: float) -> tuple[float, float]:
        """Move by (dx, dy) and slide along obstacles.

        Args:
            x: World x of the robot, metres.
            y: World y of the robot, metres.
            dx: Commanded motion along world x, metres.
            dy: Commanded motion along world y, metres.

        Returns:
            World x, y of a position where the robot fits.
        """
        return _slide(self.distance, self.origin, self.cell, self.radius, x, y, dx, dy)

    @property
    def area(self) -> float:
        """Navigable area, m2."""
        return float(self.navigable.sum() * self.cell**2)


def build_navigation(scene: Scene, radius: float = AGENT_RADIUS) -> NavigationGrid:
    """Build the navigation grid of a scene: the largest connected floor region for a disc.

    Args:
        scene: Scene with its floor at z = 0.
        radius: Radius of the robot, metres.

    Raises:
        SceneError: The scene is too large, has no floor, or the robot fits nowhere on it.

    Example:
        >>> from autonerf_lab.scenes import load_scene
        >>> grid = build_navigation(load_scene("train-04"))
        >>> grid.is_navigable(*grid.sample(np.random.default_rng(0)))
        True
    """
    low, high = scene.bounds[0, :2] - _MARGIN, scene.bounds[1, :2] + _MARGIN
    shape = (int(np.ceil((high[1] - low[1]) / CELL)), int(np.ceil((high[0] - low[0]) / CELL)))
    if max(shape) > _MAX_SIDE:
        raise SceneError(
            f"scene {scene.name!r} is {(high - low).max():.0f} m long, the limit is {_MAX_SIDE * CELL:.0f} m;"
            " scale it to metres"
        )
    level = np.concatenate(
        [_is_level(scene, scene.faces[i : i + _BLOCK]) for i in range(0, max(1, len(scene.faces)), _BLOCK)]
    )

    def cells_between(faces: np.ndarray, z_min: float, z_max: float) -> np.ndarray:
        return occupied_cells(scene.vertices, scene.faces[faces], z_min, z_max, low, CELL, shape)

    floor = cells_between(level, -CLIMB, CLIMB)
    if not floor.any():
        raise SceneError(f"scene {scene.name!r} has no floor: there is no level surface within {CLIMB} m of z = 0")
    # Close small gaps: scans have holes, and there are thin gaps between the floors of rooms.
    reach = round(_SPAN / 2 / CELL)
    floor |= ndimage.binary_closing(np.pad(floor, reach), iterations=reach)[reach:-reach, reach:-reach]
    free = floor & ~cells_between(~level, *BODY) & ~cells_between(level, CLIMB, BODY[1])
    # Keep raised floor only if it is connected to the floor around it: a bump is, the top of a low box is not.
    pieces, _ = ndimage.label(free)
    free &= np.isin(pieces, np.unique(pieces[free & ~cells_between(level, BODY[0], CLIMB)]))
    # Distance to the edge of the obstacle's cell instead of its centre: the disc then never touches the obstacle.
    distance = np.maximum(ndimage.distance_transform_edt(np.pad(free, 1))[1:-1, 1:-1] * CELL - CELL / 2, 0)
    regions, count = ndimage.label(distance >= radius)
    if count == 0:
        raise SceneError(f"scene {scene.name!r} has no floor area for a robot of {radius} m radius")
    largest = 1 + int(np.argmax(np.bincount(regions.ravel())[1:]))
    return NavigationGrid(regions == largest, distance, low, CELL, radius)


def _is_level(scene: Scene, faces: np.ndarray) -> np.ndarray:
    """Return (F,) bool: the faces on whose slope the robot can drive."""
    triangles = scene.vertices[faces].astype(np.float64)
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    level: np.ndarray = np.abs(normals[:, 2]) > _SLOPE * np.linalg.norm(normals, axis=1)
    return level


@njit(cache=True)
def _distance_at(distance: np.ndarray, origin: np.ndarray, cell: float, x: float, y: float) -> float:
    """Interpolate the distance bilinearly between cell centres; 0 outside the grid."""
    gx, gy = (x - origin[0]) / cell - 0.5, (y - origin[1]) / cell - 0.5
    c, r = int(np.floor(gx)), int(np.floor(gy))
    if c < 0 or r < 0 or c + 1 >= distance.shape[1] or r + 1 >= distance.shape[0]:
        return 0.0
    fx, fy = gx - c, gy - r
    upper = distance[r, c] * (1 - fx) + distance[r, c + 1] * fx
    lower = distance[r + 1, c] * (1 - fx) + distance[r + 1, c + 1] * fx
    return upper * (1 - fy) + lower * fy


@njit(cache=True)
def _slide(
    distance: np.ndarray, origin: np.ndarray, cell: float, radius: float, x: float, y: float, dx: float, dy: float
) -> tuple[float, float]:
    """Move in small steps; push the disc out of obstacles along the distance gradient."""
    count = int(np.ceil(np.sqrt(dx * dx + dy * dy) / _SUBSTEP))
    for _ in range(count):
        nx, ny = x + dx / count, y + dy / count
        for _ in range(5):
            d = _distance_at(distance, origin, cell, nx, ny)
            if d >= radius:
                break
            h = cell / 2
            gx = _distance_at(distance, origin, cell, nx + h, ny) - _distance_at(distance, origin, cell, nx - h, ny)
            gy = _distance_at(distance, origin, cell, nx, ny + h) - _distance_at(distance, origin, cell, nx, ny - h)
            norm = np.sqrt(gx * gx + gy * gy)
            if norm == 0.0:
                break
            push = radius - d + 1e-4
            nx, ny = nx + push * gx / norm, ny + push * gy / norm
        # The robot is pushed back or stuck in a corner.
        if _distance_at(distance, origin, cell, nx, ny) < radius or (nx - x) * dx + (ny - y) * dy <= 0.0:
            break
        x, y = nx, ny
    return x, y
