"""The true map of a scene: occupied, free and semantic columns of 1 cm between 0.10 m and the camera (section 4.3).

A column is *occupied* when a surface crosses the band above it and a robot could see that surface, *free* when no
surface crosses it and it is 4-connected to the floor a robot can stand on. The rest (inside walls and furniture,
outside the apartment) is *ignored*: it enters no score.

"Could see" is decided by rays. Surfaces are sampled every 7 mm and thinned to one sample for each column, class, third
of the band and side (of six) that it faces, the highest: a table is seen from above, not from below. A sample is
visible when the segment to one of 20 navigable camera positions (height 0.88 m) meets nothing before it. The 20 are
taken out of 600 seeded positions at the ranks 0, 1, 2, 4 ... 255 by distance, so that both near and far views are
tried. A column, or a class in a column, is visible when a sample of it or of one of its eight neighbours is.
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
from autonerf_lab.scenes.height_band import occupied_columns

if TYPE_CHECKING:
    from autonerf_lab.simulator import Simulator

CELL = 0.01  # metres
BAND = (0.10, CAMERA_HEIGHT)  # metres, the heights a map is about
MAX_CELLS = 15_000_000  # 1500 m2: maps and planning together take about 140 bytes a cell, so 2 GB

_POSITIONS = 600
_RANKS = (0, 1, 2, 3, 4, 6, 8, 11, 16, 23, 32, 45, 64, 80, 100, 128, 160, 181, 220, 255)
_COARSE = 10  # cells a side of the squares of columns that share their candidate positions
_SPACING = 0.007
_THIRDS = 3
_TOUCHING = 0.005  # metres, how exactly a ray must arrive


@dataclass(frozen=True)
class Grid:
    """A floor plan of square cells, indexed [row = y, column = x]."""

    origin: np.ndarray  # (2,) world x, y of the outer corner of cell [0, 0]
    shape: tuple[int, int]
    cell: float = CELL

    @classmethod
    def over(cls, bounds: np.ndarray, cell: float = CELL) -> "Grid":
        """The grid that covers (2, 3) bounds. Walls on whole centimetres fall in the middle of its cells.

        Raises:
            SceneError: the grid would not fit in memory.

        Example:
            >>> Grid.over(np.array([[0, 0, 0], [1, 2, 2.6]])).shape
            (205, 105)
        """
        size = np.ceil((bounds[1, :2] - bounds[0, :2]) / cell).astype(int) + 5
        if not np.all(np.isfinite(bounds)) or float(size[0]) * float(size[1]) > MAX_CELLS:
            raise SceneError(f"a scene of {bounds[1] - bounds[0]} m needs more than {MAX_CELLS} map cells of {cell} m")
        return cls(bounds[0, :2] - 2.5 * cell, (int(size[1]), int(size[0])), cell)

    def cells(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(N, >=2) world points -> (M, 2) cells of those inside, and (N,) bool which are inside."""
        cells = world_to_cell(points, self.origin, self.cell)
        inside = np.all((cells >= 0) & (cells < np.array(self.shape)), axis=1)
        return cells[inside], inside

    def centers(self, cells: np.ndarray) -> np.ndarray:
        """(N, 2) cells -> (N, 2) world x, y of their centres."""
        return cell_to_world(cells, self.origin, self.cell)


