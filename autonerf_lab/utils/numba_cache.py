"""Folder of numba's compiled kernels where neither the package nor the user's cache can be written."""

import os
import stat
import sys
import tempfile
from pathlib import Path

_PACKAGE = Path(__file__).parents[1]


def set_numba_cache() -> None:
    """Keep compiled kernels in a temporary folder if numba finds no other place, which is an error in numba.

    ``NUMBA_CACHE_DIR`` is respected. The folder lasts until the system clears it.
    """
    cache = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser()
    if "NUMBA_CACHE_DIR" in os.environ or _writable(_PACKAGE) or _writable(cache):
        return
    os.environ["NUMBA_CACHE_DIR"] = folder = str(private_folder(Path(tempfile.gettempdir())))
    if "numba" in sys.modules:
        sys.modules["numba"].config.CACHE_DIR = folder


def private_folder(parent: Path) -> Path:
    """Return a folder in ``parent`` that only this user can write, the same one in later processes if possible.

    Compiled kernels are code: those of another user must not be loaded.

    Example:
        >>> parent = Path(tempfile.mkdtemp())
        >>> private_folder(parent) == private_folder(parent)
        True
    """
    uid = os.getuid() if hasattr(os, "getuid") else os.environ.get("USERNAME", "user")
    folder = parent / f"autonerf_lab-{uid}"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.lstat()
    except OSError:
        return Path(tempfile.mkdtemp(dir=parent))
    mine = not hasattr(os, "getuid") or (status.st_uid == uid and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH))
    return folder if mine and stat.S_ISDIR(status.st_mode) else Path(tempfile.mkdtemp(dir=parent))


def _writable(folder: Path) -> bool:
    """Return True if a folder, or the nearest of its parents that exists, can be written."""
    existing = next((path for path in (folder, *folder.parents) if path.exists()), folder)
    try:
        with tempfile.TemporaryFile(dir=existing):  # permissions alone do not show a read-only file system
            return True
    except OSError:
        return False
