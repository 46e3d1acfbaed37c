"""Files that survive a crash: written beside their place, flushed, then renamed over it. None of them runs code."""

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
_CUT_OFF = re.compile(r"\..+\.\w+\.[a-z0-9_]{8}")  # what mkstemp makes of the prefix that write_bytes gives it


def write_bytes(path: str | Path, data: bytes) -> None:
    """Write a file so that a reader, now or after a crash, sees the old content or the new one, never a part.

    Raises:
        DataError: the file could not be written (disk full, no permission); the old file is untouched.

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
        os.chmod(temporary, 0o644)  # mkstemp makes files that only their owner can read
        os.replace(temporary, path)
    except OSError as error:
        if temporary is not None:
            Path(temporary).unlink(missing_ok=True)
        raise DataError(
            f"cannot write {path}: {error.strerror or error}; free some space or choose another folder"
        ) from error


def cut_off(folder: str | Path) -> Iterator[Path]:
    """Files that a killed :func:`write_bytes` left in a folder, and nothing else; nobody will ever read them.

    Example:
        >>> folder = Path(tempfile.mkdtemp())
        >>> for name in ("a.json", ".a.json.abc_d123", ".lock", ".a.json.backup"):
        ...     (folder / name).touch()
        >>> [path.name for path in cut_off(folder)]
        ['.a.json.abc_d123']
    """
    for path in Path(folder).glob(".*"):
        if _CUT_OFF.fullmatch(path.name) and path.is_file() and not path.is_symlink():
            yield path


def out_of_space(error: BaseException | None) -> bool:
    """Whether a full disk, or a quota, is behind an error.

    Example:
        >>> out_of_space(OSError(errno.ENOSPC, "No space left on device")), out_of_space(ValueError())
        (True, False)
    """
    while error is not None:
        if isinstance(error, OSError) and error.errno in _NO_SPACE:
            return True
        error = error.__cause__ or error.__context__
    return False


def write_json(path: str | Path, content: object) -> None:
    """Write JSON that another program can read: finite numbers only.

    Raises:
        DataError: not writable, or a value that JSON has no word for.
    """
    try:
        text = json.dumps(content, indent=1, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise DataError(f"cannot write {path}: {error}") from error
    write_bytes(path, text.encode() + b"\n")


def read_json(path: str | Path) -> dict:
    """Read a JSON file whose top level is an object.

    Raises:
        DataError: names the file, and what is wrong with it.

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
    """Write arrays by name as safetensors; ``header`` is JSON that goes with them.

    Raises:
        DataError: not writable.

    Example:
        >>> import tempfile; path = Path(tempfile.mkdtemp()) / "a.safetensors"
        >>> write_arrays(path, {"turned": np.array([[1, 2, 3], [4, 5, 6]]).T})
        >>> read_arrays(path)[0]["turned"].tolist()
        [[1, 4], [2, 5], [3, 6]]
    """
    in_rows = {name: np.asarray(array, order="C") for name, array in arrays.items()}  # what `save` takes for granted
    write_bytes(path, save(in_rows, None if header is None else {"header": json.dumps(header)}))


def read_arrays(path: str | Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """The arrays and the header of :func:`write_arrays`; an empty one where there is none.

    Raises:
        DataError: the file is missing or damaged.

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
