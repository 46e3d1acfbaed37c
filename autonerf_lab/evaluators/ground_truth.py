"""Ground-truth map of a scene: occupied, free and semantic cells of 1 cm (section 4.3).

A map cell stands for the height band from 0.10 m to the camera height above it. A cell is *occupied* if a surface that
a robot can see crosses its height band. It is *free* if no surface crosses its height band and it is 4-connected to the
floor on which a robot can stand. All other cells (inside walls and furniture, outside the apartment) are *ignored*:
they enter no score.

Ray casting decides what a robot can see. Surfaces are sampled every 7 mm. One sample, the highest, is kept for each
map cell, class, third of the height band and facing direction (of six): a table is seen from above. A sample is visible
if the segment to one of 20 navigable camera positions (height 0.88 m) is not blocked. The 20 positions are chosen from
600 seeded positions (more in a house), at the ranks 0, 1, 2, 3, 4, 6 ... 255 by distance, so that near and far views
are tried. A cell, or a class in a cell, is visible if a sample in it or in one of its eight neighbours is visible.
"""

import weakref
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numba import njit
from scipy import ndimage
from scipy.spatial import cKDTree

from autonerf_lab.classes import NUM_CLASSES
from autonerf_lab.errors import SceneError
from autonerf_lab.geometry import CAMERA_HEIGHT, cell_to_world, world_to_cell
from autonerf_lab.scenes.height_band import occupied_cells

if TYPE_CHECKING:
    from autonerf_lab.scenes.scene import Scene
    from autonerf_lab.simulator import Simulator

CELL = 0.01  # metres
BAND = (0.10, CAMERA_HEIGHT)  # height band of a map cell, metres above the floor
MAX_CELLS = 15_000_000  # 1500 m2: maps and planning need about 140 bytes per cell, so 2 GB

_POSITIONS = 600  # at least; more in a house, so that no room is left out
_POSITIONS_PER_M2 = 9
_RANKS = (0, 1, 2, 3, 4, 6, 8, 11, 16, 23, 32, 45, 64, 80, 100, 128, 160, 181, 220, 255)
_COARSE = 10  # side of the blocks of cells that share their candidate positions, in cells
_SPACING = 0.007
_THIRDS = 3
_TOUCHING = 0.005  # metres, tolerance for the end of a ray


