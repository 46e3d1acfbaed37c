"""Run folder: the files of one run and its progress.

``run.json`` is the first file of a run. It holds the configuration of the run (``config``) and its finished stages. It
is replaced atomically after each stage, so an interrupted run continues after its last finished stage.
"""

import contextlib
import errno
import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from autonerf_lab.errors import DataError, RunFolderError
from autonerf_lab.pipeline import outputs
from autonerf_lab.utils import storage
from autonerf_lab.version import __version__

FORMAT_VERSION = 1
LOCK = ".lock"
STAGES = ("scene", "explore", "fit", "evaluate", "mesh", "report")

# Running a stage again invalidates the outputs of these stages.
INVALIDATES: dict[str, tuple[str, ...]] = {
    "scene": STAGES,
    "explore": STAGES[1:],
    "fit": STAGES[2:],
    "evaluate": ("evaluate", "report"),
    "mesh": ("mesh", "report"),
    "report": ("report",),
}

# All output files by stage. They are recorded when the stage is finished, see outputs.py.
OUTPUTS: dict[str, tuple[str, ...]] = {
    "scene": ("scene.json",),
    "explore": (
        "trajectory/transforms.json",
        *(f"trajectory/{k}/frame_*.png" for k in ("images", "depth", "semantics", "confidence")),
    ),
    "fit": ("nerf/*.json", "nerf/*.safetensors"),
    "evaluate": ("scores.json", "baselines/*.json"),
    "mesh": ("mesh/*.glb", "mesh/*.ply", "mesh/*.obj", "mesh/*.json"),
    "report": ("report.html",),
}
_FIGURES = ("figures/{stage}.json", "figures/{stage}_*")
_REMOVED = (errno.ENOENT, errno.ESTALE)  # errors of a folder that another process has just removed; NFS reports ESTALE
_RESULTS = {"explore": "trajectory", "evaluate": "scores.json", "report": "report.html"}  # of the main stages
_WAY_OUT = "choose another --out, or replace the run with --overwrite"
_START_AGAIN = "use another run folder, or replace this one with `autonerf-lab explore --overwrite`"


@dataclass(frozen=True)
class RunConfig:
    """Configuration of a run. Equal configurations give equal files, except for times."""

    scene: str  # name in the scene library, or path
    scene_sha256: str  # of the geometry; a name or path may refer to another scene later
    policy: str
    preset: str
    seed: int = 0
    model: str | None = None  # None until the stage `fit`
    # The following values override the preset if they are set.
    steps: int | None = None  # of the episode
    map_size: int | None = None  # cells per side of the map of the policy
    width: int | None = None  # of the images, pixels
    height: int | None = None  # of the images, pixels
    hfov_deg: float | None = None  # horizontal field of view of the camera, degrees
    noise: str | None = None  # model of the noise of motion and odometry; None: exact
    noise_scale: float | None = None  # factor of this noise
    depth_noise: str | None = None  # model of the noise of depth images; None: exact
    poses: str | None = None  # pose source of the exploration; None: odometry
    fit_poses: str | None = None  # pose source of the training; None: that of the exploration
    semantics: str | None = None  # source of the classes that the robot sees; None: the simulator

    def differences(self, other: "RunConfig") -> list[str]:
        """Return a description of each difference. Settings of the stage ``fit`` that only one side has do not count.

        Example:
            >>> a = RunConfig("val-0", "f00", "frontier", "fast")
            >>> a.differences(replace(a, seed=1, steps=100, model="semantic-nerfacto"))
            ['seed is 0, not 1', 'steps is unset, not 100']
        """
        own, others = asdict(self), asdict(other)
        changed = [
            key
            for key in own
            if own[key] != others[key] and not (key in ("model", "fit_poses") and None in (own[key], others[key]))
        ]
        if changed == ["scene_sha256"]:
            return [f"scene {self.scene!r} has changed since the run began"]
        return [f"{key} is {_text(own[key])}, not {_text(others[key])}" for key in changed if key != "scene_sha256"]


