"""Mutants of files for ``benchmarks/fuzz.py``: changed bytes, and changed values of the JSON inside."""

import copy
import json
from typing import Any

import numpy as np

VALUES: list[Any] = [None, True, -1, 0, 2**31, 2**63, 10**30, 1e308, -0.5]
VALUES += ["", "x" * 5000, "../../etc/passwd", [], {}, [[]], "\x00"]
TEXTS = [value for value in VALUES if isinstance(value, str)]


def mutate_json(content: Any, rng: np.random.Generator) -> Any:
    """Replace, remove, add or rename one to three values of JSON in place, and return it."""
    for _ in range(int(rng.integers(1, 4))):
        nodes = _containers(content)
        if not nodes:
            break
        node = nodes[int(rng.integers(len(nodes)))]
        keys = list(node) if isinstance(node, dict) else list(range(len(node)))
        key = keys[int(rng.integers(len(keys)))]
        kind = int(rng.integers(6))
        if kind == 0:
            del node[key]
        elif kind == 5 and isinstance(node, dict):
            node[TEXTS[int(rng.integers(len(TEXTS)))]] = node.pop(key)
        elif kind == 1 and isinstance(node, dict):
            node["unexpected"] = copy.deepcopy(node[key])
        elif kind == 1:
            node.append(copy.deepcopy(node[key]))
        elif kind == 2 and isinstance(node[key], int | float):
            node[key] = node[key] * [10.0, -1, 1e6, 0][int(rng.integers(4))]
        else:
            node[key] = copy.deepcopy(VALUES[int(rng.integers(len(VALUES)))])
    return content


def _containers(content: Any) -> list[Any]:
    """Return the objects and lists of JSON that are not empty, outer ones first; of long lists, those of 50 entries."""
    found, stack = [], [content]
    while stack:
        node = stack.pop()
        if node and isinstance(node, dict | list):
            found.append(node)
            stack += [*(node.values() if isinstance(node, dict) else node[:50])][::-1]
    return found


def mutate_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    """Return bytes with a few values changed, a part cut, repeated or zeroed."""
    array, kind = bytearray(data), int(rng.integers(5))
    start = int(rng.integers(min(len(array), 4096) if rng.random() < 0.5 else len(array)))
    length = int(rng.integers(1, 64))
    if kind == 0:
        for _ in range(int(rng.integers(1, 8))):
            array[int(rng.integers(len(array)))] = int(rng.integers(256))
    elif kind == 1:
        del array[start:]
    elif kind == 2:
        array[start:start] = array[start : start + length]
    elif kind == 3:
        array[start : start + length] = bytes(length)
    else:
        array[start : start + 8] = [b"\xff" * 8, b"\x7f" + b"\xff" * 7, b"9" * 8][int(rng.integers(3))]
    return bytes(array)


def mutant(data: bytes, suffix: str, rng: np.random.Generator) -> bytes:
    """Return a mutant of a file: of its JSON, of a JSON header, or of its bytes."""
    if suffix == ".json" and rng.random() < 0.8:
        return json.dumps(mutate_json(json.loads(data), rng)).encode()
    if suffix in (".safetensors", ".glb") and rng.random() < 0.6:
        size, first = (8, 8) if suffix == ".safetensors" else (4, 20)
        offset = 0 if suffix == ".safetensors" else 12
        length = int.from_bytes(data[offset : offset + size], "little")
        header = mutate_json(_with_inner(json.loads(data[first : first + length])), rng)
        text = json.dumps(_without_inner(header)).encode()
        return (
            data[:offset]
            + len(text).to_bytes(size, "little")
            + data[offset + size : first]
            + text
            + data[first + length :]
        )
    return mutate_bytes(data, rng)


def _with_inner(header: Any) -> Any:
    """Parse the package's own header, a JSON text inside the safetensors header."""
    inner = header.get("__metadata__", {}).get("header")
    if inner is not None:
        header["__metadata__"]["header"] = json.loads(inner)
    return header


def _without_inner(header: Any) -> Any:
    metadata = header.get("__metadata__") if isinstance(header, dict) else None
    if isinstance(metadata, dict) and isinstance(metadata.get("header"), dict | list):
        metadata["header"] = json.dumps(metadata["header"])
    return header
