"""Task 5, extraction: a triangle mesh out of the density, by marching cubes ("Mesh generation" of the appendix).

The opacity of a 10 cm step, ``alpha = 1 - exp(-0.10 sigma)``, is sampled on a grid, smoothed and cut. Only cubes whose
free corners were seen from the training views are kept: behind a surface nothing constrains the density, and where it
ends there is no second surface. The mesh is open, as a scan is. The grid is worked through in blocks, cut along x and
y, that share one plane of samples with their neighbours and are welded afterwards: what grows with the resolution is
the mesh, not the grid.
"""

import math
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import ndimage, sparse
from skimage.measure import marching_cubes

from autonerf_lab.classes import colorize
from autonerf_lab.config import preset as get_preset
from autonerf_lab.errors import DataError
from autonerf_lab.evaluators.maps import opacity
from autonerf_lab.evaluators.radiance_field import Field
from autonerf_lab.evaluators.semantic_maps import point_cloud
from autonerf_lab.utils import storage

if TYPE_CHECKING:
    import trimesh

# The level set of the surface: lower, it stands before the walls, on what floats there; higher, it has holes. Maps ask
# for more, because a map must not close a door.
SURFACE_OPACITY = 0.6
MIN_TRIANGLES = 100  # smaller pieces are noise
MAX_TRIANGLES = 1 << 25  # about 4 GB while they are welded
_BLOCK_NODES = 1 << 21
_BOUNDS_RAYS = 100_000
_MARGIN = 0.10  # metres
_CHUNK = 1 << 18
_BINOMIAL = np.array([0.25, 0.5, 0.25], dtype=np.float32)
_HALO = 2  # nodes around a block on which its own depend: a neighbour, and what decides whether that one is sampled
_INNER = (slice(_HALO, -_HALO),) * 3
# glTF is y-up: a quarter turn about x
_Z_UP_TO_Y_UP = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]], dtype=np.float64)


def surface_bounds(field: Field) -> np.ndarray:
    """(2, 3) box around what the training views show, from rendered depth; one ray in 200 may lie outside."""
    points, _ = point_cloud(field, _BOUNDS_RAYS)
    points = points[field.seen(points)]  # the background of photographs lies far beyond
    if not len(points):
        return np.zeros((2, 3))
    low, high = np.quantile(points, [0.0025, 0.9975], axis=0)
    margin = _MARGIN * field.frame.unit
    return np.stack([low - margin, high + margin])


def extract_mesh(
    field: Field,
    voxel: float | None = None,
    threshold: float = SURFACE_OPACITY,
    bounds: np.ndarray | None = None,
    min_triangles: int = MIN_TRIANGLES,
) -> "trimesh.Trimesh":
    """Turn a field into a mesh.

    Args:
        field: a trained NeRF.
        voxel: side of a marching cube, in the units of the cameras; that of the preset without, in metres or what the
            field takes for such.
        threshold: of the opacity over 10 cm.
        bounds: (2, 3) box to search, in the units of the cameras; from the training views without.
        min_triangles: connected pieces with fewer are dropped.

    Returns:
        World frame, triangles counter-clockwise seen from the free side. Vertex colours are those seen along the
        inverse normal; ``vertex_attributes["semantics"]`` is the class of each vertex, where the field knows any.
        Without any surface the mesh is empty.

    Raises:
        DataError: the mesh would not fit in memory.
    """
    import trimesh

    voxel = voxel or get_preset().mesh_voxel * field.frame.unit
    bounds = surface_bounds(field) if bounds is None else np.asarray(bounds, dtype=np.float64)
    # from here on in the field's coordinates, where 10 cm and five digits mean the same in every capture
    voxel, bounds = voxel / field.frame.unit, field.frame.enter(bounds)
    size = np.maximum(2, np.ceil((bounds[1] - bounds[0]) / voxel).astype(np.int64) + 1)
    a, b, c = (size - 1).tolist()
    if (triangles := 4 * (a * b + b * c + c * a)) > MAX_TRIANGLES:  # walls, floor and ceiling alone have as many
        text = " x ".join(f"{s:.3g}" for s in bounds[1] - bounds[0])
        raise DataError(f"a mesh of {text} at {voxel:.3g} has over {triangles:.1g} triangles: use a larger voxel")
    vertices, faces, count = [], [], 0
    for first, last in _blocks(size.tolist()):
        piece = _block(field, bounds[0], voxel, first, last, threshold)
        if piece is not None:
            vertices.append(piece[0])
            faces.append(piece[1] + count)
            count += len(piece[0])
    if not vertices:
        return trimesh.Trimesh(process=False)
    mesh = trimesh.Trimesh(np.concatenate(vertices), np.concatenate(faces), process=False)
    mesh.merge_vertices(digits_vertex=5)
    mesh.update_faces(mesh.nondegenerate_faces())
    mesh.update_faces(large_pieces(mesh.faces, len(mesh.vertices), min_triangles))
    mesh.remove_unreferenced_vertices()
    if len(mesh.faces):
        _paint(mesh, field)
    mesh.vertices = field.frame.leave(mesh.vertices)
    return mesh


