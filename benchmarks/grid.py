"""Cost of a cell of a grid, and throughput with one and with two workers.

    python benchmarks/grid.py            # 2 policies x 2 development scenes, preset fast, twice: half an hour
    python benchmarks/grid.py --quick    # preset smoke

The same grid runs with one and with two workers, which share the cores. Two workers gain only the core time that one
worker leaves idle in single-threaded parts. Prints the mean seconds and the peak GB per stage, the cells per hour
(including the start of the workers), and as the last line one JSON object. A cell with the preset smoke compiles the
kernels first and is not measured.
"""

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from autonerf_lab.benchmark import Grid, Results, run_grid
from autonerf_lab.benchmark.results import StageCost

LIMIT_SECONDS, LIMIT_GB = 150.0, 4.0  # of a fast cell on two cores
WORKERS = (1, 2)

Stages = dict[str, dict[str, float]]


def stages_of(results: Results) -> Stages:
    """Return the mean seconds and the peak GB of each stage over the finished cells."""
    rows: dict[str, list[StageCost]] = {}
    for outcome in results.outcomes():
        for stage, row in (outcome.stages or {}).items():
            rows.setdefault(stage, []).append(row)
    return {
        stage: {
            "seconds": round(sum(row["seconds"] for row in found) / len(found), 2),
            "gb": round(max(row["peak_gb"] or 0.0 for row in found), 3),
        }
        for stage, found in rows.items()
    }


def measure(grid: Grid, folder: Path, workers: int) -> dict[str, Any]:
    """Run a grid in a new folder and return its cost."""
    started = time.perf_counter()
    results = run_grid(grid, folder / f"workers-{workers}", workers)
    hours = (time.perf_counter() - started) / 3600
    failed = [f"{o.cell.name}: {o.status}" for o in results.outcomes() if not o.finished]
    if failed:
        sys.exit(f"error: {failed[0]}")
    stages = stages_of(results)
    return {
        "cells_per_hour": round(len(grid.cells()) / hours, 1),
        "cell_s": round(sum(row["seconds"] for row in stages.values()), 1),
        "cell_gb": max(row["gb"] for row in stages.values()),
        "stages": stages,
    }


def main() -> None:
    """Run the benchmark and print the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--policies", default="random,frontier")
    parser.add_argument("--scenes", default="dev-0,dev-1")
    parser.add_argument("--preset", default="fast")
    parser.add_argument("--quick", action="store_true", help="use the preset smoke")
    options = parser.parse_args()
    preset = "smoke" if options.quick else options.preset
    grid = Grid(tuple(options.policies.split(",")), tuple(options.scenes.split(",")), 1, preset=preset)
    with tempfile.TemporaryDirectory() as folder:
        run_grid(Grid(grid.policies[:1], grid.scenes[:1], 1, preset="smoke"), Path(folder) / "warm")
        made = {workers: measure(grid, Path(folder), workers) for workers in WORKERS}
    heads = "".join(f"{f'{workers} worker' + 's' * (workers > 1):>20}" for workers in WORKERS)
    print(f"\n{preset}, {len(grid.cells())} cells: seconds and GB per stage\n{'':<14}{heads}")
    for stage in made[1]["stages"]:
        rows = [made[workers]["stages"][stage] for workers in WORKERS]
        print(f"{stage:<14}" + "".join(f"{row['seconds']:>12.1f}{row['gb']:>8.2f}" for row in rows))
    print(f"{'cell':<14}" + "".join(f"{made[w]['cell_s']:>12.1f}{made[w]['cell_gb']:>8.2f}" for w in WORKERS))
    print(f"{'cells/hour':<14}" + "".join(f"{made[w]['cells_per_hour']:>20.1f}" for w in WORKERS))
    if preset == "fast":
        within = made[1]["cell_s"] <= LIMIT_SECONDS and made[1]["cell_gb"] <= LIMIT_GB
        print(f"{'within' if within else 'OVER'} the limits of a cell: {LIMIT_SECONDS:.0f} s, {LIMIT_GB:.0f} GB")
    print(json.dumps({"preset": preset, "cells": len(grid.cells()), "workers": made}))


if __name__ == "__main__":
    main()
