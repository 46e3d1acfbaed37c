"""Dataset of Habitat: finds the configuration of a stage or object by the name that a scene gives it.

A reader of files stays inside the folder of the dataset configuration, or of the file itself if there is none.
"""

import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from autonerf_lab.errors import DataError, SceneError
from autonerf_lab.scenes.habitat.records import (
    DATASET,
    OBJECT,
    SCENE,
    STAGE,
    Asset,
    AssetGroup,
    DerivedAsset,
    Lexicon,
    SceneDataset,
)
from autonerf_lab.utils.storage import parse_json, read_json

T = TypeVar("T")
MAX_FILES = 200_000  # of a dataset
_PARENTS = 6  # folders above a scene in which its dataset is looked for


def read_record(path: Path, kind: type[T]) -> T:
    """Read a configuration file.

    Raises:
        SceneError: The file is missing or damaged; the message names the file and the entry.
    """
    try:
        return read_json(path, kind)
    except DataError as error:
        raise SceneError(str(error)) from error


@dataclass(frozen=True)
class HabitatDataset:
    """Files of a dataset; without a dataset configuration, the files beside a single configuration."""

    root: Path  # folder that all files must lie in
    content: SceneDataset = field(default_factory=SceneDataset)
    path: Path | None = None  # of the dataset configuration

    def scenes(self) -> list[Path]:
        """Return the scene instances of the dataset, sorted."""
        return sorted(self._files(self.content.scene_instances, SCENE))

    def asset(self, group_name: str, name: str, where: str) -> tuple[Asset, Path]:
        """Return a stage or object by its name, and the folder to which its ``render_asset`` is relative.

        Args:
            group_name: ``stages`` or ``objects``.
            name: ``template_name`` of a scene: a configuration of the dataset, a file without its ending, or the last
                part of its path; else, as in habitat-sim, a part of a name, of which the first in the alphabet counts.
            where: File and entry, for messages.

        Raises:
            SceneError: There is no such configuration, or it is damaged.
        """
        group: AssetGroup = getattr(self.content, group_name)
        known = self._stages if group_name == "stages" else self._objects
        key = _key(name)
        found = known.get(key) or known.get(key.rpartition("/")[2])
        if found is None and key:
            found = known.get(min((other for other in known if key.lower() in other.lower()), default=key))
        if found is None:
            place = self.path or self.root
            raise SceneError(f"{where}: {name[:120]!r} is not among the {len(known)} names of {group_name} in {place}")
        if isinstance(found, DerivedAsset):
            return self._derived(group, found, where)
        return self.read_asset(found, group.default_attributes), found.parent

    def read_asset(self, file: Path, defaults: dict[str, Any] | None = None) -> Asset:
        """Read a stage or object configuration; a mesh file is a configuration with default values."""
        content = read_record(file, dict[str, Any]) if file.suffix == ".json" else {"render_asset": file.name}
        return _asset({**(defaults or {}), **content}, str(file))

    def _derived(self, group: AssetGroup, entry: DerivedAsset, where: str) -> tuple[Asset, Path]:
        assert self.path is not None
        base, folder = {}, self.path.parent
        if entry.original_file is not None:
            file = self.inside(folder, entry.original_file, f"{self.path}: 'original_file'")
            if not os.path.isfile(file):
                raise SceneError(f"{self.path}: 'original_file' {entry.original_file[:120]!r} does not exist")
            base = read_record(file, dict[str, Any])
            folder = folder if "render_asset" in entry.attributes else file.parent
        content = {**group.default_attributes, **base, **entry.attributes}
        return _asset(content, f"{self.path}: {entry.template_handle!r} ({where})"), folder

    def inside(self, folder: Path, name: str, where: str) -> Path:
        """Return the path of a file relative to a folder, which must lie inside the dataset."""
        file = Path(os.path.normpath(folder / name.replace("\\", "/")))
        if "\0" in name or not file.is_relative_to(self.root):
            raise SceneError(f"{where}: {name[:80]!r} is outside {self.root}; move the file into it")
        return file

    def lexicon(self) -> dict[int, str]:
        """Return the names of the semantic ids; empty without a lexicon."""
        found: dict[int, str] = {}
        entries = self.content.semantic_scene_descriptor_instances
        paths = entries.get("paths", {})
        try:
            paths = msgspec.convert(paths, dict[str, list[str]])
        except msgspec.ValidationError as error:
            raise SceneError(f"{self.path}: 'semantic_scene_descriptor_instances': {error}") from error
        named = [value for key, value in entries.items() if key != "paths" and isinstance(value, str)]
        group = AssetGroup(paths={".json": [*paths.get(".json", []), *named]})
        for file in self._files(group, ".json"):
            content = read_record(file, dict[str, Any])
            if "classes" in content:  # others describe regions
                try:
                    classes = msgspec.convert(content, Lexicon).classes
                except msgspec.ValidationError as error:
                    raise SceneError(f"{file} is not as expected: {error}") from error
                found |= {entry.id: entry.name for entry in classes}
        return found

    @cached_property
    def _stages(self) -> dict[str, Path | DerivedAsset]:
        return self._index(self.content.stages, STAGE)

    @cached_property
    def _objects(self) -> dict[str, Path | DerivedAsset]:
        return self._index(self.content.objects, OBJECT)

    def _index(self, group: AssetGroup, ending: str) -> dict[str, Path | DerivedAsset]:
        """Return the files of a group by their path in the dataset and by their name, both without the ending.

        A configuration replaces its mesh, and one that the dataset defines itself replaces a file of its name.
        """
        found: dict[str, Path | DerivedAsset] = {}
        for file in (*self._files(group, ".glb"), *self._files(group, ending)):
            found |= {_key(file.relative_to(self.root).as_posix()): file, _key(file.name): file}
        return found | {_key(entry.template_handle): entry for entry in group.configs if entry.template_handle}

    def _files(self, group: AssetGroup, ending: str) -> Iterator[Path]:
        """Yield the files of a group that have an ending, at most :data:`MAX_FILES`."""
        if self.path is None:
            yield from sorted(self.root.glob(f"*{ending}"))
            return
        count = 0
        for pattern in group.paths.get(".glb" if ending == ".glb" else ".json", []):
            place = self.inside(self.path.parent, pattern, f"{self.path}: 'paths'")
            try:
                found = [place] if place == self.root else sorted(self.root.glob(str(place.relative_to(self.root))))
            except (ValueError, NotImplementedError, OSError, IndexError) as error:
                reason = f"{pattern[:80]!r} is not a pattern: {str(error)[:80]}"
                raise SceneError(f"{self.path}: 'paths': {reason}") from error
            for place in found:
                for file in sorted(place.glob(f"*{ending}")) if os.path.isdir(place) else [place]:
                    if file.name.endswith(ending) and os.path.isfile(file) and (count := count + 1) <= MAX_FILES:
                        yield file


