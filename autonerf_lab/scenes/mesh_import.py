"""Import of scanned or modelled apartments from GLB, OBJ and PLY files.

Semantics come from a semantics file beside the mesh (:mod:`autonerf_lab.scenes.semantics_file`), else from the names of
the nodes ("chair_12" is a chair). Faces without either are background.
"""

import hashlib
import json
import re
import struct
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from autonerf_lab.classes import CLASS_NAMES
from autonerf_lab.errors import DataError, SceneError
from autonerf_lab.scenes.scene import Scene
from autonerf_lab.scenes.semantics_file import read_semantics, semantics_path
from autonerf_lab.scenes.texture_atlas import MAX_TEXELS, build_atlas
from autonerf_lab.utils.storage import check_file

MAX_BYTES = 256 * 2**20
MAX_FACES = 5_000_000
MAX_PIXELS = 8192  # longest side of a texture image
MIN_SIDE, MAX_SIDE = 1.0, 200.0  # metres, plausible extent of an apartment
MIN_FLOOR = 0.5  # m2
HEAD_ROOM = 1.2  # metres; horizontal surfaces with less space above are ceilings or tops of furniture
FORMATS = {".glb", ".obj", ".ply"}


def import_scene(path: str | Path, up: str | None = None) -> Scene:
    """Import a scanned mesh as a scene, or furnish a floor plan.

    The mesh may be textured or have vertex colours, and may have holes.

    Args:
        path: A .glb, .obj or .ply file in metres; textures must be inside it, or for OBJ in its folder. A .json file
            is a floor plan, see :func:`~autonerf_lab.scenes.houseexpo.import_houseexpo`.
        up: Axis that points up in the file, "y" or "z"; default: y for GLB and OBJ, z for PLY.

    Returns:
        Scene in metres, z up, with its floor at z = 0 and its centre at x = y = 0.

    Raises:
        SceneError: The file has another format, is damaged, empty, not finite, too large or not in metres, has no
            floor, or refers to other files. The message names the file.
    """
    path = Path(path)
    if path.suffix.lower() == ".json":
        from autonerf_lab.scenes.houseexpo import import_houseexpo

        return import_houseexpo(path)
    if path.suffix.lower() not in FORMATS:
        raise SceneError(f"{path}: only {', '.join(sorted(FORMATS))} and .json (floor plans) can be imported")
    if up not in (None, "y", "z"):
        raise SceneError(f"up must be 'y', 'z' or None, not {up!r}")
    try:
        check_file(path, MAX_BYTES)
    except DataError as error:
        raise SceneError(str(error)) from error
    _check_references(path)
    parts = _load(path)
    vertices = np.concatenate([p["vertices"] for p in parts])
    _check_geometry(path, vertices, sum(len(p["faces"]) for p in parts))
    if (up or ("z" if path.suffix.lower() == ".ply" else "y")) == "y":
        vertices = vertices[:, [0, 2, 1]] * np.array([1.0, -1.0, 1.0])
    offset = np.cumsum([0] + [len(p["vertices"]) for p in parts])
    faces = np.concatenate([p["faces"] + o for p, o in zip(parts, offset, strict=False)])
    vertices = _align(path, vertices, faces)
    uv, texture = build_atlas(path, parts)
    class_ids, instances, names = _semantics(path, parts)
    return Scene(
        path.stem,
        vertices.astype(np.float32),
        faces.astype(np.int32),
        class_ids.astype(np.uint8),
        instances.astype(np.int32),
        uv,
        partial(np.asarray, texture),
        names=names,
    )


def _semantics(path: Path, parts: list[dict[str, Any]]) -> tuple[np.ndarray, np.ndarray, dict[int, str]]:
    """Return class and instance of every face, and the names of the instances."""
    counts = [len(p["faces"]) for p in parts]
    if not semantics_path(path).exists():
        classes = [class_of(p["node"]) or class_of(p["name"]) for p in parts]
        instances = [k if class_id else 0 for k, class_id in enumerate(classes, start=1)]
        return np.repeat(classes, counts), np.repeat(instances, counts), {}
    semantics = read_semantics(semantics_path(path))
    if semantics.faces is not None:
        if len(parts) != 1 or any(len(values) != sum(counts) for values in semantics.faces):
            raise SceneError(
                f"{semantics_path(path)}: 'faces' has {len(semantics.faces[0])} classes and {len(semantics.faces[1])}"
                f" instances; {path.name} has {sum(counts)} triangles in {len(parts)} meshes; 'faces' needs one mesh"
            )
        return *semantics.faces, semantics.names
    entries = [semantics.nodes.get(p["node"], semantics.nodes.get(p["name"], (0, 0))) for p in parts]
    found = np.array(entries, dtype=np.int64).reshape(-1, 2)
    return np.repeat(found[:, 0], counts), np.repeat(found[:, 1], counts), semantics.names


