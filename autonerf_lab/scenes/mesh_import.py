"""Bring your own: a GLB, OBJ or PLY of a real place becomes a scene.

Semantics come from a sidecar (``sidecar.py``), else from the names of the nodes ("chair_12" is a chair); without both
everything is background.
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
from autonerf_lab.errors import SceneError
from autonerf_lab.scenes.scene import Scene
from autonerf_lab.scenes.semantics_file import read_sidecar, sidecar_path

MAX_BYTES = 256 * 2**20
MAX_FACES = 5_000_000
MAX_PIXELS = 8192
MIN_SIDE, MAX_SIDE = 1.0, 200.0  # metres: a cupboard or a landscape is not a home, or not in metres
MIN_FLOOR = 0.5  # square metres
HEAD_ROOM = 1.2  # metres: what has less above it is a ceiling, or on top of furniture
FORMATS = {".glb", ".obj", ".ply"}
TEXTURE_WIDTH = 4096  # texels in a row of the atlas of a mesh without texture
MAX_TEXELS = 2**28  # of the atlas: 800 MB
MAX_TILES = 64  # repetitions of a picture across one face
REPEATED_SIDE = 2048  # texels, longest side of a picture that is repeated


def import_scene(path: str | Path, up: str | None = None) -> Scene:
    """Load a scan: textured or coloured at its vertices, with holes and all. Or furnish a floor plan.

    Args:
        path: a .glb, .obj or .ply file; textures must be inside it, or for OBJ beside it. A .json file is a plan:
            see :func:`~autonerf_lab.scenes.houseexpo.import_houseexpo`.
        up: "y" or "z"; without it y for GLB (the format demands it) and OBJ, z for PLY.

    Returns:
        A scene in metres, z up, its lowest large horizontal surface at z = 0, centred on the origin.

    Raises:
        SceneError: not such a file, damaged, empty, not finite, too large, in other units, or it points outside its
            folder. The message names the file.
    """
    path = Path(path)
    if path.suffix.lower() == ".json":
        from autonerf_lab.scenes.houseexpo import import_houseexpo

        return import_houseexpo(path)
    if path.suffix.lower() not in FORMATS:
        raise SceneError(f"{path}: only {', '.join(sorted(FORMATS))} and .json (floor plans) can be imported")
    if up not in (None, "y", "z"):
        raise SceneError(f"up must be 'y' or 'z', not {up!r}")
    try:
        size = path.stat().st_size
    except OSError as error:
        raise SceneError(f"{path} cannot be read: {error.strerror}") from error
    if size > MAX_BYTES:
        raise SceneError(f"{path} has {size >> 20} MB; the limit is {MAX_BYTES >> 20} MB")
    _refuse_references(path)
    parts = _load(path)
    vertices = np.concatenate([p["vertices"] for p in parts])
    _check_numbers(path, vertices, sum(len(p["faces"]) for p in parts))
    if (up or ("z" if path.suffix.lower() == ".ply" else "y")) == "y":
        vertices = vertices[:, [0, 2, 1]] * np.array([1.0, -1.0, 1.0])
    offset = np.cumsum([0] + [len(p["vertices"]) for p in parts])
    faces = np.concatenate([p["faces"] + o for p, o in zip(parts, offset, strict=False)])
    vertices = _settle(path, vertices, faces)
    uv, texture = _texture(path, parts)
    class_ids, numbers, names = _semantics(path, parts)
    return Scene(
        path.stem,
        vertices.astype(np.float32),
        faces.astype(np.int32),
        class_ids.astype(np.uint8),
        numbers.astype(np.int32),
        uv,
        partial(np.asarray, texture),
        names=names,
    )


def _semantics(path: Path, parts: list[dict[str, Any]]) -> tuple[np.ndarray, np.ndarray, dict[int, str]]:
    """Class and instance of every face, and the names of the instances."""
    counts = [len(p["faces"]) for p in parts]
    if not sidecar_path(path).exists():
        classes = [class_of(p["node"]) or class_of(p["name"]) for p in parts]
        numbers = [k if class_id else 0 for k, class_id in enumerate(classes, start=1)]
        return np.repeat(classes, counts), np.repeat(numbers, counts), {}
    said = read_sidecar(sidecar_path(path))
    if said.faces is not None:
        if len(parts) != 1 or any(len(values) != sum(counts) for values in said.faces):
            raise SceneError(
                f"{sidecar_path(path)}: 'faces' has {len(said.faces[0])} classes and {len(said.faces[1])} instances;"
                f" {path.name} has {sum(counts)} triangles in {len(parts)} meshes (faces need one mesh)"
            )
        return *said.faces, said.names
    entries = [said.nodes.get(p["node"], said.nodes.get(p["name"], (0, 0))) for p in parts]
    found = np.array(entries, dtype=np.int64).reshape(-1, 2)
    return np.repeat(found[:, 0], counts), np.repeat(found[:, 1], counts), said.names


def class_of(name: str) -> int:
    """Class that a node's name stands for, 0 if none.

    Example:
        >>> class_of("potted plant_12"), class_of("Chair.003"), class_of("wall")
        (3, 1, 0)
    """
    plain = re.sub(r"[\s_.\-]*\d*$", "", name.strip().lower()).replace("_", " ")
    return CLASS_NAMES.index(plain) if plain in CLASS_NAMES else 0


def _refuse_references(path: Path) -> None:
    """A scene file may not make us read other files, OBJ materials in its own folder apart."""
    kind = path.suffix.lower()
    names: list[str] = []
    try:
        if kind == ".glb":
            names = _glb_uris(path)
        elif kind == ".obj":
            pending, seen = [path], set()
            while pending:
                file = pending.pop()
                if file in seen or not file.is_file():
                    continue
                seen.add(file)
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
    return not (":" in name or name.startswith(("/", "\\")) or ".." in re.split(r"[\\/]", name))


def _glb_uris(path: Path) -> list[str]:
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
    """Every mesh of the file with its place in the world applied."""
    import trimesh
    from PIL import Image

    limit = Image.MAX_IMAGE_PIXELS
    Image.MAX_IMAGE_PIXELS = MAX_PIXELS**2 // 2  # twice that raises
    try:
        loaded = trimesh.load_scene(path, process=False, maintain_order=True, skip_materials=False)
        found = []
        pictures: dict[Any, np.ndarray] = {}
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
            look = _look(mesh, faces, pictures)
            found.append({"vertices": vertices, "faces": faces, "node": str(node), "name": str(name), **look})
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from error
    except Exception as error:  # trimesh and its parsers raise anything on damaged files
        raise SceneError(f"{path} cannot be read as a mesh: {type(error).__name__}: {error}") from error
    finally:
        Image.MAX_IMAGE_PIXELS = limit
    if not found:
        raise SceneError(f"{path} has no triangles")
    return found


def _pixels(picture: Any, known: dict[Any, np.ndarray]) -> np.ndarray:
    """Pixels of an image; nodes that share a picture get the same array, however often the loader copied it."""
    if max(picture.size) > MAX_PIXELS:
        raise SceneError(f"a texture of {picture.size[0]} x {picture.size[1]} pixels is too large")
    if id(picture) not in known:
        digest = hashlib.sha256(picture.tobytes()).digest()
        if digest not in known:
            total = sum(array.size // 3 for key, array in known.items() if isinstance(key, bytes))
            if total + picture.size[0] * picture.size[1] > MAX_TEXELS:
                raise SceneError(f"more than {MAX_TEXELS / 1e6:.0f} megapixels of textures")
            known[digest] = np.asarray(picture.convert("RGB"))
        known[id(picture)] = known[digest]
    return known[id(picture)]


def _look(mesh: Any, faces: np.ndarray, pictures: dict[Any, np.ndarray]) -> dict[str, Any]:
    """Either a picture and uv per corner (v down), or a colour per corner."""
    visual = mesh.visual
    uv = getattr(visual, "uv", None)
    material = getattr(visual, "material", None)
    picture = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    if uv is not None and picture is not None and np.shape(uv) == (len(mesh.vertices), 2):
        corner = np.asarray(uv, dtype=np.float64)[faces]
        if not np.isfinite(corner).all():
            raise SceneError("a texture coordinate is not a finite number")
        corner[..., 1] = 1 - corner[..., 1]  # trimesh puts v = 0 at the bottom row
        return {"picture": _pixels(picture, pictures), "uv": corner}
    if visual.kind == "vertex":
        return {"colour": np.asarray(visual.vertex_colors)[:, :3][faces]}
    if visual.kind == "face":
        return {"colour": np.repeat(np.asarray(visual.face_colors)[:, None, :3], 3, axis=1)}
    base = getattr(material, "main_color", None)
    colour = np.asarray(base if base is not None else (190, 190, 190, 255))[:3]
    return {"colour": np.broadcast_to(colour, (len(faces), 3, 3))}


def _check_numbers(path: Path, vertices: np.ndarray, faces: int) -> None:
    if not np.isfinite(vertices).all():
        raise SceneError(f"{path}: {int((~np.isfinite(vertices)).any(axis=1).sum())} vertices are not finite numbers")
    if faces > MAX_FACES:
        raise SceneError(f"{path} has {faces} triangles; the limit is {MAX_FACES}")
    side = np.ptp(vertices, axis=0)
    if side.max() > MAX_SIDE or np.sort(side)[-2] < MIN_SIDE:
        text = " x ".join(f"{s:g}" for s in side.round(3))
        raise SceneError(
            f"{path} measures {text}: a scene is between {MIN_SIDE:g} and {MAX_SIDE:g} metres; check the unit"
        )


def _settle(path: Path, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Floor to z = 0, middle to x = y = 0.

    The floor is the lowest height that holds much horizontal area, of what is no ceiling and no underside.
    """
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    area = np.linalg.norm(normal, axis=1)
    flat = np.abs(normal[:, 2]) > 0.9 * np.maximum(area, 1e-12)
    if area[flat].sum() < MIN_FLOOR:
        raise SceneError(f"{path} has no floor: no horizontal surface of half a square metre; is the up axis right?")
    z = corners[..., 2].mean(axis=1)
    top = _quantile(corners[..., 2].max(axis=1), area, 0.99)  # a few flakes above do not count
    under = flat & (z < top - HEAD_ROOM)
    flat = under if area[under].sum() >= MIN_FLOOR else flat
    facing = flat & (normal[:, 2] > 0)
    if area[facing].sum() > 0.25 * area[flat].sum():  # scans have turned faces, some are turned as a whole
        flat = facing
    z, area = z[flat], area[flat]
    low = z.min()
    height = np.bincount(((z - low) / 0.02).astype(int), weights=area)
    window = np.convolve(height, np.ones(7))[3 : 3 + len(height)]  # 14 cm: scanned floors are neither flat nor level
    level = int(np.argmax(window > 0.25 * window.max()))
    level += int(np.argmax(window[level : level + 7]))
    near = np.abs(z - (low + 0.02 * (level + 0.5))) < 0.08
    floor = _quantile(z[near], area[near], 0.5)  # the median: rugs do not lift it
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    return vertices - np.array([middle[0], middle[1], floor])


