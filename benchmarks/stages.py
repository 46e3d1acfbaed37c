"""Which stage loses what: exploration, field, or evaluator?

In each scene three things go through tasks 1 to 5: a field of a walk of ``--policy``; a field of ``--views`` images
taken uniformly over the scene, which is what exploration could give at best; and the true geometry, which is what a
field could. From one column to the next is what a stage loses. Beside them the bar that the scores are to reach.

Each scene is kept in ``--out`` as soon as it is done, and fits go on from their checkpoints: interrupted, the same
command goes on.

    python benchmarks/stages.py                      # development scenes: ten fits
    python benchmarks/stages.py --split val
    python benchmarks/stages.py --quick

Prints a Markdown table of means over scenes and, as the last line, one JSON object.
"""

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

from common.output import mean_of
from common.views import TRAIN_SEED, photographs

from autonerf_lab.benchmark.paper import MAPS, PLANNING, POSE, RENDERING, Column
from autonerf_lab.config import preset
from autonerf_lab.evaluators import Scores, evaluate, oracle_scores
from autonerf_lab.exploration import explore
from autonerf_lab.nerf import fit
from autonerf_lab.policies import weights_sha256
from autonerf_lab.scenes import load_scene, scene_names
from autonerf_lab.simulator import Simulator
from autonerf_lab.utils import storage

MODEL = "semantic-nerfacto"
BAR: dict[str, dict[str, float]] = {
    "rendering": {"psnr": 28, "ssim": 0.90, "per_class_accuracy": 95, "miou": 90},
    "maps": {
        **{"free_accuracy": 95, "free_precision": 95, "free_recall": 90},
        **{"occupancy_precision": 85, "occupancy_recall": 85},
        **{"semantic_precision_5cm": 70, "semantic_recall_5cm": 70},
    },
    "planning": {"pointgoal_success": 90, "pointgoal_spl": 88, "objectgoal_success": 75, "objectgoal_spl": 72},
    "pose_refinement": {"convergence_rate": 80, "rotation_error_deg": 0.15, "translation_error_m": 0.004},
}
COLUMNS = [column for column in (*RENDERING, *MAPS, *PLANNING, *POSE) if column.metric in BAR[column.task]]


def values_of(scores: Scores) -> dict[str, float | None]:
    """The scores that have a bar."""
    return {column.title: scores[column.key] for column in COLUMNS}


def measure(name: str, policy: str, views: int, size: str, folder: Path) -> dict[str, dict[str, float | None]]:
    """Scores of a scene: of the walk, of uniform views and of the truth; those of the folder, if it has them."""
    identity = {"scene": name, "policy": policy, "weights": weights_sha256(policy), "views": views, "preset": size}
    kept = folder / f"{name}.json"
    if kept.exists() and (found := storage.read_json(kept))["identity"] == identity:
        return found["scores"]
    scene, sizes = load_scene(name), preset(size)
    sim = Simulator.of_preset(scene, sizes)
    seen = {
        "walk": explore(sim, policy, steps=sizes.walk_steps, seed=0, progress=False),
        "uniform views": photographs(sim, views, TRAIN_SEED),
    }
    scores: dict[str, Any] = {}
    for column, trajectory in seen.items():
        nerf = fit(trajectory, MODEL, size, checkpoint=folder / f"{name}-{column.split()[0]}")
        scores[column] = values_of(evaluate(nerf, scene, size, tasks=BAR, progress=False))
    scores["truth"] = values_of(oracle_scores(scene, size, tasks=BAR))
    storage.write_json(kept, {"identity": identity, "scores": scores})
    return scores


def _shown(value: float | None, bar: float, score: Column) -> str:
    if value is None:
        return "-"
    text = f"{value * score.scale:.{score.decimals}f}"
    return text if score.better * value >= score.better * bar else f"**{text}**"


def main() -> None:
    """Measure, print the table, and one JSON object as the last line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--split", default="dev", choices=["train", "dev", "val"])
    parser.add_argument("--policy", default="modular-obs")
    parser.add_argument("--views", type=int, default=600, help="images of the second column")
    parser.add_argument("--out", type=Path, default=Path("runs/stages"), help="where scenes are kept")
    parser.add_argument("--quick", action="store_true", help="one scene, the smoke preset")
    options = parser.parse_args()
    names, size = scene_names(options.split), "fast"
    if options.quick:
        names, size, options.views, options.out = names[:1], "smoke", 40, Path(tempfile.mkdtemp())
    rows = [measure(name, options.policy, options.views, size, options.out) for name in names]
    fields = list(rows[0])
    print(f"| score | bar | {options.policy} | {options.views} uniform views | truth |")
    print("|---|---|---|---|---|")
    means: dict[str, dict[str, float | None]] = {}
    for score in COLUMNS:
        bar = BAR[score.task][score.metric]
        found = {field: mean_of([row[field] for row in rows], score.title) for field in fields}
        shown = [_shown(value, bar, score) for value in found.values()]
        print(f"| {score.title} | {bar * score.scale:g} | " + " | ".join(shown) + " |")
        means[f"{score.task}: {score.metric}"] = found
    print(f"means of {len(names)} scenes, preset {size}; in bold what misses the bar")
    print(json.dumps({"scenes": names, "policy": options.policy, "preset": size, "means": means}))


if __name__ == "__main__":
    main()