def open_dataset(path: Path) -> HabitatDataset:
    """Return the dataset of a configuration file: one in a folder above that lists it, or else that folder alone."""
    if path.name.endswith(DATASET):
        return HabitatDataset(_absolute(path).parent, read_record(path, SceneDataset), _absolute(path))
    folder = _absolute(path).parent
    for parent in [folder, *folder.parents][:_PARENTS]:
        for file in sorted(parent.glob(f"*{DATASET}")):
            dataset = open_dataset(file)
            listed = [
                other
                for group, ending in (("scene_instances", SCENE), ("stages", STAGE), ("objects", OBJECT))
                if path.name.endswith(ending)
                for other in dataset._files(getattr(dataset.content, group), ending)
            ]
            if _absolute(path) in listed:
                return dataset
    return HabitatDataset(folder)


def _absolute(path: Path) -> Path:
    return Path(os.path.normpath(path.absolute()))


def _asset(content: dict[str, Any], where: str) -> Asset:
    try:
        return parse_json(msgspec.json.encode(content), Asset, where)
    except DataError as error:
        raise SceneError(str(error)) from error


def _key(name: str) -> str:
    """Return a name without the ending of a configuration or mesh."""
    for ending in (STAGE, OBJECT, SCENE, ".glb"):
        name = name.removesuffix(ending)
    return name.removeprefix("./")
