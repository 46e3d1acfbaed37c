"""Results folder: the grid and one JSON file per cell. All files are written atomically.

::

    grid.json           fingerprint of the grid
    cells/CELL.json     status, times and scores of a cell
    figures/CELL_*.webp figures for the report
    scenes/             visible area of each scene, computed once
    work/CELL/          run folder of an unfinished cell
    work/CELL.log       log of an unfinished cell
    runs/CELL/          run folder of a cell, only with --save-runs
"""

import shutil
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NotRequired, TypedDict

import msgspec

from autonerf_lab.benchmark.fingerprint import LPIPS, differences, grid_fingerprint
from autonerf_lab.benchmark.grid import CONDITIONS, Cell, Grid, label
from autonerf_lab.errors import DataError, RunFolderError
from autonerf_lab.pipeline.run_folder import is_empty_except
from autonerf_lab.types import Score
from autonerf_lab.utils import storage
from autonerf_lab.version import __version__

FORMAT_VERSION = 1
OK = "ok"
RETRY = ("failed", "timeout", "oom", "died")  # first word of the status of a cell without scores
MAX_CELLS = 100_000
MAX_NAME = 200  # characters of the name of a cell; file systems allow 255 with the suffix
MAX_LENGTH = 300  # characters of a status


class StageCost(TypedDict):
    """Cost of a stage of a cell."""

    seconds: float
    peak_gb: float | None
    finished: NotRequired[str]  # time, ISO 8601


@dataclass(frozen=True)
class Outcome:
    """Outcome of a cell: its status and, if it finished, its scores, costs and coverage curves."""

    cell: Cell
    status: str  # "ok", or a word of RETRY and the reason, such as "failed: ..."
    scores: tuple[Score, ...] = ()
    stages: dict[str, StageCost] | None = None  # of a finished cell
    curves: dict[str, list[float]] | None = None  # metric -> coverage after 2, 4, ... 100 % of the steps, %
    baselines: dict[str, tuple[Score, ...]] = field(default_factory=dict)  # by name, see :data:`.BASELINES`
    details: dict[str, dict[str, Any]] = field(default_factory=dict)  # by task, see :class:`.Scores`

    def __post_init__(self) -> None:
        """Reduce the status to one line of printable characters of limited length."""
        text = " ".join("".join(c if c.isprintable() else " " for c in self.status).split())
        object.__setattr__(self, "status", text if len(text) <= MAX_LENGTH else f"{text[: MAX_LENGTH - 3]}...")

    @property
    def finished(self) -> bool:
        """True if the cell has scores."""
        return self.status == OK

    def should_retry(self, retry: Iterable[str]) -> bool:
        """Return True if the cell must run again; ``failed`` in ``retry`` selects all cells that are not ok.

        Example:
            >>> ended = Outcome(Cell("random", "val-0", 0, "instant-ngp", "smoke"), "timeout: 9 s")
            >>> ended.should_retry(["failed"]), ended.should_retry(["timeout"]), ended.should_retry(["oom"])
            (True, True, False)
        """
        return not self.finished and bool({"failed", self.status.split(":")[0]} & set(retry))

    @property
    def seconds(self) -> float:
        """Total time of all stages, seconds."""
        return sum(row["seconds"] for row in (self.stages or {}).values())


@dataclass(frozen=True)
class _GridFile:
    """Content of ``grid.json``."""

    version: int
    package: str  # version of the package
    grid: dict[str, Any]  # fingerprint: the fields of a Grid and digests


