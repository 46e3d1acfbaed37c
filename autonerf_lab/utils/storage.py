"""Atomic file writes, JSON and safetensors. Each write goes to a temporary file that then replaces the target."""

import errno
import json
import os
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save

from autonerf_lab.errors import DataError

_NO_SPACE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_TEMPORARY = re.compile(r"\..+\.\w+\.[a-z0-9_]{8}")  # names that mkstemp makes from the prefix in write_bytes


def write_bytes(path: str | Path, data: bytes) -> None:
    """Write a file atomically: readers see the old or the new content, never a part, also after a crash.

    Raises:
        DataError: The file cannot be written (disk full, no permission). The old file is unchanged.

    Example:
        >>> import tempfile; folder = Path(tempfile.mkdtemp())
        >>> write_bytes(folder / "a.bin", b"123"); (folder / "a.bin").read_bytes()
        b'123'
    """
    path = Path(path)
    temporary: str | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, 0o644)  # mkstemp creates files that only the owner can read
        os.replace(temporary, path)
    except OSError as error:
        if temporary is not None:
            Path(temporary).unlink(missing_ok=True)
        raise DataError(
            f"cannot write {path}: {error.strerror or error}; free some space or choose another folder"
        ) from error


def interrupted_writes(folder: str | Path) -> Iterator[Path]:
    """Yield the temporary files that interrupted calls of :func:`write_bytes` left in a folder.

    Example:
        >>> folder = Path(tempfile.mkdtemp())
        >>> for name in ("a.json", ".a.json.abc_d123", ".lock", ".a.json.backup"):
        ...     (folder / name).touch()
        >>> [path.name for path in interrupted_writes(folder)]
        ['.a.json.abc_d123']
    """
    for path in Path(folder).glob(".*"):
        if _TEMPORARY.fullmatch(path.name) and path.is_file() and not path.is_symlink():
            yield path


def is_disk_full(error: BaseException | None) -> bool:
    """Return True if an error was caused by a full disk or a disk quota.

    Example:
        >>> is_disk_full(OSError(errno.ENOSPC, "No space left on device")), is_disk_full(ValueError())
        (True, False)
    """
    while error is not None:
        if isinstance(error, OSError) and error.errno in _NO_SPACE:
            return True
        error = error.__cause__ or error.__context__
    return False


def write_json(path: str | Path, content: object) -> None:
    """Write standard JSON, which allows finite numbers only.

    Raises:
        DataError: The file cannot be written, or a value has no JSON representation.
    """
    try:
        text = json.dumps(content, indent=1, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise DataError(f"cannot write {path}: {error}") from error
    write_bytes(path, text.encode() + b"\n")


def read_json(path: str | Path) -> dict:
    """Read a JSON file whose top level is an object.

    Raises:
        DataError: The file is missing or is not a JSON object.

    Example:
        >>> read_json("/nowhere.json")
        Traceback (most recent call last):
        autonerf_lab.errors.DataError: /nowhere.json does not exist
    """
    path = Path(path)
    try:
        content = json.loads(path.read_bytes())
    except FileNotFoundError as error:
        raise DataError(f"{path} does not exist") from error
    except (OSError, ValueError, RecursionError) as error:
        raise DataError(f"{path} is not readable JSON: {error}") from error
    if not isinstance(content, dict):
        raise DataError(f"{path} must hold a JSON object, not a {type(content).__name__}")
    return content


def write_arrays(path: str | Path, arrays: dict[str, np.ndarray], header: dict[str, Any] | None = None) -> None:
    """Write named arrays as safetensors, with an optional JSON ``header`` in the metadata.

    Raises:
        DataError: The file cannot be written.

    Example:
        >>> import tempfile; path = Path(tempfile.mkdtemp()) / "a.safetensors"
        >>> write_arrays(path, {"transposed": np.array([[1, 2, 3], [4, 5, 6]]).T})
        >>> read_arrays(path)[0]["transposed"].tolist()
        [[1, 4], [2, 5], [3, 6]]
    """
    contiguous = {name: np.asarray(array, order="C") for name, array in arrays.items()}  # `save` requires C order
    write_bytes(path, save(contiguous, None if header is None else {"header": json.dumps(header)}))


def read_arrays(path: str | Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Return the arrays and the header (empty if absent) of a file of :func:`write_arrays`.

    Raises:
        DataError: The file is missing or damaged.

    Example:
        >>> read_arrays("/nowhere.safetensors")
        Traceback (most recent call last):
        autonerf_lab.errors.DataError: /nowhere.safetensors does not exist
    """
    path = Path(path)
    try:
        data = path.read_bytes()
        length = int.from_bytes(data[:8], "little")
        metadata = json.loads(data[8 : 8 + length]).get("__metadata__", {})
        return load(data), json.loads(metadata.get("header", "{}"))
    except FileNotFoundError as error:
        raise DataError(f"{path} does not exist") from error
    except (OSError, SafetensorError, ValueError, AttributeError, KeyError) as error:
        raise DataError(f"{path} is damaged, not a readable safetensors file: {error}") from error
