"""The specification of a scene: JSON that describes every solid, so that a later generator never changes a scene.

Top level: ``format``, ``version``, ``name``, ``seed``, ``height`` of the ceiling, ``rooms`` (category, polygon),
``openings`` (doors, windows), ``lights``, ``materials`` (name -> kind, colours, scale, seed, glow) and ``objects``,
each with ``id`` (0: the building), ``class``, ``name``, ``at``, ``yaw`` and ``parts``: the solids of ``patches.py``.
One part a line.
"""

import json
import math
from pathlib import Path
from typing import Any

from autonerf_lab.classes import CLASS_NAMES
from autonerf_lab.errors import SceneError
from autonerf_lab.scenes.procedural_textures import KINDS
from autonerf_lab.scenes.tessellation import SHAPES

FORMAT, VERSION = "autonerf-lab scene", 1
MAX_PARTS, MAX_REACH, MAX_BYTES = 100_000, 500.0, 64 * 2**20


def tidy(value: Any) -> Any:
    """Numbers to tenths of a millimetre (and of a milliradian), and whole ones without a point.

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
    """JSON a person can read and a version control system can compare: one room, light, material and part a line."""
    head = [f"{json.dumps(key)}: {_line(spec[key])}" for key in spec if not isinstance(spec[key], list | dict)]
    for key in ("rooms", "openings", "lights"):
        head.append(f"{json.dumps(key)}: [\n  " + ",\n  ".join(_line(item) for item in spec[key]) + "\n]")
    entries = (f"{json.dumps(name)}: {_line(value)}" for name, value in spec["materials"].items())
    head.append('"materials": {\n  ' + ",\n  ".join(entries) + "\n}")
    objects = []
    for thing in spec["objects"]:
        rest = _line({key: item for key, item in thing.items() if key != "parts"})[:-1]
        objects.append(rest + ', "parts": [\n    ' + ",\n    ".join(_line(part) for part in thing["parts"]) + "\n  ]}")
    head.append('"objects": [\n  ' + ",\n  ".join(objects) + "\n]")
    return "{\n" + ",\n".join(head) + "\n}\n"


def _line(value: object) -> str:
    return json.dumps(value, separators=(",", ":"), allow_nan=False)


def read_spec(path: str | Path) -> dict:
    """Read and check a specification.

    Raises:
        SceneError: missing, not JSON, or not a scene; the message names the file and the place in it.
    """
    path = Path(path)
    try:
        if path.stat().st_size > MAX_BYTES:
            raise SceneError(f"{path} is larger than {MAX_BYTES >> 20} MB: not a scene specification")
        spec = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError) as error:
        if isinstance(error, SceneError):
            raise
        raise SceneError(f"{path} is not a readable scene: {error}") from error
    try:
        check(spec)
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from error
    return spec


def check(spec: object) -> None:
    """Raise SceneError unless ``build`` can make a scene of it."""
    if not isinstance(spec, dict) or spec.get("format") != FORMAT:
        raise SceneError(f"not a scene specification: its format must be {FORMAT!r}")
    if spec.get("version") != VERSION:
        raise SceneError(f"version {spec.get('version')!r} is not supported; this program reads version {VERSION}")
    for key, kind in {
        "name": str,
        "rooms": list,
        "openings": list,
        "lights": list,
        "materials": dict,
        "objects": list,
    }.items():
        if not isinstance(spec.get(key), kind):
            raise SceneError(f"{key!r} is missing or not a JSON {kind.__name__}")
    for name, material in spec["materials"].items():
        where = f"material {name!r}"
        _need(isinstance(material, dict) and material.get("kind") in KINDS, where, "has an unknown kind")
        for key in ("color", "color2"):
            _need(key not in material or _numbers(material[key], 3, 255), where, f"has a bad {key}")
        _need(
            all(_numbers([material.get(key, 1)], 1, 1e6) for key in ("scale", "seed", "glow")),
            where,
            "has a bad number",
        )
    for light in spec["lights"]:
        _need(isinstance(light, dict) and light.get("kind") in ("lamp", "window"), "a light", "has an unknown kind")
        _need(_numbers(light.get("at"), 3) and _numbers(light.get("color"), 3), "a light", "has a bad place or colour")
        _need(_numbers([light.get("power")], 1, 1e4), "a light", "has a bad power")
        if light["kind"] == "window":
            _need(_numbers(light.get("size"), 2) and _numbers(light.get("along"), 2), "a light", "has a bad size")
    seen: set[int] = set()
    count = 0
    _need(bool(spec["objects"]), "the scene", "has no objects")
    for thing in spec["objects"]:
        _need(
            isinstance(thing, dict) and type(thing.get("id")) is int and 0 <= thing["id"] < 2**31,
            "an object",
            "has a bad id",
        )
        where = f"object {thing['id']}"
        _need(thing["id"] not in seen, where, "appears twice")
        seen.add(thing["id"])
        _need(thing.get("class") in CLASS_NAMES, where, f"has the unknown class {thing.get('class')!r}")
        _need(isinstance(thing.get("name"), str), where, "has no name")
        _need(_numbers(thing.get("at", [0, 0, 0]), 3) and _numbers([thing.get("yaw", 0)], 1), where, "has a bad place")
        _need(isinstance(thing.get("parts"), list) and bool(thing["parts"]), where, "has no parts")
        count += len(thing["parts"])
        _need(count <= MAX_PARTS, where, f"is beyond the limit of {MAX_PARTS} parts")
        for index, part in enumerate(thing["parts"]):
            _check_part(part, spec["materials"], f"{where}, part {index}")


def _need(condition: bool, where: str, what: str) -> None:
    if not condition:
        raise SceneError(f"{where} {what}")


def _numbers(value: object, count: int | None = None, limit: float = MAX_REACH) -> bool:
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
    _need(_numbers(part.get("at", [0, 0, 0]), 3), where, "has a bad 'at'")
    _need(
        _numbers([part.get("yaw", 0), part.get("tilt", 0), part.get("power", 2)], 3), where, "has a bad angle or power"
    )
    value = part[kinds[0]]
    if kinds[0] == "box":
        _need(_numbers(value, 3) and min(value) > 0, where, "has a bad size")
        _need(isinstance(part.get("omit", ""), str), where, "has a bad 'omit'")
    elif kinds[0] == "leaf":
        _need(_numbers(value, 3), where, "has a bad leaf")
    else:
        width = 3 if kinds[0] == "quad" else 2
        _need(isinstance(value, list) and 2 <= len(value) <= 256, where, f"has a bad {kinds[0]}")
        _need(all(_numbers(row, width) for row in value), where, f"has a bad {kinds[0]}")
        _need(kinds[0] != "quad" or len(value) == 2, where, "needs two edges")
        _need(kinds[0] != "ribbon" or _numbers([part.get("height")], 1), where, "has a bad height")
        _need(type(part.get("n", 12)) is int and 3 <= part.get("n", 12) <= 256, where, "has a bad 'n'")
        _need(part.get("power", 2) > 0, where, "has a bad power")
        _need(
            _numbers(part.get("scale", [1, 1]), 2) and _numbers(part.get("arc", [0, 1]), 2),
            where,
            "has a bad scale or arc",
        )