class Results:
    """Results folder. Create it with :func:`open_results` or :func:`load_results`."""

    def __init__(self, path: Path, grid: Grid, fingerprint: Mapping[str, Any] | None = None) -> None:
        self.path = path
        self.grid = grid
        self.fingerprint: Mapping[str, Any] = fingerprint or {}  # see :func:`.grid_fingerprint`

    @property
    def lpips(self) -> str | None:
        """SHA-256 of the LPIPS weights; None if LPIPS is not computed."""
        return (self.fingerprint.get("weights") or {}).get(LPIPS)

    def cell_file(self, cell: Cell) -> Path:
        """Return the path of the outcome of a cell."""
        return self.path / "cells" / f"{cell.name}.json"

    def work_folder(self, cell: Cell) -> Path:
        """Return the folder of an unfinished cell."""
        return self.path / "work" / cell.name

    def saved_run(self, cell: Cell) -> Path:
        """Return the path of the saved run folder of a cell."""
        return self.path / "runs" / cell.name

    def log_file(self, cell: Cell) -> Path:
        """Return the path of the log of a cell."""
        return self.path / "work" / f"{cell.name}.log"

    def write(self, outcome: Outcome) -> None:
        """Write the outcome of a cell.

        Raises:
            DataError: The disk is full, or the folder is not writable.
        """
        content = {
            "version": FORMAT_VERSION,
            "cell": asdict(outcome.cell),
            "status": outcome.status,
            "stages": outcome.stages,
            "curves": outcome.curves,
            "scores": [asdict(row) for row in outcome.scores],
            "baselines": {name: [asdict(row) for row in rows] for name, rows in outcome.baselines.items()},
            "details": outcome.details,
        }
        storage.write_json(self.cell_file(outcome.cell), content)

    def read(self, cell: Cell) -> Outcome | None:
        """Return the outcome of a cell; None if it has none yet.

        Raises:
            DataError: The file is damaged.
        """
        path = self.cell_file(cell)
        if not path.exists():
            return None
        try:
            outcome = storage.read_json(path, Outcome)
        except DataError as error:
            raise DataError(f"{error}; remove it to run the cell again") from error
        if outcome.cell != cell:
            raise DataError(f"{path} holds another cell; remove it to run the cell again")
        return outcome

    def outcomes(self) -> list[Outcome]:
        """Return the outcomes of all cells that have one, in the order of the grid."""
        return [outcome for cell in self.grid.cells() if (outcome := self.read(cell)) is not None]

    def discard(self, outcomes: Iterable[Outcome]) -> None:
        """Remove outcomes, so that their cells run again.

        A failed cell starts from scratch, because its files may be the reason. Other cells continue.
        """
        for outcome in outcomes:
            if outcome.status.startswith("failed"):
                shutil.rmtree(self.work_folder(outcome.cell), ignore_errors=True)
                shutil.rmtree(self.saved_run(outcome.cell), ignore_errors=True)
            self.cell_file(outcome.cell).unlink(missing_ok=True)

    def clean_up(self) -> None:
        """Remove work folders of finished cells and temporary files of interrupted writes."""
        for name in ("", "cells", "figures", "scenes"):
            for file in storage.interrupted_writes(self.path / name):
                file.unlink(missing_ok=True)
        for outcome in self.outcomes():
            if outcome.finished:
                self.log_file(outcome.cell).unlink(missing_ok=True)
                shutil.rmtree(self.work_folder(outcome.cell), ignore_errors=True)


def open_results(path: str | Path, grid: Grid, lpips: str | None = None) -> Results:
    """Start a results folder in a new or empty folder, or continue one of the same grid.

    Args:
        path: Results folder.
        grid: Validated grid, see :meth:`Grid.checked`.
        lpips: SHA-256 of the LPIPS weights; None: LPIPS is not computed.

    Raises:
        RunFolderError: The folder holds another grid, results of another version, or other files.
        DataError: ``grid.json`` is damaged or cannot be written.
    """
    path, fingerprint = Path(path), grid_fingerprint(grid, lpips)
    if (path / "grid.json").exists():
        found = differences(_read_fingerprint(path, to_run=True), fingerprint)
        if found:
            raise RunFolderError(f"{path} holds the results of another grid ({'; '.join(found)}); choose another --out")
    elif not is_empty_except(path, "grid.json"):
        raise RunFolderError(f"{path} holds files but no grid.json: not a results folder; choose another --out")
    else:
        storage.write_json(path / "grid.json", {"version": FORMAT_VERSION, "package": __version__, "grid": fingerprint})
    return Results(path, grid, fingerprint)


def load_results(path: str | Path, to_run: bool = False) -> Results:
    """Load the results in the folder ``path``.

    Args:
        path: Results folder.
        to_run: Results will be added, which requires the same version of the package.

    Raises:
        RunFolderError: The folder holds no results, another format, or (with ``to_run``) results of another version.
        DataError: ``grid.json`` is damaged.

    Example:
        >>> load_results("/nowhere")
        Traceback (most recent call last):
        autonerf_lab.errors.RunFolderError: /nowhere holds no results (no grid.json); \
create them with `autonerf-lab bench run`
    """
    path = Path(path)
    if not (path / "grid.json").exists():
        raise RunFolderError(f"{path} holds no results (no grid.json); create them with `autonerf-lab bench run`")
    fingerprint = _read_fingerprint(path, to_run)
    return Results(path, msgspec.convert(fingerprint, Grid), fingerprint)


def _read_fingerprint(path: Path, to_run: bool) -> dict[str, Any]:
    try:
        content = storage.read_json(path / "grid.json", _GridFile)
        grid = msgspec.convert(content.grid, Grid)
        if not 0 < len(grid.policies) * len(grid.scenes) * len(grid.models) * grid.starts <= MAX_CELLS:
            raise DataError(f"{path / 'grid.json'} does not have 1 to {MAX_CELLS} cells")
        longest = sum(max(len(label(name)) for name in names) for names in (grid.policies, grid.scenes, grid.models))
        longest += sum(len(label(str(getattr(grid, key) or ""))) for key in CONDITIONS)
        if longest > MAX_NAME:
            raise DataError(f"{path / 'grid.json'} has names of {longest} characters per cell; at most {MAX_NAME}")
    except (DataError, msgspec.ValidationError) as error:
        raise DataError(f"{error}; start another results folder") from error
    version, package = content.version, content.package[:40]
    if version != FORMAT_VERSION:
        raise RunFolderError(
            f"{path} has format {version}, made by autonerf-lab {package}; this is {__version__}, which reads format "
            f"{FORMAT_VERSION}"
        )
    if to_run and package != __version__:
        raise RunFolderError(
            f"{path} was made by autonerf-lab {package}, this is {__version__}: scores may differ, so it can be read "
            "but not continued; choose another --out"
        )
    return content.grid
