"""What tells a grid from any other: its names, and what was behind each of them when it began.

A name may come to mean something else: a policy is trained again, a file of a scene is edited, a setting of a model
changes. Cells from before and after would then stand in one row of a table, so each is kept by its SHA-256.
"""

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from itertools import combinations
from pathlib import Path
from typing import Any

from autonerf_lab.benchmark.grid import Grid, is_path, label
from autonerf_lab.config import preset

BEHIND = ("weights", "scene_files", "sizes", "settings")  # of the identity: name -> SHA-256
LPIPS, POINTGOAL = "LPIPS", "PointGoal"  # weights that are no policy of the grid

Identity = Mapping[str, Any]


def identity(grid: Grid, lpips: str | None = None) -> dict[str, Any]:
    """What a results folder keeps of a grid, as JSON takes it.

    Args:
        grid: checked; a name that does not exist has nothing behind it.
        lpips: SHA-256 of the weights of LPIPS, where it is measured.

    Example:
        >>> found = identity(Grid(("random",), ("dev-0",), 1, preset="smoke"))
        >>> found["policies"], found["weights"], list(found["scene_files"]), list(found["settings"])
        (['random'], {}, ['dev-0'], ['semantic-nerfacto'])
    """
    from autonerf_lab.nerf.models import available
    from autonerf_lab.policies import weights_sha256
    from autonerf_lab.scenes.library import folder

    weights = {label(policy): weights_sha256(policy) for policy in grid.policies} | {LPIPS: lpips}
    if "finetuning" in grid.optional:
        from autonerf_lab.evaluators.finetuning import PRETRAINED

        weights[POINTGOAL] = weights_sha256(str(PRETRAINED))
    files = {name: Path(name) if is_path(name) else folder() / f"{name}.json" for name in grid.scenes}
    models, size = available(), asdict(preset(grid.preset))
    if "finetuning" not in grid.optional:
        size = {key: value for key, value in size.items() if not key.startswith("finetuning_")}
    return {
        **{key: list(value) if isinstance(value, tuple) else value for key, value in asdict(grid).items()},
        "weights": {name: sha256 for name, sha256 in weights.items() if sha256 is not None},
        "scene_files": {label(name): _sha256(file.read_bytes()) for name, file in files.items() if file.is_file()},
        "sizes": {size["name"]: _fields(size)},
        "settings": {
            name: _fields(asdict(models[name].settings[size["name"]]))
            for name in grid.models
            if name in models and size["name"] in models[name].settings
        },
    }


def differences(kept: Identity, asked: Identity) -> list[str]:
    """What is not the same, for people; nothing if the one can go on with the other.

    Example:
        >>> differences({"starts": 2, "weights": {}}, {"starts": 3, "weights": {}})
        ['starts: 2, not 3']
        >>> differences({"weights": {"mine": "0123456789"}}, {"weights": {"mine": "abcdefabcd", "LPIPS": "99"}})
        ['weights of mine: 01234567, not abcdefab', 'weights of LPIPS: none, not 99']
    """
    names = [key for key in asked if key not in BEHIND and kept.get(key) != asked[key]]
    if names:  # what is behind other names differs too, and says nothing more
        return [f"{key}: {_text(kept.get(key))}, not {_text(asked[key])}" for key in names]
    return [text for key in BEHIND if key in asked for text in _behind(key, kept.get(key) or {}, asked[key])]


def mixed(identities: Mapping[Path, Identity]) -> str:
    """What has one name in two folders and is not the same; empty where nothing is.

    Example:
        >>> mixed({Path("a"): {"weights": {"mine": "01"}}, Path("b"): {"weights": {"mine": "02"}}})
        'a and b differ in weights of mine: 01, not 02'
    """
    for (path, one), (other_path, other) in combinations(identities.items(), 2):
        for key in BEHIND:
            mine, theirs = one.get(key) or {}, other.get(key) or {}
            shared = [name for name in mine if name in theirs]
            for text in _behind(key, {n: mine[n] for n in shared}, {n: theirs[n] for n in shared}):
                return f"{path} and {other_path} differ in {text}"
    return ""


def _behind(key: str, kept: Mapping[str, str], asked: Mapping[str, str]) -> Iterator[str]:
    for name in {**kept, **asked}:
        if kept.get(name) != asked.get(name):
            one, other = (str(found.get(name, "none"))[:8] for found in (kept, asked))
            yield f"{key.replace('_', ' ')} of {name}: {one}, not {other}"


def _fields(settings: Mapping[str, Any]) -> str:
    """What JSON has no word for counts by the name of its kind, which a new process says too."""
    plain = json.dumps(settings, sort_keys=True, default=lambda value: type(value).__qualname__)
    return _sha256(plain.encode())


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _text(value: Any) -> str:
    text = ", ".join(map(str, value)) if isinstance(value, list) else str(value)
    return text if len(text) <= 80 else text[:77] + "..."
