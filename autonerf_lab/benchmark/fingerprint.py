"""Fingerprint of a grid: its names and the SHA-256 of the contents behind each name.

The content behind a name can change: a policy is trained again, a scene file is edited, a model gets other settings.
The fingerprint prevents that cells from before and after such a change are mixed in one table.
"""

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from itertools import combinations
from pathlib import Path
from typing import Any

from autonerf_lab.benchmark.grid import Grid, is_path, label
from autonerf_lab.presets import preset

CONTENT_KEYS = ("weights", "scene_files", "sizes", "settings")  # parts of a fingerprint: name -> SHA-256
LPIPS, POINTGOAL = "LPIPS", "PointGoal"  # weights used in the evaluation, not by a policy of the grid

Fingerprint = Mapping[str, Any]


def grid_fingerprint(grid: Grid, lpips: str | None = None) -> dict[str, Any]:
    """Return the fingerprint of a grid as JSON values.

    Args:
        grid: Validated grid, see :meth:`Grid.checked`.
        lpips: SHA-256 of the LPIPS weights; None: LPIPS is not computed.

    Example:
        >>> found = grid_fingerprint(Grid(("random",), ("dev-0",), 1, preset="smoke"))
        >>> found["policies"], found["weights"], list(found["scene_files"]), list(found["settings"])
        (['random'], {}, ['dev-0'], ['semantic-nerfacto'])
    """
    from autonerf_lab.nerf.models import available
    from autonerf_lab.policies import weights_sha256
    from autonerf_lab.scenes.library import folder
    from autonerf_lab.segmentation import segmenter_sha256

    weights = {label(policy): weights_sha256(policy) for policy in grid.policies} | {LPIPS: lpips}
    if "finetuning" in grid.optional:
        from autonerf_lab.evaluators.finetuning import PRETRAINED

        weights[POINTGOAL] = weights_sha256(str(PRETRAINED))
    if grid.semantics is not None:
        weights[f"segmenter {label(grid.semantics)}"] = segmenter_sha256(grid.semantics)
    files = {name: Path(name) if is_path(name) else folder() / f"{name}.json" for name in grid.scenes}
    models, size = available(), asdict(preset(grid.preset))
    if "finetuning" not in grid.optional:
        size = {key: value for key, value in size.items() if not key.startswith("finetuning_")}
    return {
        **{key: list(value) if isinstance(value, tuple) else value for key, value in asdict(grid).items()},
        "weights": {name: sha256 for name, sha256 in weights.items() if sha256 is not None},
        "scene_files": {label(name): _sha256(file.read_bytes()) for name, file in files.items() if file.is_file()},
        "sizes": {size["name"]: _settings_sha256(size)},
        "settings": {
            name: _settings_sha256(asdict(models[name].settings[size["name"]]))
            for name in grid.models
            if name in models and size["name"] in models[name].settings
        },
    }


def differences(stored: Fingerprint, requested: Fingerprint) -> list[str]:
    """Return a description of each difference; empty if a run with one fingerprint can continue the other.

    Example:
        >>> differences({"starts": 2, "weights": {}}, {"starts": 3, "weights": {}})
        ['starts: 2, not 3']
        >>> differences({"weights": {"mine": "0123456789"}}, {"weights": {"mine": "abcdefabcd", "LPIPS": "99"}})
        ['weights of mine: 01234567, not abcdefab', 'weights of LPIPS: none, not 99']
    """
    names = [key for key in requested if key not in CONTENT_KEYS and stored.get(key) != requested[key]]
    if names:  # the contents differ too, but that adds no information
        return [f"{key}: {_text(stored.get(key))}, not {_text(requested[key])}" for key in names]
    return [
        text
        for key in CONTENT_KEYS
        if key in requested
        for text in _content_differences(key, stored.get(key) or {}, requested[key])
    ]


def find_conflict(fingerprints: Mapping[Path, Fingerprint]) -> str:
    """Return a description of a name with different contents in two folders; empty if there is none.

    Example:
        >>> find_conflict({Path("a"): {"weights": {"mine": "01"}}, Path("b"): {"weights": {"mine": "02"}}})
        'a and b differ in weights of mine: 01, not 02'
    """
    for (path, one), (other_path, other) in combinations(fingerprints.items(), 2):
        for key in CONTENT_KEYS:
            first, second = one.get(key) or {}, other.get(key) or {}
            shared = [name for name in first if name in second]
            for text in _content_differences(key, {n: first[n] for n in shared}, {n: second[n] for n in shared}):
                return f"{path} and {other_path} differ in {text}"
    return ""


def _content_differences(key: str, stored: Mapping[str, str], requested: Mapping[str, str]) -> Iterator[str]:
    for name in {**stored, **requested}:
        if stored.get(name) != requested.get(name):
            one, other = (str(found.get(name, "none"))[:8] for found in (stored, requested))
            yield f"{key.replace('_', ' ')} of {name}: {one}, not {other}"


def _settings_sha256(settings: Mapping[str, Any]) -> str:
    """Return the SHA-256 of settings as JSON. Values without a JSON form are replaced by the name of their type."""
    plain = json.dumps(settings, sort_keys=True, default=lambda value: type(value).__qualname__)
    return _sha256(plain.encode())


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _text(value: Any) -> str:
    text = ", ".join(map(str, value)) if isinstance(value, list) else str(value)
    return text if len(text) <= 80 else text[:77] + "..."
