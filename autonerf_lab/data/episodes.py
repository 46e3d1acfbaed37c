"""Episodes of PointNav and ObjectNav in Habitat's format: ``*.json`` or ``*.json.gz``.

Positions are in Habitat's world (metres, y up, -z to the front), rotations are quaternions x y z w.
"""

import gzip
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from autonerf_lab.errors import DataError
from autonerf_lab.utils.storage import MAX_BYTES, parse_json, read_bytes, write_bytes

Vector = tuple[float, float, float]
_MAX_NUMBER = 1e5
_ENDINGS = (".json", ".scene_instance", ".glb", ".obj", ".ply", ".basis")  # of the file of a scene, last one first


@dataclass(frozen=True)
class Episode:
    """One navigation task."""

    episode_id: str
    scene_id: str  # path of the scene in its dataset
    start_position: Vector
    start_rotation: tuple[float, float, float, float]  # x y z w; without rotation, the robot looks along -z
    goals: tuple[Vector, ...]  # PointNav: the goal. ObjectNav: view points of the objects, or their centres
    category: str = ""  # of the object; empty for PointNav
    shortest: float | None = None  # length of the shortest path by the file, metres

    @property
    def scene(self) -> str:
        """Name of the scene: that of its file, without folders and endings."""
        return scene_name(self.scene_id)


def scene_name(scene_id: str) -> str:
    """Return the name of a scene from the path of its file.

    Example:
        >>> scene_name("hm3d/val/00800-TEE/TEE.basis.glb"), scene_name("102.scene_instance.json"), scene_name("home.v2")
        ('TEE', '102', 'home.v2')
    """
    name = scene_id.replace("\\", "/").rpartition("/")[2]
    for ending in _ENDINGS:
        name = name.removesuffix(ending)
    return name


class _AgentState(msgspec.Struct):
    position: Vector


class _ViewPoint(msgspec.Struct):
    agent_state: _AgentState


class _Goal(msgspec.Struct):
    position: Vector
    view_points: list[_ViewPoint] | None = None


class _Info(msgspec.Struct):
    geodesic_distance: float | None = None


class _Episode(msgspec.Struct):
    episode_id: str | int
    scene_id: str
    start_position: Vector
    start_rotation: tuple[float, float, float, float]
    goals: list[_Goal] | None = None
    object_category: str | None = None
    info: _Info | None = None


class _File(msgspec.Struct):
    episodes: list[_Episode]
    goals_by_category: dict[str, list[_Goal]] = {}


def read_episodes(path: str | Path) -> list[Episode]:
    """Read the episodes of a file.

    Raises:
        DataError: the file is missing or damaged, or an episode has no goal or implausible numbers; names the episode.
            Or the file only announces the folder ``content``, which has a file for each scene.
    """
    path = Path(path)
    data = read_bytes(path)
    if data[:2] == b"\x1f\x8b":
        try:
            decoder = zlib.decompressobj(wbits=31)
            data = decoder.decompress(data, MAX_BYTES)
        except zlib.error as error:
            raise DataError(f"{path} is damaged: {error}") from error
        if decoder.unconsumed_tail or not decoder.eof:
            raise DataError(f"{path} is cut off, or has more than {MAX_BYTES} bytes when decompressed")
    content = parse_json(data, _File, str(path))
    if not content.episodes and (path.parent / "content").is_dir():
        raise DataError(f"{path} holds no episodes; give the file of a scene, {path.parent / 'content'}/SCENE.json.gz")
    return [
        _episode(entry, content.goals_by_category, f"{path}: episodes[{k}]") for k, entry in enumerate(content.episodes)
    ]


def _episode(entry: _Episode, by_category: dict[str, list[_Goal]], where: str) -> Episode:
    category = entry.object_category or ""
    goals = entry.goals or by_category.get(f"{entry.scene_id.rpartition('/')[2]}_{category}", [])
    positions = [
        point
        for goal in goals
        for point in ([v.agent_state.position for v in goal.view_points or ()] or [goal.position])
    ]
    if not positions:
        raise DataError(
            f"{where} ({str(entry.episode_id)[:40]}) has no goal{f' of class {category!r}' if category else ''}"
        )
    if not (np.abs([entry.start_position, *positions]) < _MAX_NUMBER).all():
        raise DataError(f"{where} has a position beyond {_MAX_NUMBER:g} m")
    if abs(float(np.linalg.norm(entry.start_rotation)) - 1) > 0.01:
        raise DataError(f"{where}: 'start_rotation' must be a unit quaternion x y z w")
    shortest = entry.info.geodesic_distance if entry.info else None
    return Episode(
        str(entry.episode_id),
        entry.scene_id,
        entry.start_position,
        entry.start_rotation,
        tuple(positions),
        category,
        shortest,
    )


def write_episodes(episodes: list[Episode], path: str | Path) -> Path:
    """Write episodes as ``.json`` or, by the name of the file, ``.json.gz``, with the entries that habitat-lab needs.

    Raises:
        DataError: the file cannot be written.
    """
    path = Path(path)
    entries: list[dict[str, Any]] = []
    by_category: dict[str, list[dict[str, Any]]] = {}
    for episode in episodes:
        entry = {
            "episode_id": episode.episode_id,
            "scene_id": episode.scene_id,
            "start_position": episode.start_position,
            "start_rotation": episode.start_rotation,
            "info": {"geodesic_distance": episode.shortest},
            "goals": [{"position": point, "radius": None} for point in episode.goals],
        }
        if episode.category:
            views = [
                {"agent_state": {"position": point, "rotation": (0, 0, 0, 1)}, "iou": 0.0} for point in episode.goals
            ]
            key = f"{episode.scene_id.rpartition('/')[2]}_{episode.category}"
            goal = {"position": episode.goals[0], "radius": None, "object_id": 0, "object_category": episode.category}
            by_category[key] = [goal | {"view_points": views}]
            entry |= {"object_category": episode.category, "goals": []}
        entries.append(entry)
    content: dict[str, Any] = {"episodes": entries}
    if by_category:
        ids = {name: k for k, name in enumerate(sorted({episode.category for episode in episodes if episode.category}))}
        content |= {"category_to_task_category_id": ids, "category_to_scene_annotation_category_id": ids}
        content["goals_by_category"] = by_category
    data = msgspec.json.encode(content)
    write_bytes(path, gzip.compress(data, mtime=0) if path.suffix == ".gz" else data)
    return path
