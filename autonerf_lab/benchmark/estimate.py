"""What a grid will cost, from cells that were measured."""

from collections.abc import Sequence
from pathlib import Path

from autonerf_lab.benchmark.grid import Grid
from autonerf_lab.benchmark.results import Outcome, load_results
from autonerf_lab.errors import AutoNerfError

# seconds and kept megabytes of a cell of semantic-nerfacto that has the two cores of a laptop to itself
MEASURED = {"smoke": (12.0, 0.1), "fast": (180.0, 0.3)}
WORK_MB = {"smoke": 2.0, "fast": 80.0, "paper": 400.0}  # of an unfinished cell: its walk, its field, its pictures


def dry_run(grid: Grid, out: Path, workers: int = 1) -> str:
    """The cells, and what is left to do in hours and gigabytes.

    Args:
        grid: checked.
        out: the results folder; its finished cells are what is measured, if it has any of the same preset.
        workers: cells at a time.

    Returns:
        Lines for people. A preset that nobody has measured has no estimate.
    """
    done: list[Outcome] = []
    if (out / "grid.json").exists():
        try:
            done = [outcome for outcome in load_results(out).outcomes() if outcome.cell.preset == grid.preset]
        except AutoNerfError as error:
            return f"{error}"
    finished = {outcome.cell for outcome in done if outcome.finished}
    left = [cell for cell in grid.cells() if cell not in finished]
    lines = [f"{cell.name}  {'finished' if cell in finished else ''}".rstrip() for cell in grid.cells()]
    lines.append(f"{len(grid.cells())} cells, {len(left)} to run, {max(1, workers)} at a time")
    cost = _cost(done, out, grid.preset)
    if cost is None:
        lines.append(f"no cell of preset {grid.preset} was measured yet: run one, and ask again")
    else:
        seconds, megabytes, source = cost
        hours = seconds * len(left) / max(1, workers) / 3600
        space = (megabytes * len(left) + WORK_MB[grid.preset] * max(1, workers)) / 1000
        lines.append(f"about {hours:.1f} hours and {space:.2f} GB, from {source}")
    return "\n".join(lines)


def _cost(done: Sequence[Outcome], out: Path, preset: str) -> tuple[float, float, str] | None:
    measured = [outcome for outcome in done if outcome.finished]
    if measured:
        files = [file for file in out.rglob("*") if file.is_file() and "work" not in file.relative_to(out).parts]
        megabytes = sum(file.stat().st_size for file in files) / 1e6 / len(measured)
        seconds = sum(outcome.seconds for outcome in measured) / len(measured)
        return seconds, megabytes, f"{len(measured)} finished cells: {seconds:.0f} s each"
    if preset not in MEASURED:
        return None
    return *MEASURED[preset], f"a cell of {MEASURED[preset][0]:.0f} s on two cores with nothing else to do"
