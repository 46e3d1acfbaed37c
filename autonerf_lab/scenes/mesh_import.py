"""Import of scanned or modelled apartments: meshes (GLB, OBJ, PLY) and the scenes of Habitat datasets.

Semantics come from a semantics file beside the mesh (:mod:`autonerf_lab.scenes.semantics_file`), else from the files
of HM3D (:mod:`autonerf_lab.scenes.habitat.hm3d`) or Matterport3D (:mod:`autonerf_lab.scenes.habitat.mp3d`), else from
the names of the nodes or objects, by the alias table (:mod:`autonerf_lab.scenes.class_aliases`). Faces without a class
are background.
"""

import warnings
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from autonerf_lab.errors import SceneError
from autonerf_lab.scenes.class_aliases import class_of, plain_name, read_aliases
from autonerf_lab.scenes.habitat import add_labels, is_habitat_config, load_config
from autonerf_lab.scenes.import_report import make_report
from autonerf_lab.scenes.mesh_file import MAX_FACES, load_parts
from autonerf_lab.scenes.mesh_orientation import find_up, floor_offset, to_z_up
from autonerf_lab.scenes.scene import Scene
from autonerf_lab.scenes.semantics_file import read_semantics, semantics_path
from autonerf_lab.scenes.texture_atlas import build_atlas

MIN_SIDE, MAX_SIDE = 1.0, 200.0  # metres, plausible extent of an apartment
NO_OBJECTS = {  # names of parts of the building, and names that programs give to nodes
    *("wall", "floor", "ceiling", "door", "window", "building", "unknown", "stairs", "beam", "column"),
    *("geometry", "mesh", "node", "object", "world", "root", "scene", "cube"),
}


def import_scene(
    path: str | Path, up: str | None = None, aliases: Mapping[str, str] | str | Path | None = None
) -> Scene:
    """Import a scanned mesh or a scene of a Habitat dataset as a scene, or furnish a floor plan.

    The mesh may be textured or have vertex colours, and may have holes. ``scene.import_report`` describes the result; a
    UserWarning says if it is implausible.

    Args:
        path: A .glb, .obj or .ply file in metres; textures must be inside it, or for OBJ in its folder. Or a file of a
            Habitat dataset: ``.scene_instance.json``, ``.stage_config.json``, ``.object_config.json``, or a
            ``.scene_dataset_config.json`` of one scene. Another .json file is a floor plan, see
            :func:`~autonerf_lab.scenes.houseexpo.import_houseexpo`.
        up: Axis that points up in the file, "y" or "z". Default: the axis in the Habitat files, else estimated from the
            horizontal surfaces.
        aliases: Classes of further object names, added to the alias table: a mapping from name to class such as
            ``{"wing chair": "chair"}``, or the path of a JSON file with such a mapping.

    Returns:
        Scene in metres, z up, with its floor at z = 0 and its centre at x = y = 0.

    Raises:
        SceneError: The file has another format, is damaged, empty, not finite, too large or not in metres, has no
            floor, or refers to files that are missing or outside its folder. The message names the file.
    """
    path = Path(path)
    if up not in (None, "y", "z"):
        raise SceneError(f"up must be 'y', 'z' or None, not {up!r}")
    table = read_aliases(aliases)
    left_out: dict[str, int] = {}
    if is_habitat_config(path):
        if up is not None:
            raise SceneError(f"{path} says which axis points up; leave out up={up!r}, or correct 'up' in the file")
        parts, reason, left_out = load_config(path)
    elif path.suffix.lower() == ".json":
        from autonerf_lab.scenes.houseexpo import import_houseexpo

        if up is not None or aliases is not None:
            raise SceneError(f"{path} is a floor plan: leave out up and aliases")
        return import_houseexpo(path)
    else:
        parts, reason = load_parts(path), f"{up}, as asked for" if up else ""
        add_labels(path, parts)
    vertices = np.concatenate([p["vertices"] for p in parts])
    offsets = np.cumsum([0] + [len(p["vertices"]) for p in parts])
    faces = np.concatenate([p["faces"] + o for p, o in zip(parts, offsets, strict=False)])
    _check_geometry(path, vertices, len(faces))
    if not reason:
        up, reason = find_up(path, vertices, faces)
    vertices = vertices if up == "z" else to_z_up(vertices)
    offset = floor_offset(path, vertices, faces)
    uv, texture = build_atlas(path, parts)
    class_ids, instances, names, unknown = _semantics(path, parts, table)
    scene = Scene(
        Path(path.stem).stem if is_habitat_config(path) else path.stem,
        (vertices - offset).astype(np.float32),
        faces.astype(np.int32),
        class_ids.astype(np.uint8),
        instances.astype(np.int32),
        uv,
        partial(np.asarray, texture),
        names=names,
    )
    report = make_report(scene, str(path), reason, offset, unknown, left_out)
    for text in report.warnings:
        warnings.warn(f"{path}: {text}", stacklevel=2)
    return replace(scene, import_report=report)


def _semantics(
    path: Path, parts: list[dict[str, Any]], aliases: Mapping[str, str]
) -> tuple[np.ndarray, np.ndarray, dict[int, str], Counter[str]]:
    """Return class and instance of every face, the names of the instances, and the names that stand for no class."""
    counts = [len(p["faces"]) for p in parts]
    if semantics_path(path).exists():
        return *_from_semantics_file(path, parts, counts, aliases), Counter()
    names: dict[int, str] = {}
    unknown: Counter[str] = Counter()
    entries: dict[Any, tuple[int, int]] = {}  # (class, instance) by object

    def enter(key: Any, label: str, whole: bool) -> tuple[int, int]:
        """Return class and instance of an object; a mesh without a class is an object only if its file says so."""
        if key not in entries:
            class_id, named = class_of(label, aliases), plain_name(label) not in NO_OBJECTS
            entries[key] = (class_id, len(entries) + 1) if class_id or (whole and named) else (0, 0)
            if whole and entries[key][1]:
                names[entries[key][1]] = label
            if named and not class_id:
                unknown[plain_name(label)] += 1
        return entries[key]

    classes, instances = [], []
    for k, (part, count) in enumerate(zip(parts, counts, strict=True)):
        if "face_labels" in part:
            ids, inverse = np.unique(part["face_labels"], return_inverse=True)
            found = np.array([enter(("label", i), part["labels"][i], True) for i in ids.tolist()])[inverse]
        elif "label" in part:
            found = np.repeat([enter(("object", part["object"]), part["label"], True)], count, axis=0)
        else:
            label = part["node"] if class_of(part["node"], aliases) else part["name"]
            label = label if class_of(label, aliases) else part["node"]
            found = np.repeat([enter(("part", k), label, False)], count, axis=0)
        classes.append(found[:, 0])
        instances.append(found[:, 1])
    if len(parts) == 1 and not names:
        unknown.clear()  # the name of a whole scan
    return np.concatenate(classes), np.concatenate(instances), names, unknown


def _from_semantics_file(
    path: Path, parts: list[dict[str, Any]], counts: list[int], aliases: Mapping[str, str]
) -> tuple[np.ndarray, np.ndarray, dict[int, str]]:
    semantics = read_semantics(semantics_path(path), aliases)
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
