"""Semantics beside a mesh: ``home.semantics.json`` gives the class and object of the nodes of ``home.glb``.

``{"format": "autonerf-lab semantics", "version": 1, "nodes": {"chair_12": {"class": "chair", "instance": 12, "name":
"chair (office)"}}}``. The keys of ``nodes`` are names of the mesh file's nodes, groups or objects. ``class`` is one of
the 16 class names or a name of the alias table (:mod:`autonerf_lab.scenes.class_aliases`), ``instance`` a positive
number (0: the building; left out: a number of its own), ``name`` any text. A mesh of one node, as in a PLY file, can
have ``faces`` instead: ``{"class": [0, 3, ...], "instance": [0, 7, ...], "names": {"7": "bed"}}`` with one entry per
triangle in file order.
"""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from autonerf_lab.classes import CLASS_NAMES
from autonerf_lab.errors import DataError, SceneError
from autonerf_lab.scenes.class_aliases import ALIASES, plain_name
from autonerf_lab.scenes.scene import Scene
from autonerf_lab.utils.storage import parse_json, read_bytes, write_json

FORMAT, VERSION = "autonerf-lab semantics", 1
MAX_BYTES = 256 * 2**20
MAX_INSTANCE = 2**31


@dataclass(frozen=True)
class MeshSemantics:
    """Content of a semantics file."""

    nodes: dict[str, tuple[int, int]]  # (class, instance) by node name
    faces: tuple[np.ndarray, np.ndarray] | None  # (F,) int64 class and (F,) int64 instance; None if not given
    names: dict[int, str]  # object names by instance


def semantics_path(path: Path) -> Path:
    """Return the path of the semantics file of a mesh file.

    Example:
        >>> semantics_path(Path("homes/mine.glb")).name
        'mine.semantics.json'
    """
    return path.with_name(path.stem + ".semantics.json")


def node_names(scene: Scene) -> dict[int, str]:
    """Return the GLB node name of each object by its id; 0 is the building."""
    return {0: "building", **{i.id: f"{CLASS_NAMES[i.class_id]}_{i.id}" for i in scene.instances}}


def write_semantics(scene: Scene, path: Path) -> Path:
    """Write the semantics file of a scene whose GLB is at ``path``, and return the path of the semantics file."""
    nodes: dict[str, dict[str, Any]] = {"building": {"class": CLASS_NAMES[0], "instance": 0, "name": "building"}}
    names = node_names(scene)
    for item in scene.instances:
        nodes[names[item.id]] = {"class": CLASS_NAMES[item.class_id], "instance": item.id, "name": item.name}
    write_json(semantics_path(path), {"format": FORMAT, "version": VERSION, "nodes": nodes})
    return semantics_path(path)


def read_semantics(path: Path, aliases: Mapping[str, str] = ALIASES) -> MeshSemantics:
    """Read and validate a semantics file.

    Args:
        path: The file.
        aliases: Class by name, see :mod:`autonerf_lab.scenes.class_aliases`.

    Raises:
        SceneError: The file is missing, too large or invalid; the message names the file and the entry.
    """
    try:
        content = parse_json(read_bytes(path, MAX_BYTES), Any, str(path))
    except DataError as error:
        raise SceneError(str(error)) from error
    if not isinstance(content, dict) or content.get("format") != FORMAT or content.get("version") != VERSION:
        raise SceneError(f"{path} must be a JSON object with format {FORMAT!r} and version {VERSION}")
    faces, nodes = content.get("faces"), content.get("nodes", {})
    if not isinstance(nodes, dict):
        raise SceneError(f"{path}: 'nodes' must be a JSON object")
    found: dict[str, tuple[int, int]] = {}
    names: dict[int, str] = {}
    numbers = (entry.get("instance") for entry in nodes.values() if isinstance(entry, dict))
    given = {number for number in numbers if isinstance(number, int)}
    unused = (number for number in itertools.count(1) if number not in given)
    for node, entry in nodes.items():
        where = f"{path}: node {node[:60]!r}"
        class_name = entry.get("class") if isinstance(entry, dict) else None
        class_name = aliases.get(plain_name(class_name)) if isinstance(class_name, str) else None
        if class_name is None:
            raise SceneError(f"{where} has no valid class; valid classes: {', '.join(CLASS_NAMES)}, and their aliases")
        instance, name = entry.get("instance"), entry.get("name", node)
        if instance is None:  # 0 is the building
            instance = next(unused) if class_name != CLASS_NAMES[0] else 0
        if type(instance) is not int or not 0 <= instance < MAX_INSTANCE or not isinstance(name, str):
            raise SceneError(f"{where} needs an instance from 0 to {MAX_INSTANCE - 1} and a text as name")
        found[node] = CLASS_NAMES.index(class_name), instance
        names[instance] = name
    if faces is None:
        return MeshSemantics(found, None, names)
    if not isinstance(faces, dict):
        raise SceneError(f"{path}: 'faces' must be a JSON object")
    arrays = []
    for key, limit in (("class", len(CLASS_NAMES)), ("instance", MAX_INSTANCE)):
        values = faces.get(key)
        if not isinstance(values, list) or not all(type(v) is int and 0 <= v < limit for v in values):
            raise SceneError(f"{path}: faces[{key!r}] must be a list of integers from 0 to {limit - 1}")
        arrays.append(np.array(values, dtype=np.int64))
    labels = faces.get("names", {})
    if not isinstance(labels, dict) or not all(
        k.isdecimal() and len(k) < 11 and isinstance(v, str) for k, v in labels.items()
    ):
        raise SceneError(f"{path}: faces['names'] must map instance numbers to texts")
    return MeshSemantics(found, (arrays[0], arrays[1]), {int(k): v for k, v in labels.items()})
