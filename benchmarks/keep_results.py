"""Keep what a grid found where others can read it: cells, tables and figures, without pictures, which weigh the most.

    autonerf-lab bench run --policies random,frontier,modular,e2e-cov --scenes val --starts 2 --preset fast --out RUN
    python benchmarks/keep_results.py RUN benchmarks/results

The folder that is kept is a results folder like any other: `bench report`, `bench compare` and `collect` read it.
Prints what a cell took: the median over the cells, because a machine that had other work to do makes some much longer.
"""

import argparse
import shutil
import sys
from pathlib import Path

import numpy as np
from matplotlib import image
from matplotlib.figure import Figure

from autonerf_lab.benchmark import Results, load_results
from autonerf_lab.benchmark.export import publish
from autonerf_lab.benchmark.figures import coverage_curves, scores_over_policies
from autonerf_lab.benchmark.grid import label
from autonerf_lab.benchmark.results_table import collect

NOT_KEPT = "scores.parquet"  # the same rows as scores.csv


def walks(results: Results) -> Figure:
    """The walks of all policies from one start in one apartment, from above; for a grid with pictures."""
    cells = [cell for cell in results.grid.cells() if (cell.scene, cell.start) == (results.grid.scenes[0], 0)]
    columns = (len(cells) + 1) // 2
    figure = Figure(figsize=(3.2 * columns, 7), layout="constrained")
    axes = figure.subplots(2, columns, squeeze=False).ravel()
    for ax in axes:
        ax.axis("off")
    for ax, cell in zip(axes, cells, strict=False):
        ax.imshow(image.imread(results.path / "pictures" / f"{cell.name}_walk.webp"))
        ax.set_title(label(cell.policy))
    return figure


def main() -> None:
    """Copy, publish, draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, help="a results folder, as `bench run` leaves it")
    parser.add_argument("kept", type=Path, help="where to keep it")
    arguments = parser.parse_args()
    results = load_results(arguments.run)
    found = collect(results)
    finished = sum(outcome.finished for outcome in found.outcomes)
    if finished < found.asked:
        sys.exit(f"{finished} of {found.asked} cells are finished: run the grid to its end first")

    (arguments.kept / "cells").mkdir(parents=True, exist_ok=True)
    for name in ["grid.json", *(f"cells/{cell.name}.json" for cell in results.grid.cells())]:
        shutil.copyfile(results.path / name, arguments.kept / name)
    for file in publish(load_results(arguments.kept)):
        if file.name == NOT_KEPT:
            file.unlink()
    scores_over_policies(found).savefig(arguments.kept / "scores.png", dpi=70)
    coverage_curves(found).savefig(arguments.kept / "curves.png", dpi=70)
    walks(results).savefig(arguments.kept / "walks.jpg", dpi=110)

    seconds = [outcome.seconds for outcome in found.outcomes]
    print(f"{len(seconds)} cells; {np.median(seconds):.0f} s each (median), {sum(seconds) / 3600:.1f} h in all")


if __name__ == "__main__":
    main()