@dataclass(frozen=True)
class MapGrid:
    """Geometry of a map: square cells, indexed [row = y, column = x]."""

    origin: np.ndarray  # (2,) world x, y of the outer corner of cell [0, 0]
    shape: tuple[int, int]
    cell: float = CELL  # side of a cell, metres

    @classmethod
    def over(cls, bounds: np.ndarray, cell: float = CELL) -> "MapGrid":
        """Return the grid that covers (2, 3) bounds. Walls on whole centimetres lie in the centre of its cells.

        Raises:
            SceneError: the grid does not fit in memory.

        Example:
            >>> MapGrid.over(np.array([[0, 0, 0], [1, 2, 2.6]])).shape
            (205, 105)
        """
        size = np.ceil((bounds[1, :2] - bounds[0, :2]) / cell).astype(int) + 5
        if not np.all(np.isfinite(bounds)) or float(size[0]) * float(size[1]) > MAX_CELLS:
            raise SceneError(f"a scene of {bounds[1] - bounds[0]} m needs more than {MAX_CELLS} map cells of {cell} m")
        return cls(bounds[0, :2] - 2.5 * cell, (int(size[1]), int(size[0])), cell)

    def cells(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the (M, 2) cells of the points inside the grid, and an (N,) bool mask of these points.

        Args:
            points: (N, 2) or (N, 3) world points, metres.
        """
        cells = world_to_cell(points, self.origin, self.cell)
        inside = np.all((cells >= 0) & (cells < np.array(self.shape)), axis=1)
        return cells[inside], inside

    def centers(self, cells: np.ndarray) -> np.ndarray:
        """Return the (N, 2) world x, y of the centres of (N, 2) cells, metres."""
        return cell_to_world(cells, self.origin, self.cell)


@dataclass(frozen=True)
class TrueMap:
    """Ground-truth map of a scene."""

    grid: MapGrid
    surface: np.ndarray  # (R, C) bool, any surface in the height band, visible or not
    occupied: np.ndarray  # (R, C) bool, a surface that a robot can see
    free: np.ndarray  # (R, C) bool, no surface, and connected to the navigable floor
    semantics: np.ndarray  # (15, R, C) bool, channel k is class k + 1

    @property
    def scored(self) -> np.ndarray:
        """(R, C) bool mask of the cells that are occupied or free; the others are ignored."""
        return self.occupied | self.free

    @property
    def classes(self) -> list[int]:
        """Object classes in the map, 1 to 15."""
        return [k + 1 for k in range(NUM_CLASSES - 1) if self.semantics[k].any()]


@njit(cache=True)
def _sample_band(
    triangles: np.ndarray,
    facing: np.ndarray,
    steps: np.ndarray,
    band: tuple[float, float],
    frame: tuple[float, float, float],
    taken: np.ndarray,
    points: np.ndarray,
) -> int:
    """Write points on the triangles, at most one per cell, third of the height band and facing direction.

    Returns the number of points; if ``points`` is too short, further points are only counted.
    """
    count = 0
    for f in range(triangles.shape[0]):
        n1, n2 = steps[f, 0], steps[f, 1]
        for i in range(n1):
            u = (i + 0.35) / n1
            for j in range(n2):
                v = (j + 0.35) / n2
                w = 1 - u - v
                if w < 0:
                    break
                z = w * triangles[f, 0, 2] + u * triangles[f, 1, 2] + v * triangles[f, 2, 2]
                if z < band[0] or z > band[1]:
                    continue
                x = w * triangles[f, 0, 0] + u * triangles[f, 1, 0] + v * triangles[f, 2, 0]
                y = w * triangles[f, 0, 1] + u * triangles[f, 1, 1] + v * triangles[f, 2, 1]
                row, col = int((y - frame[1]) / frame[2]), int((x - frame[0]) / frame[2])
                third = min(_THIRDS - 1, int((z - band[0]) / (band[1] - band[0]) * _THIRDS))
                if row < 0 or col < 0 or row >= taken.shape[0] or col >= taken.shape[1]:
                    continue
                if taken[row, col, third, facing[f]]:
                    continue
                taken[row, col, third, facing[f]] = True
                if count < points.shape[0]:
                    points[count, 0], points[count, 1], points[count, 2] = x, y, z
                count += 1
    return count


def _band_samples(triangles: np.ndarray, grid: MapGrid) -> np.ndarray:
    """Return (N, 3) points on (F, 3, 3) triangles within the height band."""
    z = triangles[:, :, 2]
    highest = z.max(axis=1)
    inside = np.flatnonzero((highest >= BAND[0]) & (z.min(axis=1) <= BAND[1]))
    # The first sample of a cell is kept. From the top down, this is the blanket and not the mattress under it.
    triangles = triangles[inside[np.argsort(-highest[inside], kind="stable")]]
    edges = triangles[:, 1:] - triangles[:, :1]
    steps = (np.linalg.norm(edges, axis=2) / _SPACING).astype(np.int64) + 1
    normal = np.cross(edges[:, 0], edges[:, 1])
    axis = np.abs(normal).argmax(axis=1)
    facing = 2 * axis + (np.take_along_axis(normal, axis[:, None], axis=1)[:, 0] > 0)
    frame = (float(grid.origin[0]), float(grid.origin[1]), grid.cell)
    points = np.empty((min(int(steps.prod(axis=1).sum()), 3 * grid.shape[0] * grid.shape[1]), 3))
    taken = np.zeros((*grid.shape, _THIRDS, 6), dtype=np.bool_)
    count = _sample_band(triangles, facing, steps, BAND, frame, taken, points)
    return points[: min(count, len(points))].copy()


def visible_cells(sim: "Simulator", samples: list[np.ndarray], grid: MapGrid, positions: np.ndarray) -> np.ndarray:
    """Find the map cells with a surface that is visible from a camera position (see the module docstring).

    Args:
        sim: simulator of the scene, which casts the rays.
        samples: for each class, (N, 3) points on its surfaces.
        grid: of the map cells.
        positions: (P, 3) camera centres.

    Returns:
        (16, R, C) bool for each class, dilated by one cell.
    """
    points = np.concatenate(samples)
    owner = np.repeat(np.arange(len(samples)), [len(s) for s in samples])
    cells = world_to_cell(points, grid.origin, grid.cell)
    index = (owner * grid.shape[0] + cells[:, 0]) * grid.shape[1] + cells[:, 1]
    coarse_shape = tuple(size // _COARSE + 1 for size in grid.shape)
    middles = (np.indices(coarse_shape).reshape(2, -1).T + 0.5) * _COARSE - 0.5
    ranks = [r for r in _RANKS if r < len(positions)]
    _, nearest = cKDTree(positions[:, :2]).query(grid.centers(middles), k=[r + 1 for r in ranks])
    coarse = (cells[:, 0] // _COARSE) * coarse_shape[1] + cells[:, 1] // _COARSE
    seen = np.zeros(len(samples) * grid.shape[0] * grid.shape[1], dtype=bool)
    for rank in range(len(ranks)):
        todo = np.flatnonzero(~seen[index])
        origins = positions[nearest[coarse[todo], rank]]
        rays = points[todo] - origins
        hits = sim.cast(origins, rays)
        met = hits.t >= 1 - _TOUCHING / np.maximum(np.linalg.norm(rays, axis=1), 1e-9)
        seen[index[todo[met]]] = True
    window = np.ones((1, 3, 3), dtype=bool)
    return ndimage.binary_dilation(seen.reshape(len(samples), *grid.shape), window)


def faces_of_the_floor(scene: "Scene") -> np.ndarray:
    """Return (F,) bool: the faces that belong to the floor on which the robot is, without those of a floor above it."""
    levels = [room["z"] for room in (scene.spec or {}).get("rooms", []) if room.get("z")]
    if not levels:
        return np.ones(len(scene.faces), dtype=bool)
    below: np.ndarray = scene.vertices[scene.faces, 2].min(axis=1) < min(levels) - _TOUCHING
    return below


def camera_positions(sim: "Simulator") -> np.ndarray:
    """Sample (N, 3) camera centres, uniform over the cells of the navigable floor; at least 600."""
    navigation = sim.navigation
    count = max(_POSITIONS, round(_POSITIONS_PER_M2 * navigation.area))
    cells = np.argwhere(navigation.navigable)
    cells = cells[np.random.default_rng(0).integers(len(cells), size=count)]
    xy = cell_to_world(cells, navigation.origin, navigation.cell)
    return np.concatenate([xy, np.full((count, 1), CAMERA_HEIGHT)], axis=1)


def _build(sim: "Simulator") -> TrueMap:
    scene = sim.scene
    grid = MapGrid.over(scene.bounds)
    triangles = scene.vertices[scene.faces].astype(np.float64)

    def cells_of(faces: np.ndarray) -> np.ndarray:
        return occupied_cells(scene.vertices, faces, *BAND, grid.origin, grid.cell, grid.shape)

    positions = camera_positions(sim)
    samples = [_band_samples(triangles[scene.face_class == k], grid) for k in range(NUM_CLASSES)]
    seen = visible_cells(sim, samples, grid, positions)
    surface = cells_of(scene.faces)
    semantics = np.stack([cells_of(scene.faces[scene.face_class == k]) for k in range(1, NUM_CLASSES)]) & seen[1:]
    labels, _ = ndimage.label(~surface)
    cells, _ = grid.cells(positions)
    reachable = np.setdiff1d(np.unique(labels[cells[:, 0], cells[:, 1]]), [0])
    return TrueMap(grid, surface, surface & seen.any(axis=0), np.isin(labels, reachable), semantics)


_MAPS: dict[int, TrueMap] = {}  # by id of the scene: a scene never changes, and building its map takes seconds


def true_map(sim: "Simulator") -> TrueMap:
    """Return the ground-truth map of the simulator's scene, cached as long as the scene object exists.

    Raises:
        SceneError: the scene is too large for a map.
    """
    key = id(sim.scene)
    if key not in _MAPS:
        _MAPS[key] = _build(sim)
        weakref.finalize(sim.scene, _MAPS.pop, key, None)
    return _MAPS[key]
