"""What a grid will cost, from cells that were measured."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from autonerf_lab.benchmark.grid import Grid
from autonerf_lab.benchmark.results import Outcome, open_results

MODEL = "semantic-nerfacto"
# seconds and kept megabytes of a cell of it, without optional tasks, that has the two cores of a laptop to itself
MEASURED = {"smoke": (17.0, 0.1), "fast": (150.0, 0.3)}
WORK_MB = {"smoke": 2.0, "fast": 80.0, "paper": 400.0}  # of an unfinished cell: its walk, its field, its pictures


def dry_run(grid: Grid, out: Path, workers: int = 1, retry: Iterable[str] = (), lpips: str | None = None) -> str:
    """The cells, and what is left to do in hours and gigabytes.

    Seconds come from the finished cells of the same model, which are taken to have run as many at a time as are asked
    for now, and so to have shared the cores as the next ones will. Without any they are those of a cell that had two
    cores to itself: workers share the cores, so that more of them take as long.

    Args:
        grid: checked.
        out: the results folder; nothing is written there.
        workers: cells at a time.
        retry: outcomes that would be forgotten, as in ``run_grid``.
        lpips: SHA-256 of the weights of LPIPS, where it is to be measured.

    Returns:
        Lines for people. A model that nobody has measured in this preset has no estimate.

    Raises:
        RunFolderError: the folder holds another grid, or another version's.
        DataError: a file is damaged.
    """
    kept = open_results(out, grid, lpips).outcomes() if (out / "grid.json").exists() else []
    done = {outcome.cell: outcome for outcome in kept if not outcome.runs_again(retry)}
    cells, at_once = grid.cells(), max(1, workers)
    left = [cell for cell in cells if cell not in done]
    lines = [f"{cell.name}  {_word(done.get(cell))}".rstrip() for cell in cells]
    lines.append(f"{len(cells)} cells, {len(left)} to run, {at_once} at a time")
    measured = [outcome for outcome in kept if outcome.finished]
    seconds = {model: _seconds(measured, grid, model, at_once) for model in grid.models}
    if not left:
        return "\n".join([*lines, "nothing is left to run"])
    unknown = [model for model in dict.fromkeys(cell.model for cell in left) if seconds[model] is None]
    if unknown:
        asked = " with " + ", ".join(grid.optional) if grid.optional else ""
        lines.append(f"no cell of {unknown[0]}{asked} was measured in preset {grid.preset} yet: run one, and ask again")
    else:
        hours = sum(seconds[cell.model] or 0.0 for cell in left) / 3600
        space = (_megabytes(measured, grid, out) * len(left) + WORK_MB[grid.preset] * at_once) / 1000
        lines.append(f"about {hours:.1f} hours and {space:.2f} GB, from {_source(measured, grid)}")
    return "\n".join(lines)


def _word(outcome: Outcome | None) -> str:
    if outcome is None:
        return ""
    return "finished" if outcome.finished else outcome.status.split(":")[0]


def _seconds(measured: Sequence[Outcome], grid: Grid, model: str, at_once: int) -> float | None:
    """Of the machine, for each cell of a model; None where nobody knows."""
    mine = [outcome.seconds for outcome in measured if outcome.cell.model == model]
    if mine:
        return sum(mine) / len(mine) / at_once
    return MEASURED[grid.preset][0] if _is_known(grid, model) else None


def _is_known(grid: Grid, model: str) -> bool:
    return model == MODEL and grid.preset in MEASURED and not grid.optional


def _megabytes(measured: Sequence[Outcome], grid: Grid, out: Path) -> float:
    """That a finished cell leaves."""
    if not measured:
        return MEASURED[grid.preset][1]
    files = [file for file in out.rglob("*") if file.is_file() and "work" not in file.relative_to(out).parts]
    return sum(file.stat().st_size for file in files) / 1e6 / len(measured)


def _source(measured: Sequence[Outcome], grid: Grid) -> str:
    if not measured:
        return f"a cell of {MEASURED[grid.preset][0]:.0f} s on two cores with nothing else to do"
    return f"{len(measured)} finished cells: {sum(o.seconds for o in measured) / len(measured):.0f} s each"
