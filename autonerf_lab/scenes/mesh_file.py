"""Reader of mesh files: the triangles, colours and node names of a GLB, OBJ or PLY file, in the frame of the file."""

import hashlib
import json
import re
import struct
from pathlib import Path
from typing import Any

import numpy as np

from autonerf_lab.errors import DataError, SceneError
from autonerf_lab.scenes.texture_atlas import MAX_TEXELS
from autonerf_lab.utils.storage import check_file

MAX_BYTES = 256 * 2**20
MAX_FACES = 5_000_000
MAX_PIXELS = 8192  # longest side of a texture image
FORMATS = {".glb", ".obj", ".ply"}
_BASIS = (
    "download the version of the dataset with PNG or JPEG textures (HM3D: the archives hm3d-*-glb), or convert the "
    "file with `gltf-transform ktxdecompress`"
)
_DECOMPRESS = "convert the file with `gltf-transform copy`, which writes plain geometry"
UNSUPPORTED = {  # glTF extension -> way out
    "KHR_texture_basisu": _BASIS,
    "KHR_draco_mesh_compression": _DECOMPRESS,
    "EXT_meshopt_compression": _DECOMPRESS,
}


def load_parts(path: Path) -> list[dict[str, Any]]:
    """Load all meshes of a file, with the transforms of their nodes applied.

    Returns:
        One entry per mesh: ``vertices`` (V, 3) float64 and ``faces`` (F, 3) int64 in the frame of the file; ``node``
        and ``name``, of node and mesh; ``image`` (H, W, 3) uint8 with ``uv`` (F, 3, 2), v down, or ``color``
        (F, 3, 3); and ``object_id`` (F,) int64 if the triangles of a PLY file have it.

    Raises:
        SceneError: The file has another format, is damaged, empty, too large, compressed in a way that is not
            supported, or refers to other files.
    """
    if path.suffix.lower() not in FORMATS:
        raise SceneError(f"{path}: only {', '.join(sorted(FORMATS))} meshes can be imported")
    try:
        check_file(path, MAX_BYTES)
    except DataError as error:
        raise SceneError(str(error)) from error
    _check_references(path)
    return _load(path)


def _check_references(path: Path) -> None:
    """Raise SceneError if a file refers to other files, except materials of an OBJ in its own folder."""
    kind = path.suffix.lower()
    names: list[str] = []
    try:
        if kind == ".glb":
            names = _glb_uris(path)
        elif kind == ".obj":
            pending, visited = [path], set()
            while pending:
                file = pending.pop()
                if file in visited or not file.is_file():
                    continue
                visited.add(file)
                for line in file.read_text(errors="replace").splitlines():
                    words = line.split()
                    if words and (words[0] == "mtllib" or words[0].startswith("map_")):
                        names.append(words[-1])
                        if words[0] == "mtllib" and _is_local(words[-1]):
                            pending.append(path.parent / words[-1])
    except SceneError:
        raise
    except Exception as error:  # of any class in a damaged file
        raise SceneError(f"{path} is not a readable {kind[1:].upper()} file: {error}") from error
    for name in names:
        if kind == ".glb" or not _is_local(name):
            raise SceneError(f"{path} refers to {name[:80]!r}; only data inside the file (or its folder) is read")


def _is_local(name: str) -> bool:
    """Return True if a file name stays in its folder."""
    return not (":" in name or name.startswith(("/", "\\")) or ".." in re.split(r"[\\/]", name))


def _glb_uris(path: Path) -> list[str]:
    """Return the external URIs of a GLB file."""
    data = path.read_bytes()
    magic, version, _ = struct.unpack("<4sII", data[:12])
    if magic != b"glTF" or version != 2:
        raise ValueError("no glTF 2.0 header")
    length, kind = struct.unpack("<I4s", data[12:20])
    if kind != b"JSON" or 20 + length > len(data):
        raise ValueError("truncated")
    document = json.loads(data[20 : 20 + length])
    extensions = {*document.get("extensionsRequired", []), *document.get("extensionsUsed", [])}
    for extension, way_out in UNSUPPORTED.items():
        if extension in extensions:
            raise SceneError(f"{path} uses {extension}, which is not supported; {way_out}")
    _check_nodes(document.get("nodes", []))
    for accessor in document.get("accessors", []):
        if int(accessor.get("count", 0)) > 3 * MAX_FACES:
            raise ValueError(f"an accessor of {accessor['count']} elements")
    entries = [*document.get("buffers", []), *document.get("images", [])]
    return [e["uri"] for e in entries if "uri" in e and not str(e["uri"]).startswith("data:")]


def _check_nodes(nodes: list[dict[str, Any]]) -> None:
    """Raise ValueError if the nodes of a glTF document are no trees: loaders place the meshes of a cycle anywhere."""
    parents: dict[int, int] = {}
    for k, entry in enumerate(nodes):
        for child in entry.get("children", []):
            if parents.setdefault(child, k) != k:
                raise ValueError(f"node {child} is a child of nodes {parents[child]} and {k}")
    visits: dict[int, int] = {}  # node -> the node from which its ancestors were followed first
    for start in parents:
        node = start
        while node in parents and node not in visits:
            visits[node], node = start, parents[node]
        if visits.get(node) == start:
            raise ValueError(f"node {node} is its own ancestor")


