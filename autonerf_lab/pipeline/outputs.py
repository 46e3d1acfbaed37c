"""List of the files that a run wrote, with their digests: nothing else is ever removed.

``outputs.json`` maps each finished stage to its files. A file that was changed afterwards is not removed either, and
paths through symbolic links are neither recorded nor removed nor read.
"""

import contextlib
import hashlib
from collections.abc import Iterable
from pathlib import Path

from autonerf_lab.errors import DataError, RunFolderError
from autonerf_lab.utils import storage

FILE = "outputs.json"
CHECKPOINT = "nerf/training.safetensors"
Files = dict[str, str]  # path relative to the folder -> SHA-256


def is_own(root: Path, path: Path) -> bool:
    """Return True if a path is a regular file below ``root`` and no part of it is a symbolic link."""
    if not path.is_relative_to(root):  # an absolute path in a list that somebody edited
        return False
    parts = path.relative_to(root).parts
    try:
        links = any((root / Path(*parts[:k])).is_symlink() for k in range(1, len(parts) + 1))
        return ".." not in parts and not links and path.is_file()
    except OSError:  # no file can have this name, for example because it is too long
        return False


def record(root: Path, stage: str, patterns: Iterable[str]) -> None:
    """Store the files of a stage, which match the patterns, with their digests."""
    files = {path for pattern in patterns for path in root.glob(pattern) if is_own(root, path)}
    known = _read(root)
    known[stage] = {path.relative_to(root).as_posix(): _sha256(path) for path in sorted(files)}
    storage.write_json(root / FILE, known)


def check_unchanged(root: Path, stages: Iterable[str]) -> None:
    """Check that the files of stages are as the run wrote them.

    Raises:
        RunFolderError: a file was changed since; it must not be removed or overwritten.
        DataError: the list of the files is damaged.
    """
    changed = [
        str(path.relative_to(root)) for path, sha256 in _own_files(root, stages).items() if _sha256(path) != sha256
    ]
    if changed:
        raise RunFolderError(
            f"{root}: changed after the run wrote it: {', '.join(changed[:3])}; move it away, or use another folder"
        )


def remove(root: Path, stages: Iterable[str]) -> None:
    """Remove the recorded files of stages, and the folders that are empty then; call :func:`check_unchanged` first.

    Raises:
        DataError: the list is damaged, or a file cannot be removed.
    """
    own = _own_files(root, stages)
    known = {stage: files for stage, files in _read(root).items() if stage not in stages}
    try:
        for path in own:
            path.unlink()
        if "fit" in stages and is_own(root, root / CHECKPOINT):  # of a training that did not end
            (root / CHECKPOINT).unlink()
        folders = {folder for path in own for folder in (path.parent, path.parent.parent)}
        for folder in sorted((folder for folder in folders if folder.is_relative_to(root)), reverse=True):
            for file in storage.interrupted_writes(folder):
                file.unlink()
            if folder != root:
                with contextlib.suppress(OSError):  # it holds files of the user
                    folder.rmdir()
        storage.write_json(root / FILE, known)
    except OSError as error:
        raise DataError(f"cannot remove {error.filename}: {error.strerror}") from error


def _own_files(root: Path, stages: Iterable[str]) -> dict[Path, str]:
    known = _read(root)
    files = {root / name: sha256 for stage in stages for name, sha256 in known.get(stage, {}).items()}
    return {path: sha256 for path, sha256 in files.items() if is_own(root, path)}


def _read(root: Path) -> dict[str, Files]:
    return storage.read_json(root / FILE, dict[str, Files]) if (root / FILE).exists() else {}


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