@dataclass(frozen=True)
class _FinishedStage:
    """Entry of a finished stage in ``run.json``."""

    seconds: float
    peak_gb: float | None
    finished: str  # time, ISO 8601


@dataclass(frozen=True)
class _RunFile:
    """Content of ``run.json``."""

    version: int
    package: str  # version of the package
    config: RunConfig
    stages: dict[str, _FinishedStage]


class RunFolder:
    """Folder of one run. Create it with :func:`open_run` or :func:`load_run`."""

    def __init__(self, path: Path, config: RunConfig, stages: dict[str, dict[str, Any]]) -> None:
        self.path = path
        self.config = config
        self.stages = stages  # name -> {seconds, peak_gb, finished}, in the order of completion

    def __truediv__(self, name: str) -> Path:
        """Return the path of a file or folder in the run folder."""
        return self.path / name

    def finished(self, stage: str) -> bool:
        """Return True if the stage has written all its outputs."""
        return stage in self.stages

    def require(self, stage: str) -> None:
        """Check that a stage is finished.

        Raises:
            RunFolderError: The stage is not finished. The message contains the command that runs it.
        """
        if not self.finished(stage):
            raise RunFolderError(f"{self.path}: stage {stage!r} is not finished; run `autonerf-lab {stage}` first")

    def mark_finished(self, stage: str, seconds: float, peak_gb: float | None) -> None:
        """Record a finished stage with its time and its peak memory in ``run.json``."""
        now = datetime.now(UTC).isoformat(timespec="seconds")
        peak = None if peak_gb is None else round(peak_gb, 3)
        self.stages[stage] = {"seconds": round(seconds, 3), "peak_gb": peak, "finished": now}
        outputs.record(self.path, stage, (*OUTPUTS[stage], *(pattern.format(stage=stage) for pattern in _FIGURES)))
        self.save()

    def set_fit(self, model: str | None = None, poses: str | None = None) -> None:
        """Record the model and the pose source of the training in ``run.json``; None leaves them unchanged."""
        chosen: dict[str, Any] = {"model": model, "fit_poses": poses}
        self.config = replace(self.config, **{key: value for key, value in chosen.items() if value is not None})
        self.save()

    def clear_stage(self, stage: str, overwrite: bool) -> None:
        """Remove the outputs of a finished stage and of all stages that depend on it.

        Args:
            stage: Name of the stage that will run.
            overwrite: Allow the removal. ``run.json`` is updated before any file is removed.

        Raises:
            RunFolderError: The stage is finished and ``overwrite`` is False, or one of its files was changed since.
        """
        if not self.finished(stage):
            return
        if not overwrite:
            raise RunFolderError(
                f"{self.path}: `{stage}` is finished; --overwrite runs it again and removes all results that depend "
                "on it"
            )
        invalid = INVALIDATES[stage]
        outputs.check_unchanged(self.path, invalid)
        self.stages = {name: row for name, row in self.stages.items() if name not in invalid}
        self.save()
        outputs.remove(self.path, invalid)

    def save(self) -> None:
        """Write ``run.json``."""
        storage.write_json(
            self.path / "run.json",
            {"version": FORMAT_VERSION, "package": __version__, "config": asdict(self.config), "stages": self.stages},
        )


def load_run(path: str | Path) -> RunFolder:
    """Load the run in the folder ``path``.

    Raises:
        RunFolderError: The folder holds no run, or a run of another version of the package.
        DataError: ``run.json`` is damaged.

    Example:
        >>> load_run("/nowhere")
        Traceback (most recent call last):
        autonerf_lab.errors.RunFolderError: /nowhere holds no run (no run.json); start one with \
`autonerf-lab explore --out /nowhere`
    """
    path = Path(path)
    if not (path / "run.json").exists():
        raise RunFolderError(f"{path} holds no run (no run.json); start one with `autonerf-lab explore --out {path}`")
    try:
        content = storage.read_json(path / "run.json", _RunFile)
    except DataError as error:
        raise DataError(f"{error}; {_START_AGAIN}") from error
    if (content.version, content.package) != (FORMAT_VERSION, __version__):
        raise RunFolderError(
            f"{path} was made by autonerf-lab {content.package[:40]}, this is {__version__}; {_START_AGAIN}"
        )
    stages = {name: asdict(content.stages[name]) for name in STAGES if name in content.stages}
    return RunFolder(path, content.config, stages)


