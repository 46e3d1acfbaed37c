"""Atomic file writes, JSON and safetensors. Each write goes to a temporary file that then replaces the target."""

import errno
import json
import os
import re
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save

from autonerf_lab.errors import DataError

T = TypeVar("T")

MAX_BYTES = 256 << 20  # of a file that is read
MAX_ARRAY_BYTES = 2 << 30  # the checkpoint of a large field has four copies of its parameters
MAX_JSON_BYTES = 32 << 20  # parsed JSON takes about ten times as much memory
_NO_SPACE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_TEMPORARY = re.compile(r"\..+\.\w+\.[a-z0-9_]{8}")  # names that mkstemp makes from the prefix in write_bytes


def write_bytes(path: str | Path, data: bytes, durable: bool = True) -> None:
    """Write a file atomically: readers see the old or the new content, never a part, also after a crash.

    Args:
        path: The file; its folder is created.
        data: Content.
        durable: Wait for the disk, so that the file also survives a power failure. Without it many small files are
            written ten times faster, and a killed process still leaves complete files only.

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
            if durable:
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
    write_bytes(path, _json_text(path, content, indent=1).encode() + b"\n")


def _json_text(path: str | Path, content: object, indent: int | None = None) -> str:
    """Return content as JSON, which allows finite numbers only; ``path`` is named in errors."""
    try:
        return json.dumps(content, indent=indent, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise DataError(f"cannot write {path}: {error}") from error


def check_file(path: str | Path, max_bytes: int = MAX_BYTES) -> None:
    """Check that a path is a regular file of limited size, before it is opened: a pipe would wait for its writer.

    Raises:
        DataError: The file is missing, is too large, or is a folder, device or pipe.

    Example:
        >>> check_file("/dev/zero")
        Traceback (most recent call last):
        autonerf_lab.errors.DataError: /dev/zero is not a regular file
    """
    try:
        info = os.stat(path)
    except FileNotFoundError as error:
        raise DataError(f"{path} does not exist") from error
    except (OSError, ValueError) as error:  # ValueError: a null character in the path
        raise DataError(f"cannot read {path}: {error}") from error
    if not stat.S_ISREG(info.st_mode):
        raise DataError(f"{path} is not a regular file")
    if info.st_size > max_bytes:
        raise DataError(f"{path} has {info.st_size} bytes; at most {max_bytes} are read")


def read_bytes(path: str | Path, max_bytes: int = MAX_BYTES) -> bytes:
    """Read a regular file of limited size.

    Raises:
        DataError: See :func:`check_file`, or the file cannot be read.
    """
    check_file(path, max_bytes)
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise DataError(f"cannot read {path}: {error}") from error


def read_json(path: str | Path, kind: type[T]) -> T:
    """Read a JSON file and check its content against a type.

    Args:
        path: The file.
        kind: Type of the content: ``dict[str, Any]``, or a dataclass whose annotations are checked recursively. Keys
            that a dataclass does not have are ignored.

    Raises:
        DataError: The file is missing, is not JSON, or does not match the type; the message names the file and field.

    Example:
        >>> read_json("/nowhere.json", dict[str, Any])
        Traceback (most recent call last):
        autonerf_lab.errors.DataError: /nowhere.json does not exist
    """
    return parse_json(read_bytes(path, MAX_JSON_BYTES), kind, str(path))


def parse_json(data: bytes, kind: type[T], where: str) -> T:
    """Parse JSON and check it against a type, as :func:`read_json` does; ``where`` names the source in messages.

    Example:
        >>> parse_json(b'{"a": [1, "x"]}', dict[str, list[int]], "file.json")
        Traceback (most recent call last):
        autonerf_lab.errors.DataError: file.json is not as expected: Expected `int`, got `str` - at `$[...][1]`
    """
    try:
        return msgspec.json.decode(data, type=kind)
    except msgspec.ValidationError as error:
        raise DataError(f"{where} is not as expected: {error}") from error
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:
        raise DataError(f"{where} is not readable JSON: {error}") from error


def write_arrays(path: str | Path, arrays: dict[str, np.ndarray], header: dict[str, Any] | None = None) -> None:
    """Write named arrays as safetensors, with an optional JSON ``header`` in the metadata.

    Raises:
        DataError: The file cannot be written, or a value of the header has no JSON representation.

    Example:
        >>> import tempfile; path = Path(tempfile.mkdtemp()) / "a.safetensors"
        >>> write_arrays(path, {"transposed": np.array([[1, 2, 3], [4, 5, 6]]).T})
        >>> read_arrays(path, dict[str, Any])[0]["transposed"].tolist()
        [[1, 4], [2, 5], [3, 6]]
    """
    contiguous = {name: np.asarray(array, order="C") for name, array in arrays.items()}  # `save` requires C order
    write_bytes(path, save(contiguous, None if header is None else {"header": _json_text(path, header)}))


def read_arrays(path: str | Path, header: type[T]) -> tuple[dict[str, np.ndarray], T]:
    """Read the arrays and the header of a file of :func:`write_arrays`.

    Args:
        path: The file.
        header: Type of the header, checked as by :func:`read_json`; an absent header counts as empty.

    Raises:
        DataError: The file is missing, damaged, or its header does not match the type.

    Example:
        >>> read_arrays("/nowhere.safetensors", dict[str, Any])
        Traceback (most recent call last):
        autonerf_lab.errors.DataError: /nowhere.safetensors does not exist
    """
    return parse_arrays(read_bytes(path, MAX_ARRAY_BYTES), header, str(path))


def parse_arrays(data: bytes, header: type[T], source: str) -> tuple[dict[str, np.ndarray], T]:
    """Decode the content of a file of :func:`write_arrays`.

    Args:
        data: The content.
        header: Type of the header, checked as by :func:`read_json`; an absent header counts as empty.
        source: Name of the file in error messages.

    Raises:
        DataError: The content is damaged, or its header does not match the type.

    Example:
        >>> parse_arrays(b"text", dict[str, Any], "nerf.safetensors")  # doctest: +ELLIPSIS
        Traceback (most recent call last):
        autonerf_lab.errors.DataError: nerf.safetensors is damaged, not a readable safetensors file: ...
    """
    try:
        arrays = load(data)
    except (SafetensorError, ValueError, KeyError, TypeError) as error:
        raise DataError(f"{source} is damaged, not a readable safetensors file: {error}") from error
    length = int.from_bytes(data[:8], "little")
    text = parse_json(data[8 : 8 + length], _Metadata, source).metadata.get("header", "{}")
    return arrays, parse_json(text.encode(), header, f"the header of {source}")


class _Metadata(msgspec.Struct):
    """Part of a safetensors header."""

    metadata: dict[str, str] = msgspec.field(name="__metadata__", default_factory=dict)
