"""Geometry of Habitat's scene instances: a stage and its objects, placed in one frame.

Habitat's world has y up and -z to the front. An asset is scaled, turned by its ``up`` and ``front``, and then placed by
the translation and rotation of its instance. Without ``up``, a stage in a GLB file has z up and y to the front, and an
object y up and -z to the front, as in habitat-sim.
"""

import os
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from autonerf_lab.errors import SceneError
from autonerf_lab.scenes.class_aliases import plain_name
from autonerf_lab.scenes.habitat import hm3d, mp3d
from autonerf_lab.scenes.habitat.dataset import HabitatDataset, open_dataset, read_record
from autonerf_lab.scenes.habitat.records import DATASET, OBJECT, SCENE, STAGE, Asset, Placement, SceneInstance
from autonerf_lab.scenes.mesh_file import FORMATS, MAX_FACES, load_parts

MAX_OBJECTS = 20_000
_MAX_NUMBER = 1e4
_SHOWN = 10  # names in a message
_Y_UP = ((0.0, 1.0, 0.0), (0.0, 0.0, -1.0))  # up and front
_Z_UP = ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0))


def is_habitat_config(path: Path) -> bool:
    """Return True for the name of a scene instance, dataset, stage or object configuration.

    Example:
        >>> is_habitat_config(Path("apt_0.scene_instance.json")), is_habitat_config(Path("plan.json"))
        (True, False)
    """
    return path.name.endswith((STAGE, OBJECT, SCENE, DATASET))


def load_config(path: Path) -> tuple[list[dict[str, Any]], str, dict[str, int]]:
    """Load the meshes of a configuration.

    Returns:
        Parts as of :func:`~autonerf_lab.scenes.mesh_file.load_parts`, in Habitat's world frame, those of objects with
        ``object`` (a number) and ``label`` (name of its class or template); the up axis and why; and the number of
        instances that were left out, by reason.

    Raises:
        SceneError: A file is missing or damaged, a transform is mirrored, or units are mixed; names file and entry.
    """
    dataset = open_dataset(path)
    if path.name.endswith(DATASET):
        scenes = dataset.scenes()
        if len(scenes) != 1:
            names = ", ".join(scene.name.removesuffix(SCENE) for scene in scenes[:_SHOWN]) or "it lists none"
            raise SceneError(f"{path} is a dataset of {len(scenes)} scenes; import one of its *{SCENE} files: {names}")
        path = scenes[0]
    if path.name.endswith(SCENE):
        return _load_scene(path, dataset)
    asset = dataset.read_asset(path)
    parts, reason = _load_asset(dataset, asset, path.parent.absolute(), str(path), path.name.endswith(STAGE))
    scale = _scale(asset, str(path))
    for part in parts:
        part["vertices"] = part["vertices"] * scale @ part.pop("frame").T
    return parts, reason, {}


def add_labels(path: Path, parts: list[dict[str, Any]]) -> None:
    """Add the objects of the files of HM3D or Matterport3D beside a mesh to its parts, if there are any."""
    hm3d.add_labels(path, parts)
    mp3d.add_labels(path, parts)


def _load_scene(path: Path, dataset: HabitatDataset) -> tuple[list[dict[str, Any]], str, dict[str, int]]:
    content = read_record(path, SceneInstance)
    if len(content.object_instances) > MAX_OBJECTS:
        raise SceneError(f"{path} has {len(content.object_instances)} objects; the limit is {MAX_OBJECTS}")
    names = dataset.lexicon()
    units: dict[float, str] = {}
    known: dict[str, tuple[Asset, list[dict[str, Any]], str]] = {}
    placed: list[dict[str, Any]] = []
    reason, faces = "", 0
    for number, placement in enumerate([content.stage_instance, *content.object_instances]):
        where = f"{path}: object_instances[{number - 1}]" if number else f"{path}: stage_instance"
        key = f"{'object' if number else 'stage'} {placement.template_name}"
        if key not in known:
            asset, folder = dataset.asset("objects" if number else "stages", placement.template_name, where)
            known[key] = (asset, *_load_asset(dataset, asset, folder, where, not number))
        asset, parts, axis = known[key]
        reason = reason or axis
        units.setdefault(asset.units_to_meters, where)
        if len(units) > 1:
            text = ", ".join(f"{unit:g} ({place})" for unit, place in units.items())
            raise SceneError(f"{path}: its parts differ in 'units_to_meters': {text}; store all of them in metres")
        faces += sum(len(part["faces"]) for part in parts)
        if faces > MAX_FACES:
            raise SceneError(f"{where}: the scene has more than {MAX_FACES} triangles, the limit")
        origin = placement.translation_origin
        origin = content.translation_origin if origin in (None, "default") else origin
        for part in _place(parts, asset, placement, str(origin).lower() == "com" and number > 0, where):
            if number:
                name = names.get(-1 if asset.semantic_id is None else asset.semantic_id)
                label = name or Path(placement.template_name).name
                part |= {"object": number, "label": plain_name(label)}
            placed.append(part)
    count = len(content.articulated_object_instances)
    return placed, reason, {"articulated objects (URDF)": count} if count else {}


