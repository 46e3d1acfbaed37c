"""Losses of the pipeline by stage: exploration, field, evaluator.

In each scene, tasks 1 to 5 are evaluated for fields trained on the trajectory of ``--policy``; for fields trained on
``--views`` images from uniform poses, an upper bound for exploration; and for the true geometry, an upper bound for a
field. The difference between two columns is the loss of a stage. Each of ``--models`` has a table of its own, with its
target values. A model with -rgbd trains on depth, too.

The scores of each field are saved in ``--out`` as soon as they are complete, and trainings continue from their
checkpoints: after an interruption, run the same command again.

    python benchmarks/stages.py                                            # development scenes: twenty trainings
    python benchmarks/stages.py --scenes val
    python benchmarks/stages.py --scenes apartment-101 apartment-102 --columns trajectory  # of these random seeds
    python benchmarks/stages.py --quick

Prints Markdown tables of means over scenes and, as the last line, one JSON object; ``--csv`` gets the scores of each
field.
"""

import argparse
import json
import shutil
import tempfile
from pathlib import Path

from common.output import mean_of, model_settings, saved_result, write_csv
from common.views import TRAIN_SEED, photographs, scene_by_name

from autonerf_lab.benchmark.paper import MAPS, MESH, PLANNING, POSE, RENDERING
from autonerf_lab.evaluators import evaluate, oracle_scores
from autonerf_lab.evaluators.metrics import Metric
from autonerf_lab.exploration import explore
from autonerf_lab.nerf import fit
from autonerf_lab.nerf.models import MODELS
from autonerf_lab.policies import weights_sha256
from autonerf_lab.presets import preset
from autonerf_lab.scenes import scene_names
from autonerf_lab.scenes.library import SPLITS
from autonerf_lab.simulator import Simulator
from autonerf_lab.utils.storage import write_json

COLOR, DEPTH = "semantic-nerfacto", "semantic-nerfacto-rgbd"
COLUMNS = ("trajectory", "uniform views", "true geometry")
_TARGETS = {  # in the stored units
    COLOR: {
        **{"psnr": 29, "ssim": 0.85, "per_class_accuracy": 95, "miou": 90, "depth_median_error_m": 0.022},
        **{"free_accuracy": 92, "free_precision": 95, "free_recall": 90},
        **{"occupancy_precision": 85, "occupancy_recall": 85},
        **{"semantic_precision_5cm": 70, "semantic_recall_5cm": 70},
        **{"pointgoal_success": 90, "pointgoal_spl": 88, "objectgoal_success": 75, "objectgoal_spl": 72},
        **{"convergence_rate": 80, "rotation_error_deg": 0.15, "translation_error_m": 0.004, "accuracy_m": 0.03},
    }
}
_TARGETS[DEPTH] = _TARGETS[COLOR] | {
    **{"psnr": 29.5, "depth_median_error_m": 0.005, "free_accuracy": 97, "pointgoal_success": 95},
    **{"convergence_rate": 88, "rotation_error_deg": 0.12, "translation_error_m": 0.003},
    **{"accuracy_m": 0.012, "completion_m": 0.012, "completion_ratio": 95},
}
METRICS = [metric for metric in (*RENDERING, *MAPS, *PLANNING, *POSE, *MESH) if metric.name in _TARGETS[DEPTH]]
TASKS = tuple(dict.fromkeys(metric.task for metric in METRICS))


