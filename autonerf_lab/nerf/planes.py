"""Planes of a half-trained field: depth that a field can learn from, because rooms are made of flat surfaces.

Colours leave the depth of walls and ceilings without texture open: they bulge, and haze fills corners. The median over
a whole wall is much closer to the truth than its points. As in Manhattan-SDF (Guo et al. 2022), surfaces are assumed to
be horizontal, or vertical with two headings at a right angle (the Manhattan-world assumption of Coughlan and Yuille
1999). But the planes are found in the field itself, and no network predicts which pixels show a wall.

Lengths in metres; the world has z up.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from autonerf_lab.nerf.model import Model
from autonerf_lab.nerf.pixel_sampler import PixelSampler
from autonerf_lab.nerf.ray_batch import NO_DEPTH

STEEPEST = 0.85  # smallest cosine of the angle between the normals of a point and of its plane
START = 0.6  # share of the training after which planes are looked for
VIEWS = 250  # largest number of views in which they are
PER_VIEW = 40  # rays of a view, in each direction
BIN = 0.01  # of the histogram of positions along a normal
SMOOTHING = 0.03  # standard deviation of the smoothed histogram
THICKNESS = 0.05  # largest distance of a point from its plane
CELL = 0.2  # side of the cells that a plane covers
MIN_AREA = 0.25  # m², of a plane
GROWTH = 1  # cells around those that a plane covers, which it may cover, too
HIDDEN = 0.5  # metres in front of a larger plane of the same colours, where a plane is an error of the field
SIMILARITY = 0.3  # smallest common share of two colour histograms
FRONT, BACK = 0.2, 0.4  # range of the depth of a plane from that of the field: fields err towards the camera


@dataclass(frozen=True)
class Plane:
    """A connected part of a plane, in coordinates turned to the headings of the walls."""

    axis: int  # of its normal
    side: int  # 1: its normal points along the axis, -1: against it
    offset: float  # coordinate on the axis
    first: np.ndarray  # (2,) int64 index of the first cell
    cells: np.ndarray  # (U, V) bool, which cells of CELL a side it may cover
    seen: np.ndarray  # (N, 2) int64 indices of the cells where it was seen
    colors: np.ndarray  # (4096,) shares of the colours

    def covers(self, cells: np.ndarray) -> np.ndarray:
        """Return (N,) bool for (N, 2) int64 indices of cells."""
        inside = cells - self.first
        known = ((inside >= 0) & (inside < self.cells.shape)).all(axis=1)
        inside[~known] = 0
        return known & self.cells[inside[:, 0], inside[:, 1]]

    def hides(self, other: "Plane") -> bool:
        """Return whether this plane is haze in front of a larger plane of the same colours."""
        if (self.axis, self.side) != (other.axis, other.side) or len(self.seen) >= len(other.seen):
            return False
        if not 0 < self.side * (self.offset - other.offset) < HIDDEN:
            return False
        similar = np.minimum(self.colors, other.colors).sum() >= SIMILARITY
        return bool(similar and 2 * other.covers(self.seen).sum() >= len(self.seen))


def planar_pixels(model: Model, pixels: PixelSampler) -> dict[str, np.ndarray]:
    """Return the pixels that show planes of a half-trained field, and the depth of these planes.

    Args:
        model: the field.
        pixels: those of images of one size, in metres. Pixels of objects and with known depth are left out.

    Returns:
        The arguments of :meth:`~autonerf_lab.nerf.pixel_sampler.PixelSampler.learn_planes`.
    """
    chosen = pixels.grid(VIEWS, PER_VIEW)
    flat = chosen.ravel()
    rays = pixels.rays(flat)
    if model.pose_offsets is not None:
        rays = model.pose_offsets.apply(rays)
    depth = model.render_rays(rays.origins, rays.directions)[2].reshape(chosen.shape)
    length = pixels.length(flat).reshape(chosen.shape)
    directions = rays.directions.reshape(*chosen.shape, 3) * length[..., None]
    finite = np.isfinite(depth)
    depth = np.where(finite, depth, np.float32(0))
    usable = pixels.used(flat).reshape(chosen.shape) & finite
    if pixels.labels is not None:
        usable &= pixels.labels[chosen] == 0
    if pixels.depth is not None:
        usable &= pixels.depth[chosen] == NO_DEPTH
    origins = rays.origins.reshape(*chosen.shape, 3)[:, 0, 0]
    found = planar_depth(depth / length, origins, directions, pixels.rgb[chosen], usable)
    return {"pixels": chosen[found > 0], "depth": found[found > 0]}


def planar_depth(
    depth: np.ndarray, origins: np.ndarray, rays: np.ndarray, colors: np.ndarray, usable: np.ndarray
) -> np.ndarray:
    """Return the depths of the planes near what a field shows.

    Args:
        depth: (T, H, W) depths of the field in T views.
        origins: (T, 3) camera centres.
        rays: (T, H, W, 3) directions of depth 1 in the world.
        colors: (T, H, W, 3) uint8.
        usable: (T, H, W) bool; other pixels have no plane.

    Returns:
        (T, H, W) float32; 0 for pixels without a plane.
    """
    points = origins[:, None, None] + depth[..., None] * rays
    normals = _normals(points, rays)
    found = usable & normals.any(axis=-1)
    turn = _heading(normals[found])
    turned = points @ turn
    planes = find_planes(turned[found], normals[found] @ turn, colors[found])
    planes = [plane for plane in planes if not any(plane.hides(other) for other in planes)]
    result = np.zeros(depth.shape, np.float32)
    result[usable] = _nearest_planes(planes, turned[usable], rays[usable] @ turn, depth[usable])
    return result


def find_planes(points: np.ndarray, normals: np.ndarray, colors: np.ndarray) -> list[Plane]:
    """Return the planes whose normals are along an axis.

    Args:
        points: (N, 3).
        normals: (N, 3) unit, facing the camera.
        colors: (N, 3) uint8.

    Example:
        >>> wall = np.stack(np.meshgrid(np.linspace(0, 2, 40), np.linspace(0, 1, 20)), axis=-1).reshape(-1, 2)
        >>> points = np.insert(wall, 1, 0.7, axis=1)  # x, y = 0.7, z
        >>> [plane] = find_planes(points, np.tile([0.0, -1.0, 0.0], (800, 1)), np.zeros((800, 3), np.uint8))
        >>> plane.axis, plane.side, plane.offset
        (1, -1, 0.7)
    """
    codes = (colors >> 4).astype(np.int64) @ (256, 16, 1)
    planes = []
    for axis in range(3):
        cells = np.floor(np.delete(points, axis, axis=1) / CELL).astype(np.int64)
        for side in (-1, 1):
            facing = np.flatnonzero(side * normals[:, axis] > STEEPEST)
            for layer in _layers(points[facing, axis]):
                for part in _connected(cells[facing[layer]]):
                    members = facing[layer[part]]
                    planes.append(_plane(axis, side, points[members, axis], cells[members], codes[members]))
    return planes


def _layers(offsets: np.ndarray) -> list[np.ndarray]:
    """Return the indices of the points near each maximum of the density of (N,) offsets."""
    if not len(offsets):
        return []
    from scipy.signal import find_peaks  # takes a second to load

    bins = ((offsets - offsets.min()) / BIN).astype(np.int64)
    margin = round(3 * SMOOTHING / BIN)  # the first and the last bin can be maxima, too
    density = ndimage.gaussian_filter1d(np.pad(np.bincount(bins).astype(float), margin), SMOOTHING / BIN)
    peaks = find_peaks(density, distance=2 * THICKNESS / BIN)[0] - margin
    nearest = np.searchsorted((peaks[1:] + peaks[:-1]) / 2, bins)
    near = np.abs(bins - peaks[nearest]) <= THICKNESS / BIN
    return [np.flatnonzero(near & (nearest == k)) for k in range(len(peaks))]


def _connected(cells: np.ndarray) -> list[np.ndarray]:
    """Return the indices of the points in each connected group of cells that is as large as a plane; (N, 2) cells."""
    first = cells.min(axis=0)
    inside = tuple((cells - first).T)
    count = np.zeros(cells.max(axis=0) - first + 1, np.int64)
    np.add.at(count, inside, 1)
    labels, _ = ndimage.label(count > 1)
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    of_point = labels[inside]
    return [np.flatnonzero(of_point == k) for k in np.flatnonzero(sizes * CELL**2 >= MIN_AREA)]


def _plane(axis: int, side: int, offsets: np.ndarray, cells: np.ndarray, codes: np.ndarray) -> Plane:
    """Return the plane of N points."""
    seen = np.unique(cells, axis=0)
    first = seen.min(axis=0) - GROWTH
    grid = np.zeros(seen.max(axis=0) + GROWTH - first + 1, bool)
    grid[tuple((seen - first).T)] = True
    grid = ndimage.binary_dilation(grid, iterations=GROWTH)
    colors = np.bincount(codes, minlength=4096).reshape(16, 16, 16) / len(codes)
    for color_axis in range(3):  # a bin shares half of its points with its neighbours
        colors = ndimage.convolve1d(colors, [0.25, 0.5, 0.25], axis=color_axis)
    return Plane(axis, side, float(np.median(offsets)), first, grid, seen, colors.ravel())


def _nearest_planes(planes: list[Plane], points: np.ndarray, rays: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Return the (N,) depths at which rays meet the plane nearest to their (N, 3) point; 0 for none near."""
    result, distance = np.zeros(len(depth), np.float32), np.full(len(depth), np.inf)
    for axis in range(3):
        order = np.argsort(points[:, axis])
        along = points[order, axis]
        for plane in planes:
            if plane.axis != axis:
                continue
            # Points farther than BACK from the plane are left to other planes, or to colours.
            near = order[slice(*np.searchsorted(along, (plane.offset - BACK, plane.offset + BACK)))]
            near = near[plane.side * rays[near, axis] < -1e-3]
            change = (plane.offset - points[near, axis]) / rays[near, axis]
            close = (change > -FRONT) & (change < BACK) & (np.abs(change) < distance[near])
            near, change = near[close], change[close]
            hits = np.delete(points[near] + change[:, None] * rays[near], axis, axis=1)
            covered = plane.covers(np.floor(hits / CELL).astype(np.int64))
            near, change = near[covered], change[covered]
            result[near], distance[near] = depth[near] + change, np.abs(change)
    return result


def _normals(points: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """Return unit normals that face the camera, from the neighbours of each pixel; zero at the borders of images."""
    normals = np.zeros_like(points)
    right = points[:, 1:-1, 2:] - points[:, 1:-1, :-2]
    down = points[:, 2:, 1:-1] - points[:, :-2, 1:-1]
    inner = np.cross(right, down)
    inner *= -np.sign((inner * rays[:, 1:-1, 1:-1]).sum(axis=-1, keepdims=True))
    normals[:, 1:-1, 1:-1] = inner / np.maximum(np.linalg.norm(inner, axis=-1, keepdims=True), 1e-9)
    return normals


def _heading(normals: np.ndarray) -> np.ndarray:
    """Return the (3, 3) rotation about z whose columns are the headings of most vertical surfaces, and z."""
    walls = normals[np.abs(normals[:, 2]) < 0.3]
    angle = np.angle(np.exp(4j * np.arctan2(walls[:, 1], walls[:, 0])).sum()) / 4 if len(walls) else 0.0
    return np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