def _load(path: Path) -> list[dict[str, Any]]:
    """Load all meshes of a file with their node transforms applied."""
    import trimesh
    from PIL import Image

    limit = Image.MAX_IMAGE_PIXELS
    Image.MAX_IMAGE_PIXELS = MAX_PIXELS**2 // 2  # PIL raises above twice this number
    try:
        loaded = trimesh.load_scene(path, process=False, maintain_order=True, skip_materials=False)
        found = []
        images: dict[Any, np.ndarray] = {}
        for node in loaded.graph.nodes_geometry:
            transform, name = loaded.graph[node]
            mesh = loaded.geometry[name]
            if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
                continue
            matrix = np.asarray(transform, dtype=np.float64)
            vertices = np.asarray(mesh.vertices, dtype=np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
            faces = np.asarray(mesh.faces, dtype=np.int64)
            if faces.min() < 0 or faces.max() >= len(vertices):
                raise SceneError(f"a face of {str(name)[:60]!r} points to a vertex that does not exist")
            if np.linalg.det(matrix[:3, :3]) < 0:
                faces = faces[:, ::-1]
            appearance = _appearance(mesh, faces, images) | _objects(mesh, faces)
            found.append({"vertices": vertices, "faces": faces, "node": str(node), "name": str(name), **appearance})
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from error
    except Exception as error:  # trimesh and its parsers raise arbitrary exceptions on damaged files
        raise SceneError(f"{path} cannot be read as a mesh: {type(error).__name__}: {error}") from error
    finally:
        Image.MAX_IMAGE_PIXELS = limit
    if not found:
        raise SceneError(f"{path} contains no triangles; point clouds cannot be imported")
    return found


def _objects(mesh: Any, faces: np.ndarray) -> dict[str, np.ndarray]:
    """Return the property ``object_id`` of the triangles of a PLY file, if they have it."""
    data = mesh.metadata.get("_ply_raw", {}).get("face", {}).get("data")
    names = data.dtype.names or () if isinstance(data, np.ndarray) else data or ()
    if data is None or "object_id" not in names:
        return {}
    numbers = np.asarray(data["object_id"]).ravel()
    plain = len(numbers) == len(faces) and numbers.dtype.kind in "iu"  # else it has other polygons than triangles
    return {"object_id": numbers.astype(np.int64)} if plain else {}


def _pixels(image: Any, tint: np.ndarray, known: dict[Any, np.ndarray]) -> np.ndarray:
    """Return the pixels of an image times ``tint``; equal images share one array, even if the loader copied them."""
    if max(image.size) > MAX_PIXELS:
        raise SceneError(
            f"a texture of {image.size[0]} x {image.size[1]} pixels is too large; at most {MAX_PIXELS} a side"
        )
    name = (id(image), tint.tobytes())
    if name not in known:
        digest = hashlib.sha256(image.tobytes() + tint.tobytes()).digest()
        if digest not in known:
            total = sum(array.size // 3 for key, array in known.items() if isinstance(key, bytes))
            if total + image.size[0] * image.size[1] > MAX_TEXELS:
                raise SceneError(f"its textures exceed the limit of {MAX_TEXELS / 1e6:.0f} megapixels")
            tinted = np.rint(np.outer(tint, np.arange(256))).astype(int).ravel().tolist()
            known[digest] = np.asarray(image.convert("RGB").point(tinted))
        known[name] = known[digest]
    return known[name]


def _appearance(mesh: Any, faces: np.ndarray, images: dict[Any, np.ndarray]) -> dict[str, Any]:
    """Return either an image and uv per corner (v down), or a colour per corner."""
    visual = mesh.visual
    uv = getattr(visual, "uv", None)
    material = getattr(visual, "material", None)
    image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    factor = getattr(material, "baseColorFactor", None)  # of glTF, linear; it also multiplies the texture
    tint = np.ones(3) if factor is None else (np.asarray(factor)[:3] / 255) ** (1 / 2.2)
    if uv is not None and image is not None and np.shape(uv) == (len(mesh.vertices), 2):
        corner = np.asarray(uv, dtype=np.float64)[faces]
        if not np.isfinite(corner).all():
            raise SceneError("a texture coordinate is not a finite number")
        corner[..., 1] = 1 - corner[..., 1]  # trimesh puts v = 0 at the bottom row
        return {"image": _pixels(image, tint, images), "uv": corner}
    if visual.kind == "vertex":
        return {"color": np.asarray(visual.vertex_colors)[:, :3][faces]}
    if visual.kind == "face":
        return {"color": np.repeat(np.asarray(visual.face_colors)[:, None, :3], 3, axis=1)}
    base = getattr(material, "main_color", None) if factor is None else np.rint(255 * tint)
    color = np.asarray(base if base is not None else (190, 190, 190, 255))[:3].astype(np.uint8)
    return {"color": np.broadcast_to(color, (len(faces), 3, 3))}
