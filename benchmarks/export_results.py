"""Export the results of a finished grid for a repository: cells, tables and plots, without the figures of the cells.

    autonerf-lab bench run --policies random,frontier,modular,e2e-cov --scenes val --starts 2 --preset fast --out RUN
    python benchmarks/export_results.py RUN benchmarks/results

The output is a results folder for `bench report`, `bench compare` and `load_results_table`. Prints the median time per
cell; the median is robust against other load on the machine.
"""

import argparse
import shutil
import sys
from pathlib import Path

import numpy as np
from matplotlib import image
from matplotlib.figure import Figure

from autonerf_lab.benchmark import Results, load_results
from autonerf_lab.benchmark.export import export_results
from autonerf_lab.benchmark.figures import coverage_curves, scores_over_policies
from autonerf_lab.benchmark.grid import label
from autonerf_lab.benchmark.results_table import load_results_table

NOT_EXPORTED = "scores.parquet"  # the same rows as scores.csv


def trajectories(results: Results) -> Figure:
    """Plot the trajectories of all policies from one start in one scene in top view."""
    cells = [cell for cell in results.grid.cells() if (cell.scene, cell.start) == (results.grid.scenes[0], 0)]
    columns = (len(cells) + 1) // 2
    figure = Figure(figsize=(3.2 * columns, 7), layout="constrained")
    axes = figure.subplots(2, columns, squeeze=False).ravel()
    for ax in axes:
        ax.axis("off")
    for ax, cell in zip(axes, cells, strict=False):
        ax.imshow(image.imread(results.path / "figures" / f"{cell.name}_trajectory.webp"))
        ax.set_title(label(cell.policy))
    return figure


def main() -> None:
    """Copy the cells, write the tables and draw the plots."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, help="results folder of `bench run`")
    parser.add_argument("out", type=Path, help="output folder")
    arguments = parser.parse_args()
    results = load_results(arguments.run)
    found = load_results_table(results)
    finished = sum(outcome.finished for outcome in found.outcomes)
    if finished < found.cell_count:
        sys.exit(f"{finished} of {found.cell_count} cells are finished: finish the grid first")

    (arguments.out / "cells").mkdir(parents=True, exist_ok=True)
    for name in ["grid.json", *(f"cells/{cell.name}.json" for cell in results.grid.cells())]:
        shutil.copyfile(results.path / name, arguments.out / name)
    for file in export_results(found, arguments.out):
        if file.name == NOT_EXPORTED:
            file.unlink()
    scores_over_policies(found).savefig(arguments.out / "scores.png", dpi=70)
    coverage_curves(found).savefig(arguments.out / "curves.png", dpi=70)
    trajectories(results).savefig(arguments.out / "trajectories.jpg", dpi=110)

    seconds = [outcome.seconds for outcome in found.outcomes]
    print(f"{len(seconds)} cells; {np.median(seconds):.0f} s each (median), {sum(seconds) / 3600:.1f} h in total")


if __name__ == "__main__":
    main()
