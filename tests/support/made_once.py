"""Outputs of long commands that several tests read, made once and not once per test process."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from filelock import FileLock


def made_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], object]) -> Path:
    """Return a folder filled by ``make(folder)`` in the first process that asks for it; the others wait for it."""
    base = factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / name
    with FileLock(f"{folder}.lock"):
        if not folder.exists():
            parts = folder.with_name(f"{name}-unfinished")
            parts.mkdir()
            make(parts)
            parts.rename(folder)
    return folder
