"""The 35 frozen apartments: 25 to train on, 5 to develop on, 5 to validate on."""

import hashlib
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path

from autonerf_lab.errors import SceneError, UnknownNameError
from autonerf_lab.scenes.build import build
from autonerf_lab.scenes.scene import Scene
from autonerf_lab.scenes.spec import read_spec
from autonerf_lab.utils.storage import read_json

SPLITS = {"train": 25, "dev": 5, "val": 5}


def scene_names(split: str | None = None) -> list[str]:
    """Names of the frozen scenes, all or one split's (train, dev, val).

    Raises:
        UnknownNameError: no such split.

    Example:
        >>> scene_names("val")
        ['val-0', 'val-1', 'val-2', 'val-3', 'val-4']
        >>> len(scene_names())
        35
    """
    if split is not None and split not in SPLITS:
        raise UnknownNameError("split", split, SPLITS)
    wanted = SPLITS if split is None else {split: SPLITS[split]}
    return [f"{name}-{k:02d}" if name == "train" else f"{name}-{k}" for name, n in wanted.items() for k in range(n)]


def folder() -> Path:
    """Where the frozen specifications are: beside the package in a checkout, inside it when installed.

    Raises:
        SceneError: neither place has them.
    """
    checkout = Path(__file__).resolve().parents[2] / "data" / "procedural_scenes"
    if (checkout / "manifest.json").exists():
        return checkout
    installed = find_spec("autonerf_lab.procedural_scenes")
    for place in (installed.submodule_search_locations or []) if installed else []:
        if (Path(place) / "manifest.json").exists():
            return Path(place)
    raise SceneError(f"the frozen scenes are not in {checkout}; install the package again")


def load_scene(name: str) -> Scene:
    """One of the frozen scenes by name, or any specification by path.

    Raises:
        UnknownNameError: lists the valid names.
        SceneError: the file is missing, damaged, or not what the manifest says; it names the file.

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
        raise SceneError(f"{path} was changed: its SHA-256 is {found[:12]}, the manifest says {str(expected)[:12]}")
    return build(spec)


@lru_cache(maxsize=4)
def _manifest(path: Path) -> dict:
    content = read_json(path)
    if not isinstance(content.get("scenes"), dict):
        raise SceneError(f"{path} has no list of scenes")
    return content