def _quantile(values: np.ndarray, weights: np.ndarray, share: float) -> float:
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, share * total[-1])])


def _texture(path: Path, parts: list[dict[str, Any]]) -> tuple[np.ndarray, np.ndarray]:
    """One atlas: pictures stacked on each other, then a strip of 3 x 3 texel tiles for what has colours only."""
    most: dict[int, np.ndarray] = {}
    for part in parts:
        if "picture" in part:
            part["uv"], part["tiles"] = _tiles(part["uv"])
            key = id(part["picture"])
            most[key] = np.maximum(most.get(key, 1), part["tiles"].max(axis=0))
    blocks: dict[tuple[int, bool], np.ndarray] = {}  # pictures as they are, and repeated
    for part in parts:
        if "picture" in part:
            key, many = id(part["picture"]), part["tiles"].max(axis=1) > 1
            if not many.all():
                blocks[key, False] = part["picture"]
            if many.any() and (key, True) not in blocks:
                blocks[key, True] = _repeated(part["picture"], *most[key].tolist())
    width = max([3, *(block.shape[1] for block in blocks.values())])
    if any("colour" in part for part in parts):
        width = max(width, TEXTURE_WIDTH)
    row_of = dict(zip(blocks, np.cumsum([0, *(len(b) for b in blocks.values())]).tolist(), strict=False))
    rows = sum(len(block) for block in blocks.values())
    strips: list[np.ndarray] = []
    texels = []
    for part in parts:
        if "picture" in part:
            key, many = id(part["picture"]), part["tiles"].max(axis=1) > 1
            texel = np.empty_like(part["uv"])
            for chosen, repeats in ((~many, np.ones(2)), (many, most[key])):
                if chosen.any():
                    block = blocks[key, bool(many[chosen][0])]
                    size = np.array([block.shape[1], len(block)]) / repeats
                    texel[chosen] = part["uv"][chosen] * size + [0, row_of[key, bool(many[chosen][0])]]
        else:
            strip, texel = _strip(part["colour"].astype(np.float64), width)
            texel[..., 1] += rows
            strips.append(strip)
            rows += len(strip)
        texels.append(texel)
    if rows * width > MAX_TEXELS:
        raise SceneError(
            f"{path}: its pictures make {rows * width / 1e6:.0f} megapixels; the limit is {MAX_TEXELS / 1e6:.0f}"
        )
    atlas = np.zeros((rows, width, 3), dtype=np.uint8)
    row = 0
    for block in [*blocks.values(), *strips]:
        atlas[row : row + len(block), : block.shape[1]] = block
        row += len(block)
    return (np.concatenate(texels) / np.array([width, rows], dtype=np.float64)).astype(np.float32), atlas


