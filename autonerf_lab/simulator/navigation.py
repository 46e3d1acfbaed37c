"""Where the robot can stand, and how it slides along what it bumps into.

The robot is a disc. A grid of distances to the nearest obstacle makes both questions easy: the disc fits where the
distance is at least its radius, and the gradient of the distance says which way an obstacle pushes it. It drives on
what is level, and, since reconstructed floors sag and bulge, through dips and over bumps: as deep, as high and as steep
as Habitat's navigation meshes let its robots climb (``agent_max_climb``, ``agent_max_slope``). A step stops it.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy import ndimage

from autonerf_lab.errors import SceneError
from autonerf_lab.geometry import AGENT_RADIUS, cell_to_world
from autonerf_lab.scenes.height_band import occupied_columns
from autonerf_lab.scenes.scene import Scene

CELL = 0.025  # metres
BODY = (0.05, 1.0)  # metres above the floor: lower things are driven over, higher ones passed under
CLIMB = 0.2  # metres above and below z = 0 that floors may reach
_SLOPE = np.cos(np.deg2rad(45))  # the steepest
_SPAN = 0.25  # metres of floor that may be missing, two thirds of the robot
_MARGIN = 0.2  # metres around the scene, so that every obstacle has a cell on its far side
_SUBSTEP = 0.01
_MAX_SIDE = 8000  # cells, 200 m


@dataclass(frozen=True, eq=False)
class NavigationGrid:
    """The free ground of a scene, for a disc of radius ``radius``."""

    navigable: np.ndarray  # (rows, cols) bool: the centre of the disc may be here; one connected region
    distance: np.ndarray  # (rows, cols) float64, metres from the cell centre to the nearest obstacle
    origin: np.ndarray  # (2,) world x, y of the outer corner of cell [0, 0]
    cell: float
    radius: float

    def is_navigable(self, x: float, y: float) -> bool:
        """Can the robot stand with its centre at world (x, y)?"""
        return bool(_distance_at(self.distance, self.origin, self.cell, float(x), float(y)) >= self.radius)

    def sample(self, rng: np.random.Generator) -> tuple[float, float]:
        """World x, y, uniform over the navigable ground."""
        cells = np.argwhere(self.navigable)
        cell = cells[rng.integers(len(cells))]
        centre = cell_to_world(cell, self.origin, self.cell)
        point = centre + (rng.random(2) - 0.5) * self.cell
        x, y = point if self.is_navigable(point[0], point[1]) else centre  # cell centres are exact
        return float(x), float(y)

    def move(self, x: float, y: float, dx: float, dy: float) -> tuple[float, float]:
        """Try to move by (dx, dy), sliding along obstacles; never ends where the robot does not fit."""
        return _slide(self.distance, self.origin, self.cell, self.radius, x, y, dx, dy)

    @property
    def area(self) -> float:
        """Navigable area, square metres."""
        return float(self.navigable.sum() * self.cell**2)


def build_navigation(scene: Scene, radius: float = AGENT_RADIUS) -> NavigationGrid:
    """The navigation grid of a scene: its largest region of floor on which the disc fits.

    Raises:
        SceneError: there is no floor, or nowhere on it does the robot fit.
    """
    low, high = scene.bounds[0, :2] - _MARGIN, scene.bounds[1, :2] + _MARGIN
    shape = (int(np.ceil((high[1] - low[1]) / CELL)), int(np.ceil((high[0] - low[0]) / CELL)))
    if max(shape) > _MAX_SIDE:
        raise SceneError(f"scene {scene.name!r} is {(high - low).max():.0f} m long; is it in metres?")
    triangles = scene.vertices[scene.faces].astype(np.float64)
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    level = np.abs(normals[:, 2]) > _SLOPE * np.linalg.norm(normals, axis=1)

    def columns(faces: np.ndarray, z_min: float, z_max: float) -> np.ndarray:
        return occupied_columns(scene.vertices, scene.faces[faces], z_min, z_max, low, CELL, shape)

    floor = columns(level, -CLIMB, CLIMB)
    if not floor.any():
        raise SceneError(f"scene {scene.name!r} has no floor: no level surface within {CLIMB} m of z = 0")
    # Scans have holes and rooms meet with a hair between their floors: what the robot spans does not stop it.
    reach = round(_SPAN / 2 / CELL)
    floor |= ndimage.binary_closing(np.pad(floor, reach), iterations=reach)[reach:-reach, reach:-reach]
    free = floor & ~columns(~level, *BODY) & ~columns(level, CLIMB, BODY[1])
    # A bump is driven over from the floor around it; the top of a low box has steep sides all round.
    pieces, _ = ndimage.label(free)
    free &= np.isin(pieces, np.unique(pieces[free & ~columns(level, BODY[0], CLIMB)]))
    # To the edge of the obstacle's cell, not to its centre: the disc then never touches the obstacle itself.
    distance = np.maximum(ndimage.distance_transform_edt(np.pad(free, 1))[1:-1, 1:-1] * CELL - CELL / 2, 0)
    regions, count = ndimage.label(distance >= radius)
    if count == 0:
        raise SceneError(f"scene {scene.name!r} has nowhere to stand for a robot of {radius} m radius")
    largest = 1 + int(np.argmax(np.bincount(regions.ravel())[1:]))
    return NavigationGrid(regions == largest, distance, low, CELL, radius)


@njit(cache=True)
def _distance_at(distance: np.ndarray, origin: np.ndarray, cell: float, x: float, y: float) -> float:
    """Bilinear between cell centres, 0 outside the grid."""
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
        # Pushed back or held in a corner: this obstacle does not let the robot past.
        if _distance_at(distance, origin, cell, nx, ny) < radius or (nx - x) * dx + (ny - y) * dy <= 0.0:
            break
        x, y = nx, ny
    return x, y
