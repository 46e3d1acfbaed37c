"""Results folders with one score per cell, for tests of tables."""

from autonerf_lab.benchmark import Grid, Outcome, Results
from autonerf_lab.types import Score

MODEL = "semantic-nerfacto"
GRID = Grid(("frontier", "modular-obs"), ("val-0", "val-1", "val-2"), 1, preset="smoke")


def folder(path, values, grid=GRID, metric=("rendering", "psnr")):
    """Results whose cells have one score each; a string is the status of a cell without."""
    results = Results(path, grid)
    for cell in grid.cells():
        value = values[cell.policy][int(cell.scene[-1])]
        if isinstance(value, str):
            results.write(Outcome(cell, value))
        else:
            results.write(Outcome(cell, "ok", (Score(*metric, value),), {}))
    return results
