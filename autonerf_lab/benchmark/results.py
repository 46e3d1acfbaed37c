"""A results folder: what grid it is of, a JSON for each cell, and nothing that a kill could leave half-written.

grid.json            what was asked for
cells/CELL.json      status, seconds, and a row for each score
pictures/CELL_*.webp what the report shows
scenes/              what there is to see in each scene, computed once
work/CELL/           a cell that is not finished: its run folder and its log
"""

import shutil
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from autonerf_lab import __version__
from autonerf_lab.benchmark.fingerprint import LPIPS, differences, identity
from autonerf_lab.benchmark.grid import Cell, Grid
from autonerf_lab.errors import DataError, RunFolderError
from autonerf_lab.pipeline.run_folder import nothing_but
from autonerf_lab.types import Score
from autonerf_lab.utils import storage

FORMAT_VERSION = 1
OK = "ok"
RETRY = ("failed", "timeout", "oom", "died")  # the first words of what is not ok
LONGEST = 300  # letters of a status


@dataclass(frozen=True)
class Outcome:
    """What became of a cell."""

    cell: Cell
    status: str  # "ok", or a word and the reason: "failed: ...", "timeout: ...", "oom: ...", "died: ..."
    scores: tuple[Score, ...] = ()
    stages: dict[str, dict[str, Any]] | None = None  # seconds and memory of each, of a cell that is finished
    curves: dict[str, list[float]] | None = None  # shares of what is visible, over the walk

    def __post_init__(self) -> None:
        """An error may say many lines, and tables show one: it is cut to a line, of letters that can be shown."""
        text = " ".join("".join(letter if letter.isprintable() else " " for letter in self.status).split())
        object.__setattr__(self, "status", text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}...")

    @property
    def finished(self) -> bool:
        """Whether it has scores."""
        return self.status == OK

    def runs_again(self, retry: Iterable[str]) -> bool:
        """Whether words of ``RETRY`` ask for it to be run again; ``failed`` does for whatever is not ok.

        Example:
            >>> ended = Outcome(Cell("random", "val-0", 0, "instant-ngp", "smoke"), "timeout: 9 s")
            >>> ended.runs_again(["failed"]), ended.runs_again(["timeout"]), ended.runs_again(["oom"])
            (True, True, False)
        """
        return not self.finished and bool({"failed", self.status.split(":")[0]} & set(retry))

    @property
    def seconds(self) -> float:
        """Of all its stages."""
        return sum(float(row["seconds"]) for row in (self.stages or {}).values())


class Results:
    """The folder. :func:`open_results` begins one, :func:`load_results` reads one."""

    def __init__(self, path: Path, grid: Grid, kept: Mapping[str, Any] | None = None) -> None:
        self.path = path
        self.grid = grid
        self.identity: Mapping[str, Any] = kept or {}  # see :mod:`.identity`

    @property
    def lpips(self) -> str | None:
        """SHA-256 of the weights of LPIPS; None where it is not measured."""
        return (self.identity.get("weights") or {}).get(LPIPS)

    def file(self, cell: Cell) -> Path:
        """Where the outcome of a cell goes."""
        return self.path / "cells" / f"{cell.name}.json"

    def work(self, cell: Cell) -> Path:
        """Where it is worked on."""
        return self.path / "work" / cell.name

    def kept(self, cell: Cell) -> Path:
        """Its run folder, where it is kept."""
        return self.path / "runs" / cell.name

    def log(self, cell: Cell) -> Path:
        """What it printed."""
        return self.path / "work" / f"{cell.name}.log"

    def write(self, outcome: Outcome) -> None:
        """Keep what became of a cell.

        Raises:
            DataError: no space is left, or no permission.
        """
        content = {
            "version": FORMAT_VERSION,
            "cell": asdict(outcome.cell),
            "status": outcome.status,
            "stages": outcome.stages,
            "curves": outcome.curves,
            "scores": [asdict(row) for row in outcome.scores],
        }
        storage.write_json(self.file(outcome.cell), content)

    def read(self, cell: Cell) -> Outcome | None:
        """What became of a cell; None when nothing did yet.

        Raises:
            DataError: the file is damaged; names it and the way out.
        """
        path = self.file(cell)
        if not path.exists():
            return None
        content = storage.read_json(path)
        try:
            rows = tuple(Score(**row) for row in content["scores"])
            cell_kept, status = Cell(**content["cell"]), str(content["status"])
            outcome = Outcome(cell_kept, status, rows, content["stages"], content["curves"])
        except (KeyError, TypeError) as error:
            raise DataError(f"{path} is damaged ({error!r}); remove it, and the cell is run again") from error
        if outcome.cell != cell:
            raise DataError(f"{path} is about another cell; remove it, and the cell is run again")
        return outcome

    def outcomes(self) -> list[Outcome]:
        """Of all cells that have one, in the order of the grid."""
        return [outcome for cell in self.grid.cells() if (outcome := self.read(cell)) is not None]

    def discard(self, outcomes: Iterable[Outcome]) -> None:
        """Forget what became of some cells, so that they run again.

        One that failed begins anew, because what it left may be the reason; one that was ended goes on.
        """
        for outcome in outcomes:
            if outcome.status.startswith("failed"):
                shutil.rmtree(self.work(outcome.cell), ignore_errors=True)
                shutil.rmtree(self.kept(outcome.cell), ignore_errors=True)
            self.file(outcome.cell).unlink(missing_ok=True)

    def tidy(self) -> None:
        """Remove what a killed run left behind and nobody needs: work on finished cells, files cut off in writing."""
        for name in ("", "cells", "pictures", "scenes"):
            for file in storage.cut_off(self.path / name):
                file.unlink(missing_ok=True)
        for outcome in self.outcomes():
            if outcome.finished:
                self.log(outcome.cell).unlink(missing_ok=True)
                shutil.rmtree(self.work(outcome.cell), ignore_errors=True)


