"""Semantics of HM3D: ``NAME.semantic.txt`` lists the objects, and ``NAME.semantic.glb`` shows each in its colour.

The text file has a header line and then ``id,HEXCOLOUR,"category name",region``. The semantic mesh has one colour per
object, as texture or per vertex; its triangles are matched with those of the mesh ``NAME.glb`` (or ``NAME.basis.glb``).
"""

import re
from pathlib import Path
from typing import Any

import numpy as np

from autonerf_lab.errors import DataError, SceneError
from autonerf_lab.scenes.habitat.transfer import nearest_objects
from autonerf_lab.scenes.mesh_file import load_parts
from autonerf_lab.utils.storage import read_bytes

HEADER = "HM3D Semantic Annotations"
MAX_BYTES = 16 * 2**20
_LINE = re.compile(r'\s*(\d{1,9})\s*,\s*([0-9A-Fa-f]{6})\s*,\s*"([^"]{0,200})"\s*,\s*(-?\d{1,9})\s*')


def read_annotations(path: Path) -> dict[int, tuple[int, str]]:
    """Read a ``.semantic.txt``.

    Returns:
        Object id and category name, by the colour as a number 0xRRGGBB.

    Raises:
        SceneError: The file is missing, damaged, or uses a colour twice; the message names the line.
    """
    try:
        lines = read_bytes(path, MAX_BYTES).decode("utf-8").splitlines()
    except (DataError, UnicodeDecodeError) as error:
        raise SceneError(f"{path} is not readable: {error}") from error
    if not lines or HEADER not in lines[0]:
        raise SceneError(f"{path} must begin with the line {HEADER!r}")
    found: dict[int, tuple[int, str]] = {}
    for number, line in enumerate(lines[1:], 2):
        if not line.strip():
            continue
        match = _LINE.fullmatch(line)
        if match is None:
            raise SceneError(f'{path}: line {number} must be id,HEXCOLOUR,"category name",region, not {line[:80]!r}')
        color = int(match[2], 16)
        if color in found:
            raise SceneError(f"{path}: line {number} has the colour {match[2]} of object {found[color][0]}")
        found[color] = (int(match[1]), match[3])
    return found


def add_labels(path: Path, parts: list[dict[str, Any]]) -> None:
    """Add ``face_labels``, an object id per face, and ``labels``, their names, to the parts of a mesh of HM3D.

    A mesh without a ``.semantic.txt`` beside it is left unchanged.

    Raises:
        SceneError: The annotations are damaged, or the semantic mesh is missing.
    """
    stem = path.name.removesuffix(path.suffix).removesuffix(".basis").removesuffix(".semantic")
    text = path.with_name(f"{stem}.semantic.txt")
    if path.suffix.lower() != ".glb" or not text.exists():
        return
    annotations = read_annotations(text)
    mesh = path.with_name(f"{stem}.semantic.glb")
    if mesh == path:
        painted = parts
    elif mesh.exists():
        painted = load_parts(mesh)
    else:
        raise SceneError(f"{text} needs the mesh {mesh.name} beside it, which shows the objects by their colours")
    ids = [_object_ids(part, annotations) for part in painted]
    if painted is not parts:
        ids = nearest_objects(parts, painted, ids)
    labels = {0: "unknown", **dict(annotations.values())}
    for part, of_face in zip(parts, ids, strict=True):
        part |= {"face_labels": of_face, "labels": labels}


def _object_ids(part: dict[str, Any], annotations: dict[int, tuple[int, str]]) -> np.ndarray:
    """Return the object id of each face by its colour, 0 for a colour without an object."""
    if "image" in part:
        image = part["image"]
        size = np.array([image.shape[1], image.shape[0]])
        texel = np.floor(part["uv"].mean(axis=1) % 1 * size).astype(int).clip(0, size - 1)
        rgb = image[texel[:, 1], texel[:, 0]].astype(np.int64)
    else:
        rgb = part["color"][:, 0].astype(np.int64)
    colors, inverse = np.unique(rgb[:, 0] << 16 | rgb[:, 1] << 8 | rgb[:, 2], return_inverse=True)
    return np.array([annotations.get(color, (0, ""))[0] for color in colors.tolist()])[inverse]
