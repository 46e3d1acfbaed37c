"""Task 5, mesh extraction: a triangle mesh from the density, by marching cubes ("Mesh generation" of the appendix).

The opacity of a 10 cm step, ``alpha = 1 - exp(-0.10 sigma)``, is sampled on a grid and smoothed; marching cubes then
extracts a level set. Only cubes whose free corners were seen from training views are kept, because no training view
constrains the density behind a surface. Gaps of at most two nodes between the rays that carved the seen space are
closed. The mesh is therefore open, like a scan, but without pinholes. The grid is processed in blocks along x and y.
Neighbouring blocks share one plane of samples and are merged afterwards, so the memory for the grid does not depend on
the resolution.
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
from autonerf_lab.errors import DataError
from autonerf_lab.evaluators.maps import opacity
from autonerf_lab.evaluators.radiance_field import RadianceField, point_cloud
from autonerf_lab.presets import preset as get_preset
from autonerf_lab.utils import storage

if TYPE_CHECKING:
    import trimesh

# Level set of the surface. A lower value includes floating density in front of walls, a higher one makes holes. The
# threshold of the maps is higher, because a map must not close a door.
SURFACE_OPACITY = 0.6
MIN_TRIANGLES = 100  # smaller connected components are noise
MAX_TRIANGLES = 1 << 25  # about 4 GB while blocks are merged
_BLOCK_NODES = 1 << 21
_BOUNDS_RAYS = 100_000
_MARGIN = 0.10  # metres
_CHUNK = 1 << 18
_BINOMIAL = np.array([0.25, 0.5, 0.25], dtype=np.float32)
_HALO = 2  # extra nodes around a block: one for the smoothing, and one that decides whether that node is sampled
_INNER = (slice(_HALO, -_HALO),) * 3
_AROUND = np.ones((3, 3, 3), dtype=bool)  # a node and its neighbours
# glTF is y-up: rotate by 90 degrees about x
_Z_UP_TO_Y_UP = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]], dtype=np.float64)


def surface_bounds(field: RadianceField) -> np.ndarray:
    """Compute the (2, 3) box around the surfaces in the training views, from rendered depth, without 0.5 % outliers."""
    points, _ = point_cloud(field, _BOUNDS_RAYS)
    points = points[field.seen(points)]  # the background of photographs lies far beyond
    if not len(points):
        return np.zeros((2, 3))
    low, high = np.quantile(points, [0.0025, 0.9975], axis=0)
    margin = _MARGIN * field.frame.unit
    return np.stack([low - margin, high + margin])


def extract_mesh(
    field: RadianceField,
    voxel: float | None = None,
    threshold: float = SURFACE_OPACITY,
    bounds: np.ndarray | None = None,
    min_triangles: int = MIN_TRIANGLES,
) -> "trimesh.Trimesh":
    """Extract the surface of a field as a mesh.

    Args:
        field: a trained NeRF.
        voxel: side of a cube, in the unit of the poses; default: ``mesh_voxel`` of the preset, in metres as estimated
            by the field.
        threshold: opacity over 10 cm at the surface.
        bounds: (2, 3) box, in the unit of the poses; default: around the surfaces in the training views.
        min_triangles: smaller connected components are removed.

    Returns:
        The mesh in the world frame, with triangles counter-clockwise as seen from the free side. Vertex colours are
        seen along the inverse normal; ``vertex_attributes["semantics"]`` is the class of each vertex, if the field has
        classes. The mesh is empty if there is no surface.

    Raises:
        DataError: the mesh does not fit in memory.
    """
    import trimesh

    voxel = voxel or get_preset().mesh_voxel * field.frame.unit
    bounds = surface_bounds(field) if bounds is None else np.asarray(bounds, dtype=np.float64)
    # Coordinates of the field: in them, 10 cm and the precision of five digits do not depend on the capture.
    voxel, bounds = voxel / field.frame.unit, field.frame.to_field(bounds)
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
    mesh.update_faces(large_components(mesh.faces, len(mesh.vertices), min_triangles))
    mesh.remove_unreferenced_vertices()
    if len(mesh.faces):
        _paint(mesh, field)
    mesh.vertices = field.frame.to_world(mesh.vertices)
    return mesh


def _blocks(size: list[int]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the first and last node of each block: all of z, and as many nodes of y, then of x, as fit in memory."""
    nodes = max(4, _BLOCK_NODES // size[2])  # of a block, in the x-y plane
    wide = size[1] if 2 * size[1] <= nodes else max(2, math.isqrt(nodes))
    thick = max(2, nodes // wide)
    for x, y in product(range(0, size[0] - 1, thick - 1), range(0, size[1] - 1, wide - 1)):
        yield np.array([x, y, 0]), np.minimum([x + thick, y + wide, size[2]], size)


def _block(
    field: RadianceField, low: np.ndarray, voxel: float, first: np.ndarray, last: np.ndarray, threshold: float
) -> tuple[np.ndarray, np.ndarray] | None:
    axes = [np.arange(first - _HALO, last + _HALO) for first, last in zip(first, last, strict=True)]
    shape = tuple(len(axis) for axis in axes)
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    points = field.frame.to_world((low + nodes * voxel).astype(np.float32))
    seen = np.concatenate([field.seen(points[i : i + _CHUNK]) for i in range(0, len(points), _CHUNK)]).reshape(shape)
    sampled = ndimage.binary_dilation(seen, _AROUND)  # rays end just inside of a surface
    alpha = np.zeros(shape, dtype=np.float32)
    index = np.flatnonzero(sampled)
    for i in range(0, len(index), _CHUNK):
        part = index[i : i + _CHUNK]
        alpha.flat[part] = opacity(field.density(points[part]) * np.float32(field.frame.unit))
    seen = ndimage.binary_closing(seen, _AROUND)  # gaps between the rays that carved it
    alpha, seen, shape = _smooth(alpha, sampled)[_INNER], seen[_INNER], tuple(s - 2 * _HALO for s in shape)
    if not alpha.min() < threshold < alpha.max():
        return None
    # In the left-handed index space of scikit-image, "ascent" orients triangles towards the free side of the world.
    vertices, faces, _, _ = marching_cubes(alpha, threshold, gradient_direction="ascent")
    known = np.ones(tuple(s - 1 for s in shape), dtype=bool)
    valid = seen | (alpha > threshold)
    for corner in np.ndindex(2, 2, 2):
        known &= valid[tuple(slice(c, s - 1 + c) for c, s in zip(corner, shape, strict=True))]
    cube = np.floor(vertices[faces].mean(axis=1)).astype(np.int64)
    faces = faces[known[tuple(np.minimum(cube, np.array(shape) - 2).T)]]
    return low + (vertices + first) * voxel, faces


def _smooth(alpha: np.ndarray, sampled: np.ndarray) -> np.ndarray:
    """Smooth opacities with a binomial filter over neighbouring nodes: finer detail is noise in a mesh."""
    weight = sampled.astype(np.float32)
    for axis in range(3):
        alpha, weight = (ndimage.convolve1d(a, _BINOMIAL, axis, mode="constant") for a in (alpha, weight))
    return np.where(sampled, alpha / np.maximum(weight, 1e-6), 0.0)


def large_components(faces: np.ndarray, count: int, minimum: int) -> np.ndarray:
    """Find the triangles in connected components of at least ``minimum`` triangles.

    Args:
        faces: (F, 3) vertex indices.
        count: number of vertices.
        minimum: number of triangles.

    Returns:
        (F,) bool.
    """
    edges = np.concatenate([faces[:, :2], faces[:, 1:]])
    graph = sparse.coo_matrix((np.ones(len(edges), dtype=bool), tuple(edges.T)), shape=(count, count))
    _, piece = sparse.csgraph.connected_components(graph, directed=False)
    of_face = piece[faces[:, 0]]
    return np.bincount(of_face, minlength=1)[of_face] >= minimum if len(faces) else np.zeros(0, dtype=bool)


def _paint(mesh: "trimesh.Trimesh", field: RadianceField) -> None:
    normals = mesh.vertex_normals.astype(np.float32)
    points = field.frame.to_world(mesh.vertices.astype(np.float32))
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
    """Return a copy of an extracted mesh, coloured by class.

    Raises:
        DataError: the mesh has no classes, because its field has none.
    """
    colored = mesh.copy()
    if len(mesh.faces):
        if "semantics" not in mesh.vertex_attributes:
            raise DataError("this mesh has no classes: its field was trained on images without semantics")
        _set_colors(colored, colorize(np.asarray(mesh.vertex_attributes["semantics"]).astype(np.int64)))
    return colored


def export_mesh(mesh: "trimesh.Trimesh", path: str | Path) -> Path:
    """Write a mesh to a PLY file (world frame, z up), or to a GLB or OBJ file (y up, as glTF requires), in metres.

    Args:
        mesh: world frame, metres.
        path: ends in ``.ply``, ``.glb`` or ``.obj``.

    Returns:
        The path.

    Raises:
        DataError: another suffix, an empty mesh, or a file that cannot be written.
    """
    path = Path(path)
    kind = path.suffix.lower().lstrip(".")
    if kind not in ("ply", "glb", "obj"):
        raise DataError(f"{path}: the suffix of a mesh file must be .ply, .glb or .obj")
    if not len(mesh.faces):
        raise DataError(f"{path}: the mesh is empty: the field has no surface that a training view has seen")
    # Copy without attributes: glTF does not allow integer vertex attributes, and viewers reject them.
    bare: Any = mesh.copy()
    bare.vertex_attributes.clear()
    if kind != "ply":
        bare.apply_transform(_Z_UP_TO_Y_UP)
    content = bare.export(file_type=kind)
    storage.write_bytes(path, content.encode() if isinstance(content, str) else content)
    return path
