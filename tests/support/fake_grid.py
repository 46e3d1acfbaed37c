"""A small grid of fake cells, run in processes that find this folder."""

import json
from pathlib import Path

import fake_cell

from autonerf_lab.benchmark import Grid, run_grid

SUPPORT = Path(__file__).parent
GRID = Grid(("random", "frontier"), ("val-0", "val-1"), 2, preset="smoke")


def run(tmp_path, told=None, grid=GRID, **arguments):
    (tmp_path / "told.json").write_text(json.dumps(told or {}))
    return run_grid(grid, tmp_path / "out", function=fake_cell.FUNCTION, **arguments)


def statuses(results):
    return {outcome.cell.name: outcome.status.split(":")[0] for outcome in results.outcomes()}


def log(tmp_path):
    return [line.split()[0] for line in (tmp_path / "log").read_text().splitlines()]


NAMES = [cell.name for cell in GRID.cells()]
