"""Ablation of Semantic Nerfacto: the ``fast`` settings with one change at a time.

    python benchmarks/ablation.py                  # about two hours; writes benchmarks/ablation.md
    python benchmarks/ablation.py --quick          # two rows and a few steps, written under runs/

A cell is one row of VARIATIONS on one scene, stored as JSON under ``--cells``. An interrupted run continues where it
stopped; a cell whose settings have changed is computed again. The time of a step is measured separately from the fit,
in turns with a step of the base, so that other load affects both alike.

Prints the table and, as the last line, one JSON object.
"""

import argparse
import json
import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from common.output import mean_of
from common.training import Trainer, fit_and_score, in_fresh_process, interleaved, pixels_of
from common.views import read_views, write_views

from autonerf_lab.errors import AutoNerfError
from autonerf_lab.nerf.models import MODELS
from autonerf_lab.nerf.settings import Settings
from autonerf_lab.utils.storage import read_json, write_json

BASE = MODELS["semantic-nerfacto"].settings["fast"]


@dataclass(frozen=True)
class Variation:
    """The base with some settings overridden; the overrides must exist in the model's ``fast`` settings."""

    name: str  # heading of the row
    overrides: Mapping[str, Any]
    model: str = "semantic-nerfacto"
    seed: int = 0

    @property
    def settings(self) -> Settings:
        """Settings of the row."""
        return replace(MODELS[self.model].settings["fast"], **{"steps": BASE.steps, **self.overrides})


