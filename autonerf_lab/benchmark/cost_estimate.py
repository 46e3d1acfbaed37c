"""Estimate of the cost of a grid from measured cells."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from autonerf_lab.benchmark.grid import Grid
from autonerf_lab.benchmark.results import Outcome, open_results

MODEL = "semantic-nerfacto"
# seconds and saved megabytes per cell of MODEL without optional tasks, alone on two cores of a laptop
MEASURED = {"smoke": (17.0, 0.1), "fast": (150.0, 0.3)}
WORK_MB = {"smoke": 2.0, "fast": 80.0, "paper": 400.0}  # of the run folder of an unfinished cell


def dry_run(grid: Grid, out: Path, workers: int = 1, retry: Iterable[str] = (), lpips: str | None = None) -> str:
    """List the cells and estimate the remaining time and disk space.

    The time per cell is the mean of the finished cells of the same model, which are assumed to have run with the same
    number of workers. Without finished cells, it is a measured time of one cell on two cores; more workers share the
    cores and thus do not reduce it.

    Args:
        grid: Validated grid, see :meth:`Grid.checked`.
        out: Results folder; nothing is written.
        workers: Number of worker processes.
        retry: Statuses of cells to run again, as in ``run_grid``.
        lpips: SHA-256 of the LPIPS weights; None: LPIPS is not computed.

    Returns:
        One line per cell and a summary. A model without measurements in this preset has no estimate.

    Raises:
        RunFolderError: The folder holds another grid, or results of another version.
        DataError: A file is damaged.
    """
    stored = open_results(out, grid, lpips).outcomes() if (out / "grid.json").exists() else []
    done = {outcome.cell: outcome for outcome in stored if not outcome.should_retry(retry)}
    cells, parallel = grid.cells(), max(1, workers)
    remaining = [cell for cell in cells if cell not in done]
    lines = [f"{cell.name}  {_status_word(done.get(cell))}".rstrip() for cell in cells]
    lines.append(f"{len(cells)} cells, {len(remaining)} to run, {parallel} at a time")
    measured = [outcome for outcome in stored if outcome.finished]
    seconds = {model: _seconds(measured, grid, model, parallel) for model in grid.models}
    if not remaining:
        return "\n".join([*lines, "all cells are finished"])
    unknown = [model for model in dict.fromkeys(cell.model for cell in remaining) if seconds[model] is None]
    if unknown:
        more = (*grid.optional, "baselines") if grid.baselines else grid.optional
        tasks = " with " + ", ".join(more) if more else ""
        lines.append(f"no estimate: no finished cell of {unknown[0]}{tasks} in preset {grid.preset}; run one first")
    else:
        hours = sum(seconds[cell.model] or 0.0 for cell in remaining) / 3600
        space = (_megabytes(measured, grid, out) * len(remaining) + WORK_MB[grid.preset] * parallel) / 1000
        lines.append(f"about {hours:.1f} hours and {space:.2f} GB, from {_source(measured, grid)}")
    return "\n".join(lines)


def _status_word(outcome: Outcome | None) -> str:
    if outcome is None:
        return ""
    return "finished" if outcome.finished else outcome.status.split(":")[0]


def _seconds(measured: Sequence[Outcome], grid: Grid, model: str, parallel: int) -> float | None:
    """Return the wall-clock seconds per cell of a model; None if unknown."""
    own = [outcome.seconds for outcome in measured if outcome.cell.model == model]
    if own:
        return sum(own) / len(own) / parallel
    return MEASURED[grid.preset][0] if _is_measured(grid, model) else None


def _is_measured(grid: Grid, model: str) -> bool:
    return model == MODEL and grid.preset in MEASURED and not grid.optional and not grid.baselines


def _megabytes(measured: Sequence[Outcome], grid: Grid, out: Path) -> float:
    """Return the saved megabytes per finished cell."""
    if not measured:
        return MEASURED[grid.preset][1]
    files = [file for file in out.rglob("*") if file.is_file() and "work" not in file.relative_to(out).parts]
    return sum(file.stat().st_size for file in files) / 1e6 / len(measured)


def _source(measured: Sequence[Outcome], grid: Grid) -> str:
    if not measured:
        return f"a cell of {MEASURED[grid.preset][0]:.0f} s on two otherwise idle cores"
    return f"{len(measured)} finished cells: {sum(o.seconds for o in measured) / len(measured):.0f} s each"
