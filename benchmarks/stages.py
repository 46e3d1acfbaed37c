"""Losses of the pipeline by stage: exploration, field, evaluator.

In each scene, tasks 1 to 5 are evaluated for three fields: a field trained on the trajectory of ``--policy``; a field
trained on ``--views`` images from uniform poses, an upper bound for exploration; and the true geometry, an upper bound
for a field. The difference between two columns is the loss of a stage. The table also has the target values.

The result of each scene is saved in ``--out`` as soon as it is complete, and trainings continue from their checkpoints:
after an interruption, run the same command again.

    python benchmarks/stages.py                      # development scenes: ten trainings
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

from autonerf_lab.benchmark.paper import MAPS, PLANNING, POSE, RENDERING
from autonerf_lab.evaluators import Scores, evaluate, oracle_scores
from autonerf_lab.evaluators.metrics import Metric
from autonerf_lab.exploration import explore
from autonerf_lab.nerf import fit
from autonerf_lab.policies import weights_sha256
from autonerf_lab.presets import preset
from autonerf_lab.scenes import load_scene, scene_names
from autonerf_lab.simulator import Simulator
from autonerf_lab.utils import storage

MODEL = "semantic-nerfacto"
TARGETS: dict[str, dict[str, float]] = {
    "rendering": {"psnr": 28, "ssim": 0.90, "per_class_accuracy": 95, "miou": 90},
    "maps": {
        **{"free_accuracy": 95, "free_precision": 95, "free_recall": 90},
        **{"occupancy_precision": 85, "occupancy_recall": 85},
        **{"semantic_precision_5cm": 70, "semantic_recall_5cm": 70},
    },
    "planning": {"pointgoal_success": 90, "pointgoal_spl": 88, "objectgoal_success": 75, "objectgoal_spl": 72},
    "pose_refinement": {"convergence_rate": 80, "rotation_error_deg": 0.15, "translation_error_m": 0.004},
}
METRICS = [metric for metric in (*RENDERING, *MAPS, *PLANNING, *POSE) if metric.name in TARGETS[metric.task]]


def values_of(scores: Scores) -> dict[str, float | None]:
    """Return the scores that have a target value."""
    return {metric.heading: scores[metric.key] for metric in METRICS}


def measure(name: str, policy: str, views: int, size: str, folder: Path) -> dict[str, dict[str, float | None]]:
    """Score a scene: trajectory, uniform views and true geometry; return saved scores if there are any."""
    identity = {"scene": name, "policy": policy, "weights": weights_sha256(policy), "views": views, "preset": size}
    path = folder / f"{name}.json"
    if path.exists() and (found := storage.read_json(path, dict[str, Any]))["identity"] == identity:
        return found["scores"]
    scene, sizes = load_scene(name), preset(size)
    sim = Simulator.from_preset(scene, sizes)
    trajectories = {
        "trajectory": explore(sim, policy, steps=sizes.episode_steps, seed=0, progress=False),
        "uniform views": photographs(sim, views, TRAIN_SEED),
    }
    scores: dict[str, Any] = {}
    for column, trajectory in trajectories.items():
        nerf = fit(trajectory, MODEL, size, checkpoint=folder / f"{name}-{column.split()[0]}")
        scores[column] = values_of(evaluate(nerf, scene, size, tasks=TARGETS, progress=False))
    scores["truth"] = values_of(oracle_scores(scene, size, tasks=TARGETS))
    storage.write_json(path, {"identity": identity, "scores": scores})
    return scores


def _shown(value: float | None, target: float, metric: Metric) -> str:
    if value is None:
        return "-"
    text = metric.format(value)
    return text if metric.better * value >= metric.better * target else f"**{text}**"


def main() -> None:
    """Run the benchmark; print the table and, as the last line, one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--split", default="dev", choices=["train", "dev", "val"])
    parser.add_argument("--policy", default="modular-obs")
    parser.add_argument("--views", type=int, default=600, help="Number of images of the second field.")
    parser.add_argument("--out", type=Path, default=Path("runs/stages"), help="Folder of the results and checkpoints.")
    parser.add_argument("--quick", action="store_true", help="Measure one scene with the smoke preset.")
    options = parser.parse_args()
    names, size = scene_names(options.split), "fast"
    if options.quick:
        names, size, options.views, options.out = names[:1], "smoke", 40, Path(tempfile.mkdtemp())
    rows = [measure(name, options.policy, options.views, size, options.out) for name in names]
    fields = list(rows[0])
    print(f"| metric | target | {options.policy} | {options.views} uniform views | true geometry |")
    print("|---|---|---|---|---|")
    means: dict[str, dict[str, float | None]] = {}
    for metric in METRICS:
        target = TARGETS[metric.task][metric.name]
        found = {field: mean_of([row[field] for row in rows], metric.heading) for field in fields}
        shown = [_shown(value, target, metric) for value in found.values()]
        print(f"| {metric.heading} | {target * metric.scale:g} | " + " | ".join(shown) + " |")
        means[f"{metric.task}: {metric.name}"] = found
    print(f"means of {len(names)} scenes, preset {size}; values that miss the target are bold")
    print(json.dumps({"scenes": names, "policy": options.policy, "preset": size, "means": means}))


if __name__ == "__main__":
    main()