def open_run(path: str | Path, config: RunConfig, last: str = "report", overwrite: bool = False) -> RunFolder:
    """Start a run in a new or empty folder, or continue an unfinished run of the same configuration.

    Args:
        path: Run folder; created if it does not exist.
        config: Configuration of the run.
        last: Last stage that the caller will run. A run that has reached it counts as finished.
        overwrite: Replace a finished or different run. Only outputs of the run are removed. An unfinished run of the
            same configuration is continued.

    Raises:
        RunFolderError: The folder holds a finished run, a different run or other files. Nothing is changed.
    """
    path = Path(path)
    refusal: DataError | RunFolderError | None = None
    if (path / "run.json").exists():
        try:
            run = load_run(path)
            differences = run.config.differences(config)
            if differences:
                refusal = RunFolderError(f"{path} holds another run ({'; '.join(differences)}); {_WAY_OUT}")
            elif all(run.finished(stage) for stage in STAGES[: STAGES.index(last) + 1]):
                result = path / _RESULTS.get(last, "run.json")
                refusal = RunFolderError(f"{path} holds a finished run ({result}); {_WAY_OUT}")
            else:
                return run
        except (DataError, RunFolderError) as error:
            refusal = error
        if not overwrite:
            raise refusal
        outputs.check_unchanged(path, STAGES)
        outputs.remove(path, STAGES)
    elif not is_empty_except(path, "run.json"):
        raise RunFolderError(f"{path} holds files but no run.json: not a run folder; choose another --out")
    run = RunFolder(path, config, {})
    run.save()
    return run


@contextlib.contextmanager
def locked(path: Path, wait: bool = False) -> Iterator[None]:
    """Context manager that locks a folder against other processes. The system releases the lock when a process ends.

    The lock is a file lock on ``.lock`` in the folder. The file is removed at the end. A file that a killed process
    left behind is not locked.

    Args:
        path: Folder; created if it does not exist.
        wait: Wait for the other process, which may remove the folder before it releases the lock.

    Raises:
        RunFolderError: Another process holds the lock and ``wait`` is False.
        DataError: The folder cannot be created, or its file system has no file locks.
    """
    lock, handle = _acquire(path, wait)
    try:
        yield
    finally:
        # Remove the file while it is locked. If the folder was removed and created again, the file is another one.
        with contextlib.suppress(OSError):
            if os.path.samestat(os.fstat(handle), (path / LOCK).stat()):
                (path / LOCK).unlink()
        lock.release()


def is_empty_except(path: Path, name: str) -> bool:
    """Return True if a folder does not exist or holds only its lock and temporary files of the file ``name``."""
    return not path.exists() or all(e.name == LOCK or e.name.startswith(f".{name}.") for e in path.iterdir())


def _acquire(path: Path, wait: bool) -> tuple[FileLock, int]:
    """Return the acquired lock and the descriptor of its file."""
    while True:
        try:
            path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise DataError(f"cannot create the folder {path}: {error.strerror}; use another folder") from error
        handles: list[int] = []
        lock = FileLock(path / LOCK, blocking=wait, fallback_to_soft=False, on_acquired=handles.append)
        try:
            lock.acquire()
        except Timeout as error:
            raise RunFolderError(f"another process uses {path}; wait until it ends, or use another folder") from error
        except OSError as error:
            if error.errno in _REMOVED:
                continue
            raise DataError(f"cannot lock {path / LOCK}: {error.strerror}; use another folder") from error
        return lock, handles[0]


def _text(value: object) -> str:
    return "unset" if value is None else repr(value)
