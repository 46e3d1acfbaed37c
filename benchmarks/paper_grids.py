"""Grids behind the tables of `benchmarks/results`: what of the paper holds here.

    python benchmarks/paper_grids.py  # about a day on two cores; continues after an interruption
    python benchmarks/paper_grids.py --grids test/policies  # one of them
    python benchmarks/paper_grids.py --grids test/policies --scenes test-00 --out runs/test-00  # a part of it
    python benchmarks/paper_grids.py --save-runs  # keeps the fields, for LPIPS by `bench lpips` without another fit
    python benchmarks/paper_grids.py --quick  # two small cells, as a check of the script

Each grid has a results folder of its own under ``--out``, in groups. ``test`` compares the policies of the paper in
the twenty test apartments. ``variants`` has further policies, and varies models, poses and semantics on the
trajectories of ``modular-obs``, in the first six. ``val`` has five starts in the five validation apartments, for the
correlations of rewards with scores. ``finetuning`` has four of these apartments, and ``houses`` the five homes of 180
to 300 m². `results/export.py` makes the tables of a group (of ``variants`` together with ``test``), and joins parts
with other ``--scenes``.

Prints the number of finished cells of each grid and, as the last line, one JSON object.
"""

import argparse
import json
import tempfile
from dataclasses import replace
from pathlib import Path

from autonerf_lab.benchmark import Grid, run_grid
from autonerf_lab.benchmark.correlations import POLICIES as MODULAR
from autonerf_lab.benchmark.grid import PAPER_POLICIES
from autonerf_lab.benchmark.table_entries import OURS
from autonerf_lab.scenes import scene_names

TRAINED = Path(__file__).parent / "policy_training"
IMITATIONS = tuple(str(TRAINED / f"{policy}-imitation.safetensors") for policy in MODULAR)
FROM_SCRATCH = tuple(str(TRAINED / f"{policy}-scratch.safetensors") for policy in MODULAR)
FIELD = Grid((OURS,), ("test",), 1)
VARIANT = replace(FIELD, scenes=tuple(scene_names("test")[:6]))
NOISE = replace(VARIANT, noise="ans", depth_noise="redwood")

# Alphabetical in each group: tables of a group have the rows in this order, and compare with the first row of a policy.
GRIDS = {
    f"test/{OURS}": replace(FIELD, optional=("navigation",), baselines=True),
    "test/policies": replace(FIELD, policies=tuple(name for name in PAPER_POLICIES if name != OURS)),
    "variants/policies-from-scratch": replace(VARIANT, policies=FROM_SCRATCH),
    "variants/policies-further": replace(VARIANT, policies=("paper-obs", *IMITATIONS, "oracle-obs")),
    "variants/with-estimated-poses": replace(NOISE, poses="estimated"),
    "variants/with-odometry": replace(NOISE, poses="odometry"),
    "variants/with-other-models": replace(
        VARIANT, models=("instant-ngp", "semantic-nerf", "semantic-nerfacto-rgbd", "instant-ngp-rgbd")
    ),
    "variants/with-predicted-semantics": replace(VARIANT, semantics="predicted"),
    "variants/with-refined-poses": replace(NOISE, poses="refined"),
    "variants/with-true-poses": replace(NOISE, poses="true"),
    "val/policies": Grid(("frontier-classic", *MODULAR), ("val",), 5),
    f"finetuning/{OURS}": Grid((OURS,), tuple(scene_names("val")[:4]), 1, optional=("finetuning",)),
    f"houses/{OURS}": Grid((OURS,), ("house",), 1),
}


def main() -> None:
    """Run the grids and print how much of them is finished."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--grids", nargs="+", default=[*GRIDS], choices=GRIDS, help="Names of grids.")
    parser.add_argument("--scenes", nargs="+", help="Scenes of all grids, instead of their own.")
    parser.add_argument("--workers", type=int, default=2, help="Cells at a time.")
    parser.add_argument("--retry", nargs="+", default=[], help="Statuses of cells to run again, such as failed.")
    parser.add_argument("--out", type=Path, default=Path("runs/paper"), help="Folder of the results folders.")
    parser.add_argument("--save-runs", action="store_true", help="Keep the run folder of each cell, with its field.")
    parser.add_argument("--quick", action="store_true", help="Two policies in one scene, as a check of the script.")
    options = parser.parse_args()
    grids = {name: GRIDS[name] for name in options.grids}
    if options.scenes:
        grids = {name: replace(grid, scenes=tuple(options.scenes)) for name, grid in grids.items()}
    if options.quick:
        small = replace(FIELD, policies=("random", OURS), scenes=("dev-0",), preset="smoke")
        grids, options.out = {"quick": small}, Path(tempfile.mkdtemp())
    finished = {}
    for name, grid in grids.items():
        results = run_grid(grid, options.out / name, options.workers, retry=options.retry, save_runs=options.save_runs)
        finished[name] = sum(outcome.finished for outcome in results.outcomes())
        print(f"{name}: {finished[name]} of {len(results.grid.cells())} cells", flush=True)
    print(json.dumps(finished))


if __name__ == "__main__":
    main()
