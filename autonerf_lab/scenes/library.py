"""Library of frozen scenes: 55 apartments (25 for training, 5 development, 5 validation, 20 test) and 5 houses."""

import hashlib
from dataclasses import replace
from functools import lru_cache, partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from autonerf_lab.errors import SceneError, UnknownNameError
from autonerf_lab.scenes.build import build
from autonerf_lab.scenes.scene import Scene
from autonerf_lab.scenes.spec import read_spec
from autonerf_lab.scenes.texture_cache import cached_texture
from autonerf_lab.utils.storage import read_json

SPLITS = {"train": 25, "dev": 5, "val": 5, "test": 20, "house": 5}


def scene_names(split: str | None = None) -> list[str]:
    """Return the names of the frozen scenes, of all splits or of one (train, dev, val, test, house).

    Raises:
        UnknownNameError: There is no such split.

    Example:
        >>> scene_names("val")
        ['val-0', 'val-1', 'val-2', 'val-3', 'val-4']
        >>> len(scene_names())
        60
    """
    if split is not None and split not in SPLITS:
        raise UnknownNameError("split", split, SPLITS)
    wanted = SPLITS if split is None else {split: SPLITS[split]}
    return [f"{name}-{k:02d}" if n > 10 else f"{name}-{k}" for name, n in wanted.items() for k in range(n)]


def folder() -> Path:
    """Return the folder of the frozen scenes: in the checkout, or inside the installed package.

    Raises:
        SceneError: Neither folder contains them.
    """
    checkout = Path(__file__).resolve().parents[2] / "data" / "procedural_scenes"
    if (checkout / "manifest.json").exists():
        return checkout
    installed = find_spec("autonerf_lab.procedural_scenes")
    for location in (installed.submodule_search_locations or []) if installed else []:
        if (Path(location) / "manifest.json").exists():
            return Path(location)
    raise SceneError(f"the frozen scenes are missing in {checkout}; reinstall autonerf-lab")


def load_scene(name: str) -> Scene:
    """Load a frozen scene by name, or a specification by path.

    Args:
        name: Name such as ``val-0`` (see :func:`scene_names`), or the path of a specification (.json).

    Raises:
        UnknownNameError: There is no such scene; the message lists the valid names.
        SceneError: The file is missing, damaged or differs from the manifest; the message names the file.

    Example:
        >>> load_scene("dev-9")  # doctest: +ELLIPSIS
        Traceback (most recent call last):
        autonerf_lab.errors.UnknownNameError: unknown scene 'dev-9'; valid names: dev-0, ...
    """
    if str(name).endswith(".json"):
        return build(read_spec(name))
    if name not in scene_names():
        raise UnknownNameError("scene", str(name), scene_names())
    path = folder() / f"{name}.json"
    expected = _manifest(path.parent / "manifest.json")["scenes"].get(name, {}).get("spec_sha256")
    spec = read_spec(path)
    found = hashlib.sha256(path.read_bytes()).hexdigest()
    if expected != found:
        raise SceneError(
            f"{path} was modified: its SHA-256 is {found[:12]}, the manifest expects {str(expected)[:12]};"
            " reinstall autonerf-lab"
        )
    scene = build(spec)
    return replace(scene, bake=partial(cached_texture, name, found, scene.bake))


@lru_cache(maxsize=4)
def _manifest(path: Path) -> dict:
    content = read_json(path, dict[str, Any])
    if not isinstance(content.get("scenes"), dict):
        raise SceneError(f"{path} has no valid entry 'scenes'; reinstall autonerf-lab")
    return content