def _blocks(size: list[int]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """First and last node of each block: all of z, and as much of y, then of x, as memory allows."""
    nodes = max(4, _BLOCK_NODES // size[2])  # of a block, seen from above
    wide = size[1] if 2 * size[1] <= nodes else max(2, math.isqrt(nodes))
    thick = max(2, nodes // wide)
    for x, y in product(range(0, size[0] - 1, thick - 1), range(0, size[1] - 1, wide - 1)):
        yield np.array([x, y, 0]), np.minimum([x + thick, y + wide, size[2]], size)


def _block(
    field: Field, low: np.ndarray, voxel: float, first: np.ndarray, last: np.ndarray, threshold: float
) -> tuple[np.ndarray, np.ndarray] | None:
    axes = [np.arange(first - _HALO, last + _HALO) for first, last in zip(first, last, strict=True)]
    shape = tuple(len(axis) for axis in axes)
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    points = field.frame.leave((low + nodes * voxel).astype(np.float32))
    seen = np.concatenate([field.seen(points[i : i + _CHUNK]) for i in range(0, len(points), _CHUNK)]).reshape(shape)
    sampled = ndimage.binary_dilation(seen, np.ones((3, 3, 3), dtype=bool))  # rays end just inside of a surface
    alpha = np.zeros(shape, dtype=np.float32)
    index = np.flatnonzero(sampled)
    for i in range(0, len(index), _CHUNK):
        part = index[i : i + _CHUNK]
        alpha.flat[part] = opacity(field.density(points[part]) * np.float32(field.frame.unit))
    alpha, seen, shape = _smooth(alpha, sampled)[_INNER], seen[_INNER], tuple(s - 2 * _HALO for s in shape)
    if not alpha.min() < threshold < alpha.max():
        return None
    # In scikit-image's left-handed index space "ascent" is what makes triangles face the free side of the world
    vertices, faces, _, _ = marching_cubes(alpha, threshold, gradient_direction="ascent")
    known = np.ones(tuple(s - 1 for s in shape), dtype=bool)
    vouched = seen | (alpha > threshold)
    for corner in np.ndindex(2, 2, 2):
        known &= vouched[tuple(slice(c, s - 1 + c) for c, s in zip(corner, shape, strict=True))]
    cube = np.floor(vertices[faces].mean(axis=1)).astype(np.int64)
    faces = faces[known[tuple(np.minimum(cube, np.array(shape) - 2).T)]]
    return low + (vertices + first) * voxel, faces


def _smooth(alpha: np.ndarray, sampled: np.ndarray) -> np.ndarray:
    """Mean over a node and its neighbours, the binomial low-pass of marching cubes: finer detail is noise in a mesh."""
    weight = sampled.astype(np.float32)
    for axis in range(3):
        alpha, weight = (ndimage.convolve1d(a, _BINOMIAL, axis, mode="constant") for a in (alpha, weight))
    return np.where(sampled, alpha / np.maximum(weight, 1e-6), 0.0)


def large_pieces(faces: np.ndarray, count: int, minimum: int) -> np.ndarray:
    """(F,) bool: triangles of connected pieces that have at least ``minimum`` of them."""
    edges = np.concatenate([faces[:, :2], faces[:, 1:]])
    graph = sparse.coo_matrix((np.ones(len(edges), dtype=bool), tuple(edges.T)), shape=(count, count))
    _, piece = sparse.csgraph.connected_components(graph, directed=False)
    of_face = piece[faces[:, 0]]
    return np.bincount(of_face, minlength=1)[of_face] >= minimum if len(faces) else np.zeros(0, dtype=bool)


def _paint(mesh: "trimesh.Trimesh", field: Field) -> None:
    normals = mesh.vertex_normals.astype(np.float32)
    points = field.frame.leave(mesh.vertices.astype(np.float32))
    chunks = [slice(i, i + _CHUNK) for i in range(0, len(points), _CHUNK)]
    color = np.concatenate([field.color(points[c], -normals[c]) for c in chunks])
    _set_colors(mesh, np.round(np.clip(color, 0, 1) * 255).astype(np.uint8))
    if field.classes:
        labels = np.concatenate([field.semantics(points[c]).argmax(axis=1) for c in chunks])
        mesh.vertex_attributes["semantics"] = labels.astype(np.uint8)


def _set_colors(mesh: "trimesh.Trimesh", colors: np.ndarray) -> None:
    from trimesh.visual import ColorVisuals

    mesh.visual = ColorVisuals(mesh, vertex_colors=colors)


def semantic_mesh(mesh: "trimesh.Trimesh") -> "trimesh.Trimesh":
    """The twin of an extracted mesh, coloured by class.

    Raises:
        DataError: the mesh has no classes, because its field knows none.
    """
    twin = mesh.copy()
    if len(mesh.faces):
        if "semantics" not in mesh.vertex_attributes:
            raise DataError("this mesh has no classes: its field was trained on images without semantics")
        _set_colors(twin, colorize(np.asarray(mesh.vertex_attributes["semantics"]).astype(np.int64)))
    return twin


def export_mesh(mesh: "trimesh.Trimesh", path: str | Path) -> Path:
    """Write a PLY (world frame, z up) or a GLB (y up, as glTF demands), in metres.

    Raises:
        DataError: another suffix, an empty mesh, or a file that cannot be written.
    """
    path = Path(path)
    kind = path.suffix.lower().lstrip(".")
    if kind not in ("ply", "glb"):
        raise DataError(f"{path}: a mesh is written as .ply or .glb")
    if not len(mesh.faces):
        raise DataError(f"{path}: the mesh is empty, the field holds no surface that a training view saw")
    # A bare copy: an integer vertex attribute is no legal glTF attribute, and viewers stumble over it
    bare: Any = mesh.copy()
    bare.vertex_attributes.clear()
    if kind == "glb":
        bare.apply_transform(_Z_UP_TO_Y_UP)
    storage.write_bytes(path, bare.export(file_type=kind))
    return path
