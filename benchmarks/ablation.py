"""Ablation of Semantic Nerfacto: the ``fast`` settings with one change at a time.

    python benchmarks/ablation.py                  # writes benchmarks/ablation.md: six hours without stored cells
    python benchmarks/ablation.py --quick          # two rows and a few steps, written under runs/

A cell is one row of VARIATIONS on one scene with one seed, stored as JSON under ``--cells``, `benchmarks/ablation`. An
interrupted run continues where it stopped; a cell whose settings have changed is computed again. The time of a step is
measured separately from the fit, on the first scene, in turns with a step of the base, so that other load affects both
alike; ``--untimed`` leaves it to a later run, so that two processes can compute cells.

Prints the table and, as the last line, one JSON object.
"""

import argparse
import json
import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from common.output import mean_of, saved_result, slug
from common.training import Trainer, fit_and_score, in_fresh_process, interleaved
from common.views import read_views, write_views

from autonerf_lab.errors import AutoNerfError
from autonerf_lab.nerf.models import MODELS
from autonerf_lab.nerf.models.semantic_nerfacto import SETTINGS
from autonerf_lab.nerf.settings import Settings
from autonerf_lab.utils.storage import write_json

BASE = SETTINGS["fast"]


@dataclass(frozen=True)
class Variation:
    """The base with some settings overridden; the overrides must exist in the model's ``fast`` settings."""

    name: str  # heading of the row
    overrides: Mapping[str, Any]
    model: str = "semantic-nerfacto"

    @property
    def settings(self) -> Settings:
        """Settings of the row."""
        return replace(MODELS[self.model].settings["fast"], **{"steps": BASE.steps, **self.overrides})


