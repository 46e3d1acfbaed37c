"""Export of scenes to binary glTF 2.0 (GLB). Vertices are converted from z up to y up, as glTF requires."""

import io
import json
import struct
from pathlib import Path

import numpy as np
from PIL import Image

from autonerf_lab.classes import CLASS_COLORS, CLASS_NAMES
from autonerf_lab.scenes.scene import Scene
from autonerf_lab.scenes.semantics_file import node_names, write_semantics
from autonerf_lab.utils.storage import write_bytes

FLOAT, UINT32 = 5126, 5125
ARRAY_BUFFER, INDEX_BUFFER = 34962, 34963


def export_glb(scene: Scene, path: str | Path, semantic: bool = False) -> Path:
    """Write a scene as GLB with its texture embedded, and its semantics beside it as ``NAME.semantics.json``.

    The file has one node per object, named by class and number, in metres with y up. With the semantics file,
    :func:`~autonerf_lab.scenes.import_scene` restores classes, objects and names.

    Args:
        scene: Scene to write.
        path: GLB file to write.
        semantic: Color the objects by class instead of embedding the texture.

    Returns:
        The path of the GLB file.

    Raises:
        DataError: A file cannot be written.
    """
    path = Path(path)
    writer = _Writer()
    if semantic:
        materials = [_material(name, CLASS_COLORS[k] / 255.0) for k, name in enumerate(CLASS_NAMES)]
    else:
        png = io.BytesIO()
        Image.fromarray(scene.texture).save(png, "PNG", compress_level=4)
        writer.image(png.getvalue())
        materials = [_material("baked", None)]
    nodes, meshes = [], []
    names = node_names(scene)
    for number in np.unique(scene.face_instance).tolist():
        faces = np.flatnonzero(scene.face_instance == number)
        corners = scene.vertices[scene.faces[faces].reshape(-1)]
        uv = scene.uv[faces].reshape(-1, 2)
        both, index = np.unique(np.concatenate([corners, uv], axis=1), axis=0, return_inverse=True)
        position = np.ascontiguousarray(both[:, [0, 2, 1]] * np.array([1, 1, -1], dtype=np.float32))
        attributes = {"POSITION": writer.vectors(position, True)}
        if not semantic:
            attributes["TEXCOORD_0"] = writer.vectors(np.ascontiguousarray(both[:, 3:5]))
        class_id = int(scene.face_class[faces[0]])
        primitive = {
            "attributes": attributes,
            "indices": writer.indices(index.reshape(-1)),
            "material": class_id if semantic else 0,
        }
        meshes.append({"primitives": [primitive]})
        extras = {"class_id": class_id, "instance": number}
        nodes.append({"mesh": len(meshes) - 1, "name": names[number], "extras": extras})
    document = {
        "asset": {"version": "2.0", "generator": "autonerf-lab"},
        "scene": 0,
        "scenes": [{"nodes": list(range(len(nodes))), "name": scene.name}],
        "nodes": nodes,
        "meshes": meshes,
        "materials": materials,
        **writer.tables(),
    }
    write_bytes(path, _container(document, bytes(writer.blob)))
    write_semantics(scene, path)
    return path


def _material(name: str, color: np.ndarray | None) -> dict:
    surface: dict = {"metallicFactor": 0, "roughnessFactor": 1}
    if color is None:
        surface["baseColorTexture"] = {"index": 0}
    else:
        surface["baseColorFactor"] = [*np.round(color**2.2, 4).tolist(), 1]  # glTF factors are linear
    return {"name": name, "pbrMetallicRoughness": surface, "doubleSided": True}


class _Writer:
    """Binary buffer of a GLB with the JSON tables that refer to it."""

    def __init__(self) -> None:
        self.blob = bytearray()
        self.views: list[dict] = []
        self.accessors: list[dict] = []
        self.images: list[dict] = []

    def _view(self, data: bytes, target: int | None = None) -> int:
        self.blob += b"\0" * (-len(self.blob) % 4)
        view = {"buffer": 0, "byteOffset": len(self.blob), "byteLength": len(data)}
        if target is not None:
            view["target"] = target
        self.views.append(view)
        self.blob += data
        return len(self.views) - 1

    def vectors(self, array: np.ndarray, bounds: bool = False) -> int:
        """Append (N, 2 or 3) float vectors and return the index of their accessor."""
        view = self._view(array.astype("<f4").tobytes(), ARRAY_BUFFER)
        entry = {"bufferView": view, "componentType": FLOAT, "count": len(array), "type": f"VEC{array.shape[1]}"}
        if bounds:
            entry["min"], entry["max"] = array.min(axis=0).tolist(), array.max(axis=0).tolist()
        self.accessors.append(entry)
        return len(self.accessors) - 1

    def indices(self, array: np.ndarray) -> int:
        """Append (N,) vertex indices and return the index of their accessor."""
        view = self._view(array.astype("<u4").tobytes(), INDEX_BUFFER)
        self.accessors.append({"bufferView": view, "componentType": UINT32, "count": len(array), "type": "SCALAR"})
        return len(self.accessors) - 1

    def image(self, data: bytes) -> None:
        """Append a PNG file."""
        self.images.append({"bufferView": self._view(data), "mimeType": "image/png"})

    def tables(self) -> dict:
        """Return the accessors, buffer views, buffers and textures of the glTF document."""
        tables: dict = {
            "accessors": self.accessors,
            "bufferViews": self.views,
            "buffers": [{"byteLength": len(self.blob)}],
        }
        if self.images:
            sampler = {"magFilter": 9729, "minFilter": 9729, "wrapS": 33071, "wrapT": 33071}
            tables |= {"images": self.images, "textures": [{"source": 0, "sampler": 0}], "samplers": [sampler]}
        return tables


def _container(document: dict, blob: bytes) -> bytes:
    """Assemble a GLB file from its JSON chunk and its binary chunk."""
    text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    blob += b"\0" * (-len(blob) % 4)
    total = 12 + 8 + len(text) + 8 + len(blob)
    head = struct.pack("<4sII", b"glTF", 2, total) + struct.pack("<I4s", len(text), b"JSON")
    return head + text + struct.pack("<I4s", len(blob), b"BIN\0") + blob