def measure(name: str, column: str, model: str, options: argparse.Namespace) -> dict[str, float | None]:
    """Score a field, or the true geometry, in a scene; return saved scores if there are any."""
    identity = {"scene": name, "column": column, "preset": options.preset}
    if column != "true geometry":
        identity |= {"model": model, "settings": model_settings(model, options.preset)}
    if column == "trajectory":
        identity |= {"policy": options.policy, "weights": weights_sha256(options.policy)}
    if column == "uniform views":
        identity["views"] = options.views
    label = f"{name}-{column.split(maxsplit=1)[0]}" + (f"-{model}" if "model" in identity else "")
    path = options.out / f"{label}.json"
    if found := saved_result(path, identity):
        return found["scores"]
    scene, sizes = scene_by_name(name), preset(options.preset)
    if column == "true geometry":
        scores = oracle_scores(scene, sizes, tasks=TASKS)
    else:
        sim = Simulator.from_preset(scene, sizes)
        if column == "trajectory":
            trajectory = explore(sim, options.policy, steps=sizes.episode_steps, seed=0, progress=False)
        else:
            trajectory = photographs(sim, options.views, TRAIN_SEED)
        nerf = fit(trajectory, model, sizes, checkpoint=options.out / label, progress=False)
        scores = evaluate(nerf, scene, sizes, tasks=TASKS, progress=False)
    if failed := sorted({row.status for row in scores if row.status.startswith("failed")}):
        raise SystemExit(f"{label}: {'; '.join(failed)}; run the same command again to continue")
    values = {metric.full_heading: scores[metric.key] for metric in METRICS}
    write_json(path, {"identity": identity, "scores": values})
    shutil.rmtree(options.out / label, ignore_errors=True)  # the checkpoint
    print(f"{label}: PSNR {values[METRICS[0].full_heading]:.2f} dB", flush=True)
    return values


def _shown(value: float | None, target: float | None, metric: Metric) -> str:
    if value is None:
        return "–"
    text = metric.format(value)
    return text if target is None or metric.better * value >= metric.better * target else f"**{text}**"


def print_table(model: str, means: dict[str, dict[str, float | None]]) -> None:
    """Print the means of a model as a Markdown table; values that miss the target of the model are bold."""
    targets = _TARGETS.get(model, {})
    print(f"\n| {model} | target | " + " | ".join(means) + " |")
    print("|---" * (len(means) + 2) + "|")
    for metric in METRICS:
        target = targets.get(metric.name)
        cells = [_shown(column[metric.full_heading], target, metric) for column in means.values()]
        print(
            f"| {metric.full_heading} | {'' if target is None else metric.format(target)} | " + " | ".join(cells) + " |"
        )


def main() -> None:
    """Run the benchmark; print the tables and, as the last line, one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--scenes", nargs="+", default=["dev"], help="Scenes, splits, or apartment-SEED, which is generated."
    )
    parser.add_argument("--models", nargs="+", default=[COLOR, DEPTH], choices=[*MODELS])
    parser.add_argument("--columns", nargs="+", default=[*COLUMNS], choices=COLUMNS)
    parser.add_argument("--policy", default="modular-obs")
    parser.add_argument("--views", type=int, default=600, help="Number of uniform views.")
    parser.add_argument("--out", type=Path, default=Path("runs/stages"), help="Folder of the results and checkpoints.")
    parser.add_argument("--csv", type=Path, help="File of the scores of each field.")
    parser.add_argument("--quick", action="store_true", help="Measure one scene with the smoke preset.")
    options = parser.parse_args()
    options.preset = "fast"
    if options.quick:
        options.scenes, options.preset, options.views, options.out = ["dev-0"], "smoke", 40, Path(tempfile.mkdtemp())
    names = [one for name in options.scenes for one in (scene_names(name) if name in SPLITS else [name])]
    found = {
        name: {
            model: {column: measure(name, column, model, options) for column in options.columns}
            for model in options.models
        }
        for name in names
    }
    if options.csv:
        write_csv(
            options.csv,
            [
                {"scene": name, "model": model, "column": column}
                | {metric.name: found[name][model][column][metric.full_heading] for metric in METRICS}
                for model in options.models
                for column in options.columns
                for name in names
            ],
        )
    means: dict[str, dict[str, dict[str, float | None]]] = {}
    for model in options.models:
        rows = {column: [found[name][model][column] for name in names] for column in options.columns}
        means[model] = {
            column: {metric.full_heading: mean_of(rows[column], metric.full_heading) for metric in METRICS}
            for column in rows
        }
        print_table(model, means[model])
    print(f"means of {len(names)} scenes, preset {options.preset}; values that miss the target are bold")
    print(json.dumps({"scenes": names, "policy": options.policy, "preset": options.preset, "means": means}))


if __name__ == "__main__":
    main()