def _load_asset(
    dataset: HabitatDataset, asset: Asset, folder: Path, where: str, is_stage: bool
) -> tuple[list[dict[str, Any]], str]:
    """Load the mesh of a stage or object, in the frame of its file, with the rotation into Habitat's frame."""
    file = dataset.inside(folder, asset.render_asset, f"{where}: 'render_asset'")
    if not os.path.isfile(file):  # False for a name that is too long, where Path.is_file raises
        raise SceneError(f"{where}: 'render_asset' {asset.render_asset[:120]!r} does not exist in {folder}")
    if file.suffix.lower() not in FORMATS:  # such as a configuration, which could contain itself
        formats = ", ".join(sorted(FORMATS))
        raise SceneError(f"{where}: 'render_asset' {asset.render_asset[:120]!r} is not a mesh ({formats})")
    parts = load_parts(file)
    if is_stage:
        add_labels(file, parts)
    up, front = _Z_UP if is_stage and file.suffix.lower() == ".glb" else _Y_UP
    source = "the default of Habitat for a .glb stage" if up is _Z_UP[0] else "the default of Habitat"
    if asset.up is not None:
        up, source = asset.up, f"'up' of {where}"
        front = next((f for u, f in (_Y_UP, _Z_UP) if u == tuple(up)), front)
    front = asset.front or front
    frame = _frame(up, front, where)
    for part in parts:
        part["frame"] = frame
    return parts, f"{' '.join(f'{v:g}' for v in up)}: {source}"


def _frame(up: tuple[float, ...], front: tuple[float, ...], where: str) -> np.ndarray:
    """Return the rotation (3, 3) that turns ``up`` to +y and ``front`` to -z."""
    u, f = _vector(up, where, "up"), _vector(front, where, "front")
    if min(np.linalg.norm(u), np.linalg.norm(f)) < 1e-6:
        raise SceneError(f"{where}: 'up' and 'front' must not be zero")
    u, f = u / np.linalg.norm(u), f / np.linalg.norm(f)
    if abs(u @ f) > 1e-3:
        raise SceneError(f"{where}: 'up' {list(up)} and 'front' {list(front)} must be orthogonal; give both")
    return np.stack([np.cross(f, u), u, -f])


def _place(
    parts: list[dict[str, Any]], asset: Asset, placement: Placement, by_com: bool, where: str
) -> list[dict[str, Any]]:
    """Return copies of the parts of an asset at the position of an instance."""
    scale = _scale(asset, where) * _positive(placement.non_uniform_scale, where, "non_uniform_scale")
    scale = scale * _positive((placement.uniform_scale,), where, "uniform_scale")
    w, x, y, z = _vector(placement.rotation, where, "rotation")
    if abs(np.linalg.norm([w, x, y, z]) - 1) > 0.01:
        raise SceneError(f"{where}: 'rotation' must be a unit quaternion w x y z, not {list(placement.rotation)}")
    rotation = Rotation.from_quat([x, y, z, w]).as_matrix()
    shift = _vector(placement.translation, where, "translation")
    local = [part["vertices"] * scale @ part["frame"].T for part in parts]
    if by_com:  # the translation is that of the centre of mass
        if asset.com is not None:
            centre = _vector(asset.com, where, "COM") * scale
        else:
            everything = np.concatenate(local)
            centre = (everything.min(axis=0) + everything.max(axis=0)) / 2
        shift = shift - rotation @ centre
    return [
        {k: v for k, v in part.items() if k != "frame"} | {"vertices": points @ rotation.T + shift}
        for part, points in zip(parts, local, strict=True)
    ]


def _scale(asset: Asset, where: str) -> np.ndarray:
    """Return the (3,) factors from the units of an asset to metres."""
    return _positive(asset.scale, where, "scale") * _positive((asset.units_to_meters,), where, "units_to_meters")


def _vector(values: tuple[float, ...], where: str, key: str) -> np.ndarray:
    array = np.array(values, dtype=np.float64)
    if not (np.abs(array) < _MAX_NUMBER).all():
        raise SceneError(f"{where}: '{key}' must have numbers below {_MAX_NUMBER:g}, not {list(values)}")
    return array


def _positive(values: tuple[float, ...], where: str, key: str) -> np.ndarray:
    array = _vector(values, where, key)
    if (array <= 0).any():
        text = ", ".join(f"{value:g}" for value in values)
        raise SceneError(f"{where}: '{key}' must be positive, not {text}: a mirrored transform is refused")
    return array