VARIATIONS = (
    Variation("base", {}),
    Variation("base, another seed", {}, seed=1),  # size of random differences
    Variation("no distortion loss", {"distortion_weight": 0.0}),
    Variation("interlevel weight 0.1", {"interlevel_weight": 0.1}),
    Variation("24 samples", {"samples": 24}),
    Variation("16 samples", {"samples": 16}),
    Variation("12 samples", {"samples": 12}),
    Variation("half the rays, twice the steps", {"rays": BASE.rays // 32 * 16, "steps": 2 * BASE.steps}),
    Variation("twice the rays, half the steps", {"rays": 2 * BASE.rays, "steps": BASE.steps // 2}),
    Variation("finest cells 1 cm", {"fine": 0.01}),
    Variation("finest cells 2 cm", {"fine": 0.02}),
    Variation("finest cells 3 cm", {"fine": 0.03}),
    Variation("2^16 entries per level", {"log2_entries": 16}),
    Variation("2^17 entries per level", {"log2_entries": 17}),
    Variation("2^18 entries per level", {"log2_entries": 18}),
    Variation("semantic weight 0.02", {"semantic_weight": 0.02}),
    Variation("semantic weight 0.1", {"semantic_weight": 0.1}),
    Variation("semantic weight 0.5", {"semantic_weight": 0.5}),
    Variation("colour without view direction", {"view_dependent": False}),
    Variation("two rounds of proposals, 64 and 32", {"proposal_samples": (64, 32)}),
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
    "depth_median_error_m": ("median depth error, cm", 100, 1),
    "relative_step": ("time of a step, base = 1", 1, 2),
}


def rows_to_run() -> list[Variation]:
    """Return the base and the rows that differ from it; a change may have become the default."""
    base, *others = VARIATIONS
    return [base, *(row for row in others if (row.settings, row.seed, row.model) != (BASE, base.seed, base.model))]


def relative_step(folder: Path, row: Variation, quick: bool) -> float:
    """Return the time of a step relative to the base, both after an eighth of their training."""
    pixels = pixels_of(read_views(folder, depth=row.settings.depth_weight > 0)[0])
    trainers = {"base": Trainer(pixels, BASE), "row": Trainer(pixels, row.settings, row.model)}
    for trainer in trainers.values():
        for _ in range(3 if quick else trainer.settings.steps // 8):
            trainer.step()
    # 16 steps, because the occupancy grid is updated every 16 steps
    times = interleaved({name: (trainer.step, 16) for name, trainer in trainers.items()}, 1 if quick else 5)
    return times["row"] / times["base"]


def run_cell(folder: Path, row: Variation, identity: dict[str, Any], options: argparse.Namespace) -> dict[str, Any]:
    """Fit, evaluate and time one row on one scene."""
    settings = row.settings
    if options.quick:
        settings = replace(settings, steps=20)
    arguments = {"model": row.model, "seed": row.seed}
    found = in_fresh_process(options.threads, fit_and_score, folder, settings, **arguments)
    step = 1.0
    if (row.settings, row.model) != (BASE, VARIATIONS[0].model):
        step = in_fresh_process(options.threads, relative_step, folder, row, options.quick)
    return {"identity": identity, **found["rows"][-1], "relative_step": step}


def finished(path: Path, identity: dict[str, Any]) -> dict[str, Any] | None:
    """Return the stored cell if it has these settings, else None."""
    cell = read_json(path, dict[str, Any]) if path.exists() else None
    return cell if cell and cell["identity"] == json.loads(json.dumps(identity)) else None


def run_scene(scene: str, rows: list[Variation], options: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """Return all rows of one scene by name; views are rendered when the first cell needs them."""
    cells = {}
    with tempfile.TemporaryDirectory() as folder:
        views = Path(folder) / scene
        for row in rows:
            identity = {"scene": scene, "model": row.model, "seed": row.seed, "settings": asdict(row.settings)}
            identity |= {"views": options.views, "test_views": options.test_views}
            path = options.cells / scene / f"{slug(row.name)}.json"
            cell = finished(path, identity)
            if cell is None:
                if not views.exists():
                    in_fresh_process(options.threads, write_views, scene, views, options.views, options.test_views)
                try:
                    cell = run_cell(views, row, identity, options)
                except AutoNerfError as error:
                    print(f"{scene}  {row.name}: {error}", flush=True)
                    cells[row.name] = dict.fromkeys(COLUMNS)
                    continue
                write_json(path, cell)
            cells[row.name] = cell
            print(f"{scene}  {row.name:<36}{cell['psnr']:>7.2f} dB {cell['seconds']:>7.1f} s", flush=True)
    return cells


def slug(name: str) -> str:
    """Return a file name: ``"2^16 entries per level"`` becomes ``"2-16-entries-per-level"``."""
    words = "".join(letter if letter.isalnum() or letter == "." else " " for letter in name).split()
    return "-".join(words)


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


def text(results: dict[str, list[dict[str, Any]]], options: argparse.Namespace) -> str:
    """Return the Markdown file."""
    return f"""# Ablation of Semantic Nerfacto

Written by `python benchmarks/ablation.py --scenes {" ".join(options.scenes)}`.

Each row changes one of the `fast` settings; {BASE.steps} steps and no depth unless the row says otherwise.
Trained on {options.views} views of 128×128, uniform over the scene; evaluated on {options.test_views} test views.
Values are means over {", ".join(options.scenes)} with one seed. The row with another seed shows the size of random
differences. The time of a step is measured in turns with the base, both after an eighth of their training.

{table(results)}
"""


def main() -> None:
    """Run the missing cells, then print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", nargs="+", default=["dev-0", "dev-1"], help="Names of scenes.")
    names = [row.name for row in rows_to_run()]
    parser.add_argument("--rows", nargs="+", choices=names, metavar="NAME", help="Rows besides the base. Default: all.")
    parser.add_argument("--views", type=int, default=600, help="Training views per scene.")
    parser.add_argument("--test-views", type=int, default=60, help="Test views per scene.")
    parser.add_argument("--threads", type=int, default=2, help="Number of threads.")
    parser.add_argument("--cells", type=Path, default=None, help="Folder of cells. Default: runs/ablation.")
    parser.add_argument("--out", type=Path, default=None, help="Output file. Default: benchmarks/ablation.md.")
    parser.add_argument("--quick", action="store_true", help="Two rows, few views and steps.")
    options = parser.parse_args()
    rows = rows_to_run()
    if options.rows:
        rows = [rows[0], *(row for row in rows[1:] if row.name in options.rows)]
    if options.quick:
        rows = rows if options.rows else [rows[0], rows[2]]
        options.scenes, options.views, options.test_views = options.scenes[:1], 60, 4
    options.cells = options.cells or Path("runs/ablation-quick" if options.quick else "runs/ablation")
    quick_out = options.cells / "ablation.md"
    options.out = options.out or (quick_out if options.quick else Path(__file__).with_suffix(".md"))
    by_scene = [run_scene(scene, rows, options) for scene in options.scenes]
    results = {row.name: [cells[row.name] for cells in by_scene] for row in rows}
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(text(results, options))
    print(table(results))
    print(json.dumps({name: {key: mean_of(cells, key) for key in COLUMNS} for name, cells in results.items()}))


if __name__ == "__main__":
    main()