@dataclass(frozen=True)
class TrueMap:
    """What a perfect map would hold."""

    grid: Grid
    surface: np.ndarray  # (R, C) bool, any surface in the band, visible or not
    occupied: np.ndarray  # (R, C) bool, a surface a robot could see
    free: np.ndarray  # (R, C) bool
    semantics: np.ndarray  # (15, R, C) bool, channel k is class k + 1

    @property
    def scored(self) -> np.ndarray:
        """(R, C) bool: occupied or free; the rest is ignored."""
        return self.occupied | self.free

    @property
    def classes(self) -> list[int]:
        """Object classes that the map holds, 1 to 15."""
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
    """Write points on the triangles, at most one for each cell, third of the band and side that it faces.

    Returns how many there are; when ``points`` is too short the rest is only counted.
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


def _band_samples(triangles: np.ndarray, grid: Grid) -> np.ndarray:
    """(N, 3) points on (F, 3, 3) triangles within the band."""
    z = triangles[:, :, 2]
    highest = z.max(axis=1)
    inside = np.flatnonzero((highest >= BAND[0]) & (z.min(axis=1) <= BAND[1]))
    # The first sample of a column stays: from the top down it is the blanket, not the mattress under it
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


def visible_columns(sim: "Simulator", samples: list[np.ndarray], grid: Grid, positions: np.ndarray) -> np.ndarray:
    """Which columns hold a surface that some camera position sees? See the module's text for which ones are tried.

    Args:
        sim: casts the rays.
        samples: for each class (N, 3) points on its surfaces.
        grid: of the columns.
        positions: (P, 3) camera centres.

    Returns:
        (16, R, C) bool, grown by one cell.
    """
    points = np.concatenate(samples)
    owner = np.repeat(np.arange(len(samples)), [len(s) for s in samples])
    cells = world_to_cell(points, grid.origin, grid.cell)
    columns = (owner * grid.shape[0] + cells[:, 0]) * grid.shape[1] + cells[:, 1]
    coarse_shape = tuple(size // _COARSE + 1 for size in grid.shape)
    middles = (np.indices(coarse_shape).reshape(2, -1).T + 0.5) * _COARSE - 0.5
    ranks = [r for r in _RANKS if r < len(positions)]
    _, nearest = cKDTree(positions[:, :2]).query(grid.centers(middles), k=[r + 1 for r in ranks])
    coarse = (cells[:, 0] // _COARSE) * coarse_shape[1] + cells[:, 1] // _COARSE
    seen = np.zeros(len(samples) * grid.shape[0] * grid.shape[1], dtype=bool)
    for rank in range(len(ranks)):
        todo = np.flatnonzero(~seen[columns])
        origins = positions[nearest[coarse[todo], rank]]
        rays = points[todo] - origins
        hits = sim.cast(origins, rays)
        met = hits.t >= 1 - _TOUCHING / np.maximum(np.linalg.norm(rays, axis=1), 1e-9)
        seen[columns[todo[met]]] = True
    window = np.ones((1, 3, 3), dtype=bool)
    return ndimage.binary_dilation(seen.reshape(len(samples), *grid.shape), window)


def camera_positions(sim: "Simulator", count: int = _POSITIONS, seed: int = 0) -> np.ndarray:
    """(count, 3) seeded camera centres, uniform over the cells of the navigable floor."""
    navigation = sim.navigation
    cells = np.argwhere(navigation.navigable)
    cells = cells[np.random.default_rng(seed).integers(len(cells), size=count)]
    xy = cell_to_world(cells, navigation.origin, navigation.cell)
    return np.concatenate([xy, np.full((count, 1), CAMERA_HEIGHT)], axis=1)


def _build(sim: "Simulator") -> TrueMap:
    scene = sim.scene
    grid = Grid.over(scene.bounds)
    triangles = scene.vertices[scene.faces].astype(np.float64)

    def columns_of(faces: np.ndarray) -> np.ndarray:
        return occupied_columns(scene.vertices, faces, *BAND, grid.origin, grid.cell, grid.shape)

    positions = camera_positions(sim)
    samples = [_band_samples(triangles[scene.face_class == k], grid) for k in range(NUM_CLASSES)]
    seen = visible_columns(sim, samples, grid, positions)
    surface = columns_of(scene.faces)
    semantics = np.stack([columns_of(scene.faces[scene.face_class == k]) for k in range(1, NUM_CLASSES)]) & seen[1:]
    labels, _ = ndimage.label(~surface)
    cells, _ = grid.cells(positions)
    reachable = np.setdiff1d(np.unique(labels[cells[:, 0], cells[:, 1]]), [0])
    return TrueMap(grid, surface, surface & seen.any(axis=0), np.isin(labels, reachable), semantics)


_MAPS: dict[int, TrueMap] = {}  # by id of the scene: a scene never changes, and its map takes seconds


def true_map(sim: "Simulator") -> TrueMap:
    """The true map of the simulator's scene, made once for each scene object and dropped with it.

    Raises:
        SceneError: the scene is too large for a map.
    """
    key = id(sim.scene)
    if key not in _MAPS:
        _MAPS[key] = _build(sim)
        weakref.finalize(sim.scene, _MAPS.pop, key, None)
    return _MAPS[key]