def class_of(name: str) -> int:
    """Return the class that the name of a node stands for; 0 if none.

    Example:
        >>> class_of("potted plant_12"), class_of("Chair.003"), class_of("wall")
        (3, 1, 0)
    """
    plain = re.sub(r"[\s_.\-]*\d*$", "", name.strip().lower()).replace("_", " ")
    return CLASS_NAMES.index(plain) if plain in CLASS_NAMES else 0


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
    except (
        OSError,
        ValueError,
        struct.error,
        LookupError,
        TypeError,
        AttributeError,
        ArithmeticError,
        RecursionError,
    ) as error:
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
    for accessor in document.get("accessors", []):
        if int(accessor.get("count", 0)) > 3 * MAX_FACES:
            raise ValueError(f"an accessor of {accessor['count']} elements")
    entries = [*document.get("buffers", []), *document.get("images", [])]
    return [e["uri"] for e in entries if "uri" in e and not str(e["uri"]).startswith("data:")]


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
            appearance = _appearance(mesh, faces, images)
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


def _pixels(image: Any, known: dict[Any, np.ndarray]) -> np.ndarray:
    """Return the pixels of an image; equal images share one array, even if the loader copied them."""
    if max(image.size) > MAX_PIXELS:
        raise SceneError(
            f"a texture of {image.size[0]} x {image.size[1]} pixels is too large; at most {MAX_PIXELS} a side"
        )
    if id(image) not in known:
        digest = hashlib.sha256(image.tobytes()).digest()
        if digest not in known:
            total = sum(array.size // 3 for key, array in known.items() if isinstance(key, bytes))
            if total + image.size[0] * image.size[1] > MAX_TEXELS:
                raise SceneError(f"its textures exceed the limit of {MAX_TEXELS / 1e6:.0f} megapixels")
            known[digest] = np.asarray(image.convert("RGB"))
        known[id(image)] = known[digest]
    return known[id(image)]


def _appearance(mesh: Any, faces: np.ndarray, images: dict[Any, np.ndarray]) -> dict[str, Any]:
    """Return either an image and uv per corner (v down), or a colour per corner."""
    visual = mesh.visual
    uv = getattr(visual, "uv", None)
    material = getattr(visual, "material", None)
    image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    if uv is not None and image is not None and np.shape(uv) == (len(mesh.vertices), 2):
        corner = np.asarray(uv, dtype=np.float64)[faces]
        if not np.isfinite(corner).all():
            raise SceneError("a texture coordinate is not a finite number")
        corner[..., 1] = 1 - corner[..., 1]  # trimesh puts v = 0 at the bottom row
        return {"image": _pixels(image, images), "uv": corner}
    if visual.kind == "vertex":
        return {"color": np.asarray(visual.vertex_colors)[:, :3][faces]}
    if visual.kind == "face":
        return {"color": np.repeat(np.asarray(visual.face_colors)[:, None, :3], 3, axis=1)}
    base = getattr(material, "main_color", None)
    color = np.asarray(base if base is not None else (190, 190, 190, 255))[:3]
    return {"color": np.broadcast_to(color, (len(faces), 3, 3))}


def _check_geometry(path: Path, vertices: np.ndarray, faces: int) -> None:
    """Raise SceneError for non-finite vertices, too many triangles or an implausible size."""
    if not np.isfinite(vertices).all():
        raise SceneError(f"{path}: {int((~np.isfinite(vertices)).any(axis=1).sum())} vertices are not finite numbers")
    if faces > MAX_FACES:
        raise SceneError(f"{path} has {faces} triangles; the limit is {MAX_FACES}")
    side = np.ptp(vertices, axis=0)
    if side.max() > MAX_SIDE or np.sort(side)[-2] < MIN_SIDE:
        text = " x ".join(f"{s:g}" for s in side.round(3))
        raise SceneError(
            f"{path} measures {text}: a scene must have {MIN_SIDE:g} to {MAX_SIDE:g} m;"
            " check the unit (metres expected)"
        )


def _align(path: Path, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Move the floor to z = 0 and the centre to x = y = 0.

    The floor is the lowest height with a large horizontal area, without ceilings and downward faces.
    """
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    area = np.linalg.norm(normal, axis=1)
    flat = np.abs(normal[:, 2]) > 0.9 * np.maximum(area, 1e-12)
    if area[flat].sum() < MIN_FLOOR:
        raise SceneError(
            f"{path} has no floor: no horizontal surface of {MIN_FLOOR} m2; check the up axis (up='y' or up='z')"
        )
    z = corners[..., 2].mean(axis=1)
    top = _quantile(corners[..., 2].max(axis=1), area, 0.99)  # quantile: ignore isolated fragments above
    under = flat & (z < top - HEAD_ROOM)
    flat = under if area[under].sum() >= MIN_FLOOR else flat
    facing = flat & (normal[:, 2] > 0)
    if area[facing].sum() > 0.25 * area[flat].sum():  # else: too many inverted faces to trust their side
        flat = facing
    z, area = z[flat], area[flat]
    low = z.min()
    height = np.bincount(((z - low) / 0.02).astype(int), weights=area)
    window = np.convolve(height, np.ones(7))[3 : 3 + len(height)]  # 14 cm: scanned floors are uneven
    level = int(np.argmax(window > 0.25 * window.max()))
    level += int(np.argmax(window[level : level + 7]))
    near = np.abs(z - (low + 0.02 * (level + 0.5))) < 0.08
    floor = _quantile(z[near], area[near], 0.5)  # median: robust against rugs
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    return vertices - np.array([middle[0], middle[1], floor])


def _quantile(values: np.ndarray, weights: np.ndarray, share: float) -> float:
    """Return the weighted quantile of values."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, share * total[-1])])
