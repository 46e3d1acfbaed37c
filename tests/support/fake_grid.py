"""Small grid of fake cells. Worker processes import them from this folder."""

import json
from pathlib import Path

import fake_cell

from autonerf_lab.benchmark import Grid, run_grid

SUPPORT = Path(__file__).parent
GRID = Grid(("random", "frontier"), ("val-0", "val-1"), 2, preset="smoke")


def run(tmp_path, behaviour=None, grid=GRID, **arguments):
    """Run a grid of fake cells with a behaviour by cell name, see :func:`fake_cell.run`."""
    (tmp_path / "behaviour.json").write_text(json.dumps(behaviour or {}))
    return run_grid(grid, tmp_path / "out", function=fake_cell.FUNCTION, **arguments)


def statuses(results):
    """Return the first word of the status by cell name."""
    return {outcome.cell.name: outcome.status.split(":")[0] for outcome in results.outcomes()}


def log(tmp_path):
    """Return the names of the cells that ran, in order."""
    return [line.split()[0] for line in (tmp_path / "log").read_text().splitlines()]


NAMES = [cell.name for cell in GRID.cells()]
