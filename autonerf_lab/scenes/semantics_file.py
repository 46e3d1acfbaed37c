"""Semantics beside a mesh: ``home.semantics.json`` says what the nodes of ``home.glb`` are.

``{"format": "autonerf-lab semantics", "version": 1, "nodes": {"chair_12": {"class": "chair", "instance": 12, "name":
"chair (office)"}}}``. Nodes are the names of the file's nodes, groups or objects; class is one of the 16, instance any
positive number (0: the building), name any text. A mesh of one node, as a PLY is, can carry ``faces`` in place of them:
``{"class": [0, 3, ...], "instance": [0, 7, ...], "names": {"7": "bed"}}``, an entry for every triangle in file order.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from autonerf_lab.classes import CLASS_NAMES
from autonerf_lab.errors import SceneError
from autonerf_lab.scenes.gltf_export import node_names
from autonerf_lab.scenes.scene import Scene
from autonerf_lab.utils.storage import write_json

FORMAT, VERSION = "autonerf-lab semantics", 1
MAX_BYTES = 256 * 2**20
MAX_INSTANCE = 2**31


@dataclass(frozen=True)
class Sidecar:
    """What a sidecar says: of nodes (class, instance) by name, or of every face; and the names of the instances."""

    nodes: dict[str, tuple[int, int]]
    faces: tuple[np.ndarray, np.ndarray] | None  # (F,) class, (F,) instance
    names: dict[int, str]


def sidecar_path(path: Path) -> Path:
    """Where the semantics of a mesh file are looked for.

    Example:
        >>> sidecar_path(Path("homes/mine.glb")).name
        'mine.semantics.json'
    """
    return path.with_name(path.stem + ".semantics.json")


def write_sidecar(scene: Scene, path: Path) -> Path:
    """Write the semantics of a scene beside its GLB at ``path``; the path of the sidecar."""
    nodes: dict[str, dict[str, Any]] = {"building": {"class": CLASS_NAMES[0], "instance": 0, "name": "building"}}
    names = node_names(scene)
    for thing in scene.instances:
        nodes[names[thing.id]] = {"class": CLASS_NAMES[thing.class_id], "instance": thing.id, "name": thing.name}
    write_json(sidecar_path(path), {"format": FORMAT, "version": VERSION, "nodes": nodes})
    return sidecar_path(path)


def read_sidecar(path: Path) -> Sidecar:
    """Read and check a sidecar.

    Raises:
        SceneError: it names the file and the entry.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise SceneError(f"{path} is larger than {MAX_BYTES >> 20} MB")
        content = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError) as error:
        if isinstance(error, SceneError):
            raise
        raise SceneError(f"{path} is not readable as JSON: {error}") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT or content.get("version") != VERSION:
        raise SceneError(f"{path}: format {FORMAT!r} and version {VERSION} are expected")
    faces, nodes = content.get("faces"), content.get("nodes", {})
    if not isinstance(nodes, dict):
        raise SceneError(f"{path}: 'nodes' is not an object")
    found: dict[str, tuple[int, int]] = {}
    names: dict[int, str] = {}
    for node, entry in nodes.items():
        where = f"{path}: node {node[:60]!r}"
        if not isinstance(entry, dict) or entry.get("class") not in CLASS_NAMES:
            raise SceneError(f"{where} has no class out of {', '.join(CLASS_NAMES)}")
        instance, name = entry.get("instance", 0), entry.get("name", node)
        if type(instance) is not int or not 0 <= instance < MAX_INSTANCE or not isinstance(name, str):
            raise SceneError(f"{where} has a bad instance or name")
        found[node] = CLASS_NAMES.index(entry["class"]), instance
        names[instance] = name
    if faces is None:
        return Sidecar(found, None, names)
    if not isinstance(faces, dict):
        raise SceneError(f"{path}: 'faces' is not an object")
    arrays = []
    for key, limit in (("class", len(CLASS_NAMES)), ("instance", MAX_INSTANCE)):
        values = faces.get(key)
        if not isinstance(values, list) or not all(type(v) is int and 0 <= v < limit for v in values):
            raise SceneError(f"{path}: faces[{key!r}] is not a list of whole numbers from 0 to {limit - 1}")
        arrays.append(np.array(values, dtype=np.int64))
    labels = faces.get("names", {})
    if not isinstance(labels, dict) or not all(
        k.isdecimal() and len(k) < 11 and isinstance(v, str) for k, v in labels.items()
    ):
        raise SceneError(f"{path}: faces['names'] does not give texts by instance")
    return Sidecar(found, (arrays[0], arrays[1]), {int(k): v for k, v in labels.items()})
