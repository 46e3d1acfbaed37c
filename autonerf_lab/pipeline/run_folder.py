"""A run folder: what one run made, and how far it came.

``run.json`` is written before anything else and says what the run is (``config``) and which stages are finished. It is
replaced atomically after each stage, so a run that was killed at any moment goes on from its last finished stage.
"""

import contextlib
import errno
import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from autonerf_lab import __version__
from autonerf_lab.errors import DataError, RunFolderError
from autonerf_lab.utils import storage

FORMAT_VERSION = 1
LOCK = ".lock"
HELD = (errno.EWOULDBLOCK, errno.EAGAIN, errno.EACCES)  # what systems say of a lock that somebody has
REMOVED = (errno.ENOENT, errno.ESTALE)  # and of a folder that its holder removed since we made it; NFS says the second
STAGES = ("scene", "explore", "fit", "evaluate", "mesh", "report")

# What is made from what: doing a stage again makes these worthless.
MADE_FROM: dict[str, tuple[str, ...]] = {
    "scene": STAGES,
    "explore": STAGES[1:],
    "fit": STAGES[2:],
    "evaluate": ("evaluate", "report"),
    "mesh": ("mesh", "report"),
    "report": ("report",),
}

# Everything a run writes, by stage. Nothing else in the folder is ever touched.
OUTPUTS: dict[str, tuple[str, ...]] = {
    "scene": ("scene.json",),
    "explore": (
        "trajectory/transforms.json",
        *(f"trajectory/{k}/frame_*.png" for k in ("images", "depth", "semantics")),
    ),
    "fit": ("nerf/*.json", "nerf/*.safetensors"),
    "evaluate": ("scores.json", "baselines/*.json"),
    "mesh": ("mesh/*.glb", "mesh/*.ply", "mesh/*.json"),
    "report": ("report.html",),
}
_FIGURES = ("figures/{stage}.json", "figures/{stage}_*")


@dataclass(frozen=True)
class RunConfig:
    """What a run is. Two runs with the same one make the same files, times aside."""

    scene: str  # a name of the library, or a path
    scene_sha256: str  # of the geometry: the same name may come to mean another apartment
    policy: str
    preset: str
    seed: int = 0
    model: str | None = None  # not chosen before the fit

    def differences(self, other: "RunConfig") -> list[str]:
        """What is not the same, for people. A model that one side has not chosen yet is no difference.

        Example:
            >>> a = RunConfig("val-0", "f00", "frontier", "fast")
            >>> a.differences(replace(a, seed=1, model="semantic-nerfacto"))
            ['seed is 0, not 1']
        """
        mine, theirs = asdict(self), asdict(other)
        changed = [
            key
            for key in mine
            if mine[key] != theirs[key] and not (key == "model" and None in (mine[key], theirs[key]))
        ]
        if changed == ["scene_sha256"]:
            return [f"scene {self.scene!r} is not the apartment it was when the run began"]
        return [f"{key} is {mine[key]!r}, not {theirs[key]!r}" for key in changed if key != "scene_sha256"]


class RunFolder:
    """The folder of one run. Make one with :func:`open_run` or :func:`load_run`."""

    def __init__(self, path: Path, config: RunConfig, stages: dict[str, dict[str, Any]]) -> None:
        self.path = path
        self.config = config
        self.stages = stages  # name -> {seconds, peak_gb, finished}, in the order they finished

    def __truediv__(self, name: str) -> Path:
        return self.path / name

    def finished(self, stage: str) -> bool:
        """Whether the stage has written all it writes."""
        return stage in self.stages

    def require(self, stage: str) -> None:
        """Raise unless the stage is finished.

        Raises:
            RunFolderError: names the command that comes first.
        """
        if not self.finished(stage):
            raise RunFolderError(f"{self.path} has not come that far: `autonerf-lab {stage}` comes first")

    def mark(self, stage: str, seconds: float, peak_gb: float | None) -> None:
        """Write down that a stage is finished."""
        now = datetime.now(UTC).isoformat(timespec="seconds")
        peak = None if peak_gb is None else round(peak_gb, 3)
        self.stages[stage] = {"seconds": round(seconds, 3), "peak_gb": peak, "finished": now}
        self.save()

    def choose_model(self, model: str) -> None:
        """Write down which model the run fits."""
        self.config = replace(self.config, model=model)
        self.save()

    def begin_again(self, stage: str, overwrite: bool) -> None:
        """Make room for a stage that is to run, maybe for the second time.

        Args:
            stage: its name.
            overwrite: remove what a finished stage wrote and what was made from that. ``run.json`` says so first.

        Raises:
            RunFolderError: the stage is finished and ``overwrite`` is not set.
        """
        if not self.finished(stage):
            return
        if not overwrite:
            raise RunFolderError(
                f"{self.path}: `{stage}` is finished; --overwrite does it again and removes what was made from it"
            )
        worthless = MADE_FROM[stage]
        self.stages = {name: row for name, row in self.stages.items() if name not in worthless}
        self.save()
        _remove_outputs(self.path, worthless)

    def save(self) -> None:
        """Write ``run.json``."""
        storage.write_json(
            self.path / "run.json",
            {"version": FORMAT_VERSION, "package": __version__, "config": asdict(self.config), "stages": self.stages},
        )