def _strip(colour: np.ndarray, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Texels for faces with a colour at each corner (F, 3, 3), and where in them the corners are, (F, 3, 2)."""
    per_row = width // 3
    k = np.arange(len(colour))
    strip = np.zeros((-(-len(colour) // per_row) * 3, width, 3), dtype=np.uint8)
    # corners at the middle of texels (0, 0), (2, 0), (0, 2): texel (i, j) is their affine mixture
    for i in range(3):
        for j in range(3):
            mixed = colour[:, 0] * (1 - i / 2 - j / 2) + colour[:, 1] * i / 2 + colour[:, 2] * j / 2
            strip[k // per_row * 3 + j, k % per_row * 3 + i] = np.clip(mixed + 0.5, 0, 255)
    base = np.stack([k % per_row * 3, k // per_row * 3], axis=1)[:, None, :]
    return strip, base + np.array([[0.5, 0.5], [2.5, 0.5], [0.5, 2.5]])


def _tiles(uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates (F, 3, 2) from the tile each face begins in, and how many tiles it reaches across, (F, 2).

    A face with more than MAX_TILES gets MAX_TILES larger ones.
    """
    inner = uv - np.floor(uv.min(axis=1, keepdims=True) + 1e-6)
    reach = inner.max(axis=1)
    inner = inner * (MAX_TILES / np.maximum(reach, MAX_TILES))[:, None]
    tiles = np.clip(np.ceil(reach - 1e-6), 1, MAX_TILES).astype(int)
    return np.clip(inner, 0, tiles[:, None]), tiles


def _repeated(picture: np.ndarray, across: int, down: int) -> np.ndarray:
    """The picture side by side; shrunk where the result would be longer than REPEATED_SIDE."""
    from PIL import Image

    height, width = picture.shape[:2]
    shrink = min(1.0, REPEATED_SIDE / (width * across), REPEATED_SIDE / (height * down))
    if shrink < 1:
        size = max(1, round(width * shrink)), max(1, round(height * shrink))
        picture = np.asarray(Image.fromarray(picture).resize(size, Image.Resampling.BOX))
    return np.tile(picture, (down, across, 1))