VARIATIONS = (
    Variation("base", {}),
    Variation("no average of the last parameters", {"averaged": 0.0}),
    Variation("no average, lower final learning rate", {"averaged": 0.0, "final_learning_rate": 2e-3}),
    Variation("no distortion loss", {"distortion_weight": 0.0}),
    Variation("interlevel weight 0.1", {"interlevel_weight": 0.1}),
    Variation("24 samples", {"samples": 24}),
    Variation("16 samples", {"samples": 16}),
    # A step takes 0.745 times as long as one of the base.
    Variation("16 samples, as much time", {"samples": 16, "steps": round(BASE.steps / 0.745)}),
    Variation("half the rays, twice the steps", {"rays": BASE.rays // 32 * 16, "steps": 2 * BASE.steps}),
    Variation("twice the rays, half the steps", {"rays": 2 * BASE.rays, "steps": BASE.steps // 2}),
    Variation("finest cells 1 cm", {"fine": 0.01}),
    Variation("finest cells 2 cm", {"fine": 0.02}),
    Variation("finest cells 3 cm", {"fine": 0.03}),
    Variation("2^17 entries per level", {"log2_entries": 17}),
    Variation("2^18 entries per level", {"log2_entries": 18}),
    Variation("semantic weight 0.02", {"semantic_weight": 0.02}),
    Variation("semantic weight 0.1", {"semantic_weight": 0.1}),
    Variation("colour without view direction", {"view_dependent": False}),
    Variation("no rays by class", {"rays_by_class": 0.0}),
    Variation("two rounds of proposals, 64 and 32", {"proposal_samples": (64, 32)}),
    Variation("two rounds, 64 and 32; padding 0.01", {"proposal_samples": (64, 32), "histogram_padding": 0.01}),
    Variation(
        "two rounds, 48 and 24; padding 0.01; 20 samples",
        {"proposal_samples": (48, 24), "histogram_padding": 0.01, "samples": 20},
    ),
    Variation("padding 0.0094", {"histogram_padding": 0.3 / 32}),
    Variation("proposals updated every 2nd step", {"proposal_every": 2}),
    Variation("all samples active (min_weight 0)", {"min_weight": 0.0}),
    Variation("shell as thick as half the box", {"shell": 1.0}),
    Variation("trained with depth", {"depth_weight": 2.25}),
    Variation("occupancy grid (instant-ngp)", {"rays": BASE.rays}, model="instant-ngp"),
)

COLUMNS = {  # score -> heading, factor, decimals
    "psnr": ("PSNR, dB", 1, 2),
    "ssim": ("SSIM", 1, 3),
    "per_class_accuracy": ("per-class accuracy, %", 1, 1),
    "miou": ("mIoU, %", 1, 1),
    "depth_median_error_m": ("median depth error, cm", 100, 1),
    "relative_step": ("time of a step, base = 1", 1, 2),
}


def rows_to_run() -> list[Variation]:
    """Return the base and the rows that differ from it; a change may have become the default."""
    base, *others = VARIATIONS
    return [base, *(row for row in others if (row.settings, row.model) != (BASE, base.model))]


def relative_step(folder: Path, row: Variation, quick: bool) -> float:
    """Return the time of a step relative to the base, both after an eighth of their training."""
    if row == VARIATIONS[0]:
        return 1.0
    views = read_views(folder, depth=row.settings.depth_weight > 0)[0]
    trainers = {"base": Trainer(views, BASE), "row": Trainer(views, row.settings, row.model)}
    for trainer in trainers.values():
        for _ in range(3 if quick else trainer.settings.steps // 8):
            trainer.step()
    # 16 steps, because the occupancy grid is updated every 16 steps
    times = interleaved({name: (trainer.step, 16) for name, trainer in trainers.items()}, 1 if quick else 15)
    return times["row"] / times["base"]


def run_scene(scene: str, rows: list[Variation], options: argparse.Namespace) -> dict[str, list[dict[str, Any]]]:
    """Return the cells of all rows on one scene by name, one per seed; the views are rendered if a cell is missing."""
    cells: dict[str, list[dict[str, Any]]] = {row.name: [] for row in rows}
    with tempfile.TemporaryDirectory() as folder:
        views = Path(folder) / scene
        for seed, row in product(options.seeds, rows):
            identity = {"scene": scene, "model": row.model, "seed": seed, "settings": asdict(row.settings)}
            identity |= {"views": options.views, "test_views": options.test_views}
            path = options.cells / scene / f"{slug(row.name)}-{seed}.json"
            cell = saved_result(path, identity) or {}
            first = (scene, seed) == (options.scenes[0], options.seeds[0])
            untimed = first and cell.get("relative_step") is None and not options.untimed
            if (untimed or not cell) and not views.exists():
                in_fresh_process(options.threads, write_views, scene, views, options.views, options.test_views)
            try:
                if not cell:
                    settings = replace(row.settings, steps=20) if options.quick else row.settings
                    found = in_fresh_process(
                        options.threads, fit_and_score, views, settings, model=row.model, seed=seed
                    )
                    cell = {"identity": identity, **found["rows"][-1], "relative_step": None}
                    write_json(path, cell)
                if untimed:
                    cell["relative_step"] = in_fresh_process(options.threads, relative_step, views, row, options.quick)
                    write_json(path, cell)
            except AutoNerfError as error:
                print(f"{scene}  {row.name}: {error}", flush=True)
                cells[row.name].append(dict.fromkeys(COLUMNS))
                continue
            cells[row.name].append(cell)
            print(f"{scene}  {seed}  {row.name:<36}{cell['psnr']:>7.2f} dB {cell['seconds']:>7.1f} s", flush=True)
    return cells


def table(results: dict[str, list[dict[str, Any]]]) -> str:
    """Return the means over scenes as a Markdown table with one row per variation."""
    lines = ["| variation | " + " | ".join(heading for heading, _, _ in COLUMNS.values()) + " |"]
    lines.append("|---|" + "---:|" * len(COLUMNS))
    for name, cells in results.items():
        values = []
        for key, (_, factor, decimals) in COLUMNS.items():
            mean = mean_of(cells, key)
            values.append("–" if mean is None else f"{factor * mean:.{decimals}f}")
        lines.append(f"| {name} | " + " | ".join(values) + " |")
    return "\n".join(lines)


def random_differences(base: list[dict[str, Any]], seeds: int) -> str:
    """Describe how much trainings of the base differ that differ only in their seed.

    Scenes without a score of every seed do not count; the text is empty if none is left, or with one seed.
    """
    keys = list(COLUMNS)[:-1]
    values = np.array([[cell[key] for key in keys] for cell in base], float)  # NaN for a missing score
    values = values.reshape(-1, seeds, len(keys))  # scenes, seeds, scores
    values = values[np.isfinite(values).all(axis=(1, 2))]
    if seeds < 2 or not len(values):
        return ""
    ranges = dict(zip(keys, np.ptp(values, axis=1).mean(axis=0), strict=True))
    found = [f"{COLUMNS[key][1] * spread:.{COLUMNS[key][2]}f}" for key, spread in ranges.items()]
    return "\nTrainings of the base with another seed differ by {} dB, {} (SSIM), {} and {} points, and {} cm.".format(
        *found
    )


def text(results: dict[str, list[dict[str, Any]]], options: argparse.Namespace) -> str:
    """Return the Markdown file."""
    seeds = list(map(str, options.seeds))
    differences = random_differences(results["base"], len(seeds))
    return f"""# Ablation of Semantic Nerfacto

Written by `python benchmarks/ablation.py --scenes {" ".join(options.scenes)} --seeds {" ".join(seeds)}`.

Each row changes the `fast` settings that it names; {BASE.steps} steps and no depth unless the row says otherwise.
The settings of `instant-ngp` are its own, which do not average the parameters.
Padding is the weight that is added to every bin of a proposal in resampling: {BASE.histogram_padding:.4f} in the base.
Trained on {options.views} views of 128×128, uniform over the scene; evaluated on {options.test_views} test views.
Values are means over {", ".join(options.scenes)}, each with seed {" and ".join(seeds)}.{differences}
The time of a step is measured in turns with the base, both after an eighth of their training.

{table(results)}
"""


def main() -> None:
    """Run the missing cells, then print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", nargs="+", default=["dev-0", "dev-1"], help="Names of scenes.")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1], help="Random seeds.")
    names = [row.name for row in rows_to_run()]
    parser.add_argument("--rows", nargs="+", choices=names, metavar="NAME", help="Rows besides the base. Default: all.")
    parser.add_argument("--views", type=int, default=600, help="Training views per scene.")
    parser.add_argument("--test-views", type=int, default=60, help="Test views per scene.")
    parser.add_argument("--threads", type=int, default=2, help="Number of threads.")
    parser.add_argument("--cells", type=Path, default=None, help="Folder of cells. Default: benchmarks/ablation.")
    parser.add_argument("--out", type=Path, default=None, help="Output file. Default: benchmarks/ablation.md.")
    parser.add_argument("--untimed", action="store_true", help="Compute cells without step times, write no table.")
    parser.add_argument("--quick", action="store_true", help="Two rows, few views and steps.")
    options = parser.parse_args()
    rows = rows_to_run()
    if options.rows:
        rows = [rows[0], *(row for row in rows[1:] if row.name in options.rows)]
    if options.quick:
        rows = rows if options.rows else rows[:2]
        options.scenes, options.seeds, options.views, options.test_views = options.scenes[:1], options.seeds[:1], 60, 4
    options.cells = options.cells or (Path("runs/ablation-quick") if options.quick else Path(__file__).with_suffix(""))
    quick_out = options.cells / "ablation.md"
    options.out = options.out or (quick_out if options.quick else Path(__file__).with_suffix(".md"))
    by_scene = [run_scene(scene, rows, options) for scene in options.scenes]
    if options.untimed:
        return
    results = {row.name: [cell for cells in by_scene for cell in cells[row.name]] for row in rows}
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(text(results, options))
    print(table(results))
    print(json.dumps({name: {key: mean_of(cells, key) for key in COLUMNS} for name, cells in results.items()}))


if __name__ == "__main__":
    main()