def load_run(path: str | Path) -> RunFolder:
    """The run that ``path`` holds.

    Raises:
        RunFolderError: there is none, or it was made by another version of the package.
        DataError: ``run.json`` is damaged.

    Example:
        >>> load_run("/nowhere")
        Traceback (most recent call last):
        autonerf_lab.errors.RunFolderError: /nowhere holds no run (no run.json); `autonerf-lab explore --out /nowhere` \
begins one
    """
    path = Path(path)
    if not (path / "run.json").exists():
        raise RunFolderError(f"{path} holds no run (no run.json); `autonerf-lab explore --out {path}` begins one")
    content = storage.read_json(path / "run.json")
    try:
        config = RunConfig(**content["config"])
        stages = {name: dict(content["stages"][name]) for name in STAGES if name in content["stages"]}
        version, package = content["version"], content["package"]
    except (KeyError, TypeError, ValueError) as error:
        raise DataError(f"{path / 'run.json'} is damaged ({error!r}); {_way_out()}") from error
    if (version, package) != (FORMAT_VERSION, __version__):
        raise RunFolderError(f"{path} was made by autonerf-lab {package}, this is {__version__}; {_way_out()}")
    return RunFolder(path, config, stages)


def open_run(path: str | Path, config: RunConfig, last: str = "report", overwrite: bool = False) -> RunFolder:
    """Begin a run in a new or empty folder, or go on with an unfinished run of the same configuration.

    Args:
        path: the folder; made when it does not exist.
        config: what the run is to be.
        last: the stage up to which the caller wants to go: a run that has come so far counts as finished.
        overwrite: replace a finished or different run: what it wrote is removed, and nothing else. An unfinished run
            of the same configuration is continued all the same.

    Raises:
        RunFolderError: the folder holds something else, a finished run, or files of nobody knows whom. Nothing is
            changed then.
    """
    path = Path(path)
    refusal: DataError | RunFolderError | None = None
    if (path / "run.json").exists():
        try:
            run = load_run(path)
            differences = run.config.differences(config)
            if differences:
                refusal = RunFolderError(f"{path} holds another run ({'; '.join(differences)}); {_way_out()}")
            elif all(run.finished(stage) for stage in STAGES[: STAGES.index(last) + 1]):
                made = path / {"explore": "trajectory", "evaluate": "scores.json", "report": "report.html"}[last]
                refusal = RunFolderError(f"{path} holds a finished run ({made}); {_way_out()}")
            else:
                return run
        except (DataError, RunFolderError) as error:
            refusal = error
        if not overwrite:
            raise refusal
        _remove_outputs(path, STAGES)
    elif not nothing_but(path, "run.json"):
        raise RunFolderError(f"{path} holds files but no run.json: not a run folder; choose another --out")
    run = RunFolder(path, config, {})
    run.save()
    return run


@contextlib.contextmanager
def locked(path: Path, wait: bool = False) -> Iterator[None]:
    """Keep a second process out of the folder. The lock goes with the process, however it ends.

    What is locked is a file in it, ``.lock``, because network file systems lock nothing but files that are open for
    writing. It is removed at the end; one that a killed process left is nobody's, and in nobody's way.

    Args:
        path: of the folder, which is made.
        wait: until the other process is gone; it may remove the folder as it leaves.

    Raises:
        RunFolderError: another process holds it, and we do not wait.
        DataError: the folder cannot be made, or there are no locks on its file system.
    """
    handle = _taken(path, wait)
    try:
        yield
    finally:
        if handle is not None:
            if _is_open(path / LOCK, handle):  # not where the folder was removed, and has a new lock of somebody else
                with contextlib.suppress(OSError):
                    (path / LOCK).unlink()
            os.close(handle)


def nothing_but(path: Path, name: str) -> bool:
    """Whether a folder holds at most its lock and a file that was cut off while it was written.

    Args:
        path: of a folder, or of nothing.
        name: of the file.
    """
    return not path.exists() or all(e.name == LOCK or e.name.startswith(f".{name}.") for e in path.iterdir())


def _taken(path: Path, wait: bool) -> int | None:
    """The handle that holds the lock; None where there are no such locks."""
    try:
        import fcntl
    except ImportError:  # Windows has other locks; there two processes are the user's care
        fcntl = None  # type: ignore[assignment]
    while True:
        try:
            path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise DataError(f"cannot make the folder {path}: {error.strerror}; choose another --out") from error
        if fcntl is None:
            return None
        handle = None
        try:
            handle = os.open(path / LOCK, os.O_RDWR | os.O_CREAT, 0o644)
            fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except OSError as error:
            if handle is not None:
                os.close(handle)
            if error.errno in REMOVED:
                continue
            if handle is not None and error.errno in HELD:
                raise RunFolderError(
                    f"another process is at work in {path}; wait for it, or choose another --out"
                ) from error
            raise DataError(f"cannot lock {path / LOCK}: {error.strerror}; choose another --out") from error
        if _is_open(path / LOCK, handle):
            return handle
        os.close(handle)  # the file that it is of was removed meanwhile


def _is_open(path: Path, handle: int) -> bool:
    """Whether a path is still the file of a handle."""
    try:
        return os.path.samestat(os.fstat(handle), path.stat())
    except OSError:
        return False


def _way_out() -> str:
    return "choose another --out, or replace it with --overwrite"


def _remove_outputs(path: Path, stages: tuple[str, ...]) -> None:
    try:
        for stage in stages:
            for pattern in (*OUTPUTS[stage], *(p.format(stage=stage) for p in _FIGURES)):
                folder, name = (path / pattern).parent, Path(pattern).name
                # the second pattern: temporary files of a write that was cut off
                for file in (*folder.glob(name), *folder.glob(f".{name}.*")):
                    file.unlink()
        for folder in sorted((p for p in path.rglob("*") if p.is_dir()), reverse=True):
            if folder.relative_to(path).parts[0] in ("trajectory", "nerf", "mesh", "figures", "baselines"):
                with contextlib.suppress(OSError):  # somebody else's files are in it
                    folder.rmdir()
    except OSError as error:
        raise DataError(f"cannot remove {error.filename}: {error.strerror}") from error
