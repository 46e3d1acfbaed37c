"""Specification of a scene: JSON that describes every solid. A change of the generator does not affect it.

Top level: ``format``, ``version``, ``name``, ``seed``, ``height`` of the ceiling, ``rooms`` (category, polygon),
``openings`` (doors, windows), ``lights``, ``materials`` (name -> kind, colours, scale, seed, glow) and ``objects``,
each with ``id`` (0: the building), ``class``, ``name``, ``at``, ``yaw`` and ``parts``, the solids of
:mod:`autonerf_lab.scenes.tessellation`. Lengths are in metres, angles in radians.
"""

import json
import math
from pathlib import Path
from typing import Any

from autonerf_lab.classes import CLASS_NAMES
from autonerf_lab.errors import DataError, SceneError
from autonerf_lab.scenes.procedural_textures import KINDS
from autonerf_lab.scenes.tessellation import SHAPES
from autonerf_lab.utils.storage import parse_json, read_bytes

FORMAT, VERSION = "autonerf-lab scene", 1
MAX_PARTS, MAX_REACH, MAX_BYTES = 100_000, 500.0, 64 * 2**20


def tidy(value: Any) -> Any:
    """Round all floats to 4 decimals (0.1 mm), write whole ones as integers, and convert tuples to lists.

    Example:
        >>> tidy({"at": [0.12345678, 2.0]})
        {'at': [0.1235, 2]}
    """
    if isinstance(value, dict):
        return {key: tidy(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [tidy(item) for item in value]
    if isinstance(value, float):
        short = round(float(value), 4)
        return int(short) if short == int(short) else short
    return value if isinstance(value, int | str) or value is None else int(value)


def dumps(spec: dict) -> str:
    """Return a specification as JSON with one room, opening, light, material or part per line."""
    head = [f"{json.dumps(key)}: {_line(spec[key])}" for key in spec if not isinstance(spec[key], list | dict)]
    for key in ("rooms", "openings", "lights"):
        head.append(f"{json.dumps(key)}: [\n  " + ",\n  ".join(_line(item) for item in spec[key]) + "\n]")
    entries = (f"{json.dumps(name)}: {_line(value)}" for name, value in spec["materials"].items())
    head.append('"materials": {\n  ' + ",\n  ".join(entries) + "\n}")
    objects = []
    for entry in spec["objects"]:
        rest = _line({key: item for key, item in entry.items() if key != "parts"})[:-1]
        objects.append(rest + ', "parts": [\n    ' + ",\n    ".join(_line(part) for part in entry["parts"]) + "\n  ]}")
    head.append('"objects": [\n  ' + ",\n  ".join(objects) + "\n]")
    return "{\n" + ",\n".join(head) + "\n}\n"


def _line(value: object) -> str:
    return json.dumps(value, separators=(",", ":"), allow_nan=False)


def read_spec(path: str | Path) -> dict:
    """Read and validate a specification.

    Raises:
        SceneError: The file is missing, not JSON or not a valid specification; the message names the file and the
            invalid entry.
    """
    path = Path(path)
    try:
        spec: Any = parse_json(read_bytes(path, MAX_BYTES), Any, str(path))
    except DataError as error:
        raise SceneError(str(error)) from error
    try:
        check(spec)
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from error
    return spec


def check(spec: object) -> None:
    """Validate a specification.

    Raises:
        SceneError: ``build`` could not build a scene from it; the message names the invalid entry.
    """
    if not isinstance(spec, dict) or spec.get("format") != FORMAT:
        raise SceneError(f"not a scene specification: its format must be {FORMAT!r}")
    if spec.get("version") != VERSION:
        raise SceneError(f"version {spec.get('version')!r} is not supported; this release reads version {VERSION}")
    for key, kind in {
        "name": str,
        "rooms": list,
        "openings": list,
        "lights": list,
        "materials": dict,
        "objects": list,
    }.items():
        if not isinstance(spec.get(key), kind):
            raise SceneError(
                f"{key!r} must be a JSON {'object' if kind is dict else 'list' if kind is list else 'string'}"
            )
    for name, material in spec["materials"].items():
        where = f"material {name!r}"
        _need(isinstance(material, dict) and material.get("kind") in list(KINDS), where, "has an unknown kind")
        for key in ("color", "color2"):
            _need(key not in material or _are_numbers(material[key], 3, 255), where, f"needs three numbers as {key}")
        _need(
            all(_are_numbers([material.get(key, 1)], 1, 1e6) for key in ("scale", "seed", "glow")),
            where,
            "needs numbers as scale, seed and glow",
        )
    for light in spec["lights"]:
        _need(isinstance(light, dict) and light.get("kind") in ("lamp", "window"), "a light", "has an unknown kind")
        _need(
            _are_numbers(light.get("at"), 3) and _are_numbers(light.get("color"), 3),
            "a light",
            "needs three numbers as at and color",
        )
        _need(_are_numbers([light.get("power")], 1, 1e4), "a light", "needs a number as power")
        if light["kind"] == "window":
            _need(
                _are_numbers(light.get("size"), 2) and _are_numbers(light.get("along"), 2),
                "a light",
                "needs two numbers as size and along",
            )
    seen: set[int] = set()
    count = 0
    _need(bool(spec["objects"]), "the scene", "has no objects")
    for entry in spec["objects"]:
        _need(
            isinstance(entry, dict) and type(entry.get("id")) is int and 0 <= entry["id"] < 2**31,
            "an object",
            "needs an integer as id",
        )
        where = f"object {entry['id']}"
        _need(entry["id"] not in seen, where, "appears twice")
        seen.add(entry["id"])
        _need(entry.get("class") in CLASS_NAMES, where, f"has the unknown class {entry.get('class')!r}")
        _need(isinstance(entry.get("name"), str), where, "has no name")
        _need(
            _are_numbers(entry.get("at", [0, 0, 0]), 3) and _are_numbers([entry.get("yaw", 0)], 1),
            where,
            "needs three numbers as at and one as yaw",
        )
        _need(isinstance(entry.get("parts"), list) and bool(entry["parts"]), where, "has no parts")
        count += len(entry["parts"])
        _need(count <= MAX_PARTS, where, f"exceeds the limit of {MAX_PARTS} parts per scene")
        for index, part in enumerate(entry["parts"]):
            _check_part(part, spec["materials"], f"{where}, part {index}")


def _need(condition: bool, where: str, what: str) -> None:
    if not condition:
        raise SceneError(f"{where} {what}")


def _are_numbers(value: object, count: int | None = None, limit: float = MAX_REACH) -> bool:
    return (
        isinstance(value, list)
        and (count is None or len(value) == count)
        and all(type(v) in (int, float) and math.isfinite(v) and abs(v) <= limit for v in value)
    )


def _check_part(part: object, materials: dict, where: str) -> None:
    _need(isinstance(part, dict), where, "is not a JSON object")
    assert isinstance(part, dict)
    kinds = [key for key in ("box", *SHAPES) if key in part]
    _need(len(kinds) == 1, where, f"must have exactly one of box, {', '.join(SHAPES)}")
    _need(
        isinstance(part.get("m"), str) and part["m"] in materials, where, f"has the unknown material {part.get('m')!r}"
    )
    _need(_are_numbers(part.get("at", [0, 0, 0]), 3), where, "needs three numbers as 'at'")
    _need(
        _are_numbers([part.get("yaw", 0), part.get("tilt", 0), part.get("power", 2)], 3),
        where,
        "needs numbers as yaw, tilt and power",
    )
    value = part[kinds[0]]
    if kinds[0] == "box":
        _need(_are_numbers(value, 3) and min(value) > 0, where, "needs three positive numbers as box")
        _need(isinstance(part.get("omit", ""), str), where, "needs a string as 'omit'")
    elif kinds[0] == "leaf":
        _need(_are_numbers(value, 3), where, "needs three numbers as leaf")
    else:
        width = 3 if kinds[0] == "quad" else 2
        _need(isinstance(value, list) and 2 <= len(value) <= 256, where, f"needs 2 to 256 points as {kinds[0]}")
        _need(all(_are_numbers(row, width) for row in value), where, f"needs {width} numbers per point of {kinds[0]}")
        _need(kinds[0] != "quad" or len(value) == 2, where, "needs two edges as quad")
        _need(kinds[0] != "ribbon" or _are_numbers([part.get("height")], 1), where, "needs a number as height")
        _need(
            type(part.get("n", 12)) is int and 3 <= part.get("n", 12) <= 256,
            where,
            "needs an integer from 3 to 256 as 'n'",
        )
        _need(part.get("power", 2) > 0, where, "needs a positive power")
        _need(
            _are_numbers(part.get("scale", [1, 1]), 2) and _are_numbers(part.get("arc", [0, 1]), 2),
            where,
            "needs two numbers as scale and arc",
        )
