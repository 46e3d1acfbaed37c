"""Semantics of Matterport3D: ``NAME.house`` lists the objects, ``NAME_semantic.ply`` has the object of each triangle.

Two kinds of lines of the house file are read: ``C index mapping_index name mpcat40_index mpcat40_name ...``, a category
(with ``#`` for a space), and ``O index region category ...``, an object. The label of an object is the name of its
category in Matterport's own list of 1,659, which tells a coffee table from a dining table; mpcat40 does not.
"""

from pathlib import Path
from typing import Any

import numpy as np

from autonerf_lab.errors import DataError, SceneError
from autonerf_lab.scenes.habitat.transfer import nearest_objects
from autonerf_lab.scenes.mesh_file import load_parts
from autonerf_lab.utils.storage import read_bytes

HEADER = "ASCII 1.1"
MAX_BYTES = 64 * 2**20


def read_house(path: Path) -> dict[int, str]:
    """Read the name of each object of a ``.house`` file, by its number; objects without a category are left out.

    Raises:
        SceneError: The file is missing or damaged; the message names the line.
    """
    try:
        lines = read_bytes(path, MAX_BYTES).decode("utf-8").splitlines()
    except (DataError, UnicodeDecodeError) as error:
        raise SceneError(f"{path} is not readable: {error}") from error
    if not lines or lines[0].strip() != HEADER:
        raise SceneError(f"{path} must begin with the line {HEADER!r}")
    names: dict[int, str] = {}
    objects: dict[int, tuple[int, int]] = {}  # category and number of the line
    for number, line in enumerate(lines[1:], 2):
        words = line.split()
        try:
            if words and words[0] == "C":
                names[int(words[1])] = words[3].replace("#", " ")
            elif words and words[0] == "O":
                objects[int(words[1])] = (int(words[3]), number)
        except (IndexError, ValueError) as error:
            raise SceneError(f"{path}: line {number} is damaged: {line[:80]!r}") from error
    for category, number in objects.values():
        if category >= 0 and category not in names:
            raise SceneError(f"{path}: line {number} has the category {category}, which does not exist")
    return {index: names[category] for index, (category, _) in objects.items() if category >= 0}


def add_labels(path: Path, parts: list[dict[str, Any]]) -> None:
    """Add ``face_labels``, an object id per face, and ``labels``, their names, to the parts of a mesh of Matterport3D.

    A mesh without a ``.house`` file beside it is left unchanged.

    Raises:
        SceneError: The house file is damaged, or the semantic mesh is missing or has no objects.
    """
    stem = path.stem.removesuffix("_semantic")
    house = path.with_name(f"{stem}.house")
    if not house.exists():
        return
    names = read_house(house)
    mesh = path.with_name(f"{stem}_semantic.ply")
    if mesh != path and not mesh.exists():
        raise SceneError(f"{house} needs the mesh {mesh.name} beside it, which has the object of each triangle")
    labelled = parts if mesh == path else load_parts(mesh)
    ids = []
    for part in labelled:
        if "object_id" not in part:
            raise SceneError(f"{mesh} has no property 'object_id' of its triangles")
        ids.append(np.where(np.isin(part["object_id"], [*names]), part["object_id"] + 1, 0))  # 0: no object
    if mesh != path:
        ids = nearest_objects(parts, labelled, ids)
    labels = {0: "unknown", **{index + 1: name for index, name in names.items()}}
    for part, of_face in zip(parts, ids, strict=True):
        part |= {"face_labels": of_face, "labels": labels}