def open_results(path: str | Path, grid: Grid, lpips: str | None = None) -> Results:
    """Begin a results folder in a new or empty place, or go on with one of the same grid.

    Args:
        path: of the folder.
        grid: checked.
        lpips: SHA-256 of the weights of LPIPS, where it is to be measured.

    Raises:
        RunFolderError: the folder holds another grid, another version's, or files of nobody knows whom.
        DataError: ``grid.json`` is damaged, or cannot be written.
    """
    path, asked = Path(path), identity(grid, lpips)
    if (path / "grid.json").exists():
        found = differences(_read_header(path, to_run=True), asked)
        if found:
            raise RunFolderError(f"{path} holds the results of another grid ({'; '.join(found)}); choose another --out")
    elif not nothing_but(path, "grid.json"):
        raise RunFolderError(f"{path} holds files but no grid.json: not a results folder; choose another --out")
    else:
        storage.write_json(path / "grid.json", {"version": FORMAT_VERSION, "package": __version__, "grid": asked})
    return Results(path, grid, asked)


def load_results(path: str | Path, to_run: bool = False) -> Results:
    """The results that ``path`` holds.

    Args:
        path: of the folder.
        to_run: somebody will add to them, which only the version of the package that began them may.

    Raises:
        RunFolderError: none, of another format, or another version's that we would add to.
        DataError: ``grid.json`` is damaged.

    Example:
        >>> load_results("/nowhere")
        Traceback (most recent call last):
        autonerf_lab.errors.RunFolderError: /nowhere holds no results (no grid.json); \
`autonerf-lab bench run` makes some
    """
    path = Path(path)
    if not (path / "grid.json").exists():
        raise RunFolderError(f"{path} holds no results (no grid.json); `autonerf-lab bench run` makes some")
    kept = _read_header(path, to_run)
    try:
        known: dict[str, Any] = {f.name: kept[f.name] for f in fields(Grid)}
        for name in ("policies", "scenes", "models", "optional"):
            known[name] = tuple(known[name])
        grid = Grid(**known)
        grid.cells()
    except (KeyError, TypeError) as error:
        raise DataError(f"{path / 'grid.json'} is damaged ({error!r}); begin another results folder") from error
    return Results(path, grid, kept)


def _read_header(path: Path, to_run: bool) -> dict[str, Any]:
    content = storage.read_json(path / "grid.json")
    version, package = content.get("version"), content.get("package")
    if version != FORMAT_VERSION:
        raise RunFolderError(
            f"{path} is of format {version}, made by autonerf-lab {package}; this is {__version__} and reads format "
            f"{FORMAT_VERSION}"
        )
    if to_run and package != __version__:
        raise RunFolderError(
            f"{path} was made by autonerf-lab {package}, this is {__version__}: scores may differ, so that it can be "
            "read but not gone on with; choose another --out"
        )
    if not isinstance(content.get("grid"), dict):
        raise DataError(f"{path / 'grid.json'} is damaged (no grid); begin another results folder")
    return content["grid"]
