"""Fields of the three models: quality over training time, and the surfaces at the end.

Trains each of ``--models`` on a trajectory of ``--policy``, with images of the preset ``fast`` and the settings of
``--preset``. Held-out views are rendered and scored after 100, 200, 500, 1000, … steps. This time is not counted in the
figure and the CSV, but it is counted by ``--seconds``: such a training ends earlier on the axis of the figure. The
trained field is scored in the tasks rendering, maps and mesh. The settings of ``paper`` are made for a GPU. An
interrupted training continues from its checkpoint.

    python benchmarks/long_trainings.py  # preset fast, minutes
    python benchmarks/long_trainings.py --preset paper --device cuda --seconds 1200  # in the same figures
    python benchmarks/long_trainings.py --quick

Prints a table of all trainings in ``--out`` with the same scene, policy and number of views, and, as the last line, one
JSON object; ``--out`` also gets a CSV with all measured moments, a figure of them, and one of the surfaces.
"""

import argparse
import json
import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from common.output import model_settings, saved_result, slug, write_csv
from common.training import in_training
from common.views import TEST_SEED, photographs, scene_by_name
from PIL import Image

from autonerf_lab.benchmark.paper import MAPS, MESH, RENDERING
from autonerf_lab.data.dataset import Dataset
from autonerf_lab.evaluators import evaluate
from autonerf_lab.evaluators.rendering import evaluate_rendering, photographed_views
from autonerf_lab.exploration import explore
from autonerf_lab.nerf import fit
from autonerf_lab.nerf.model import Model
from autonerf_lab.nerf.models import MODELS
from autonerf_lab.policies import weights_sha256
from autonerf_lab.presets import PRESETS
from autonerf_lab.simulator import Simulator
from autonerf_lab.utils.storage import read_json, write_json
from autonerf_lab.viz.figures.evaluation import bird_view

MARKS = tuple(m * 10**k for k in range(2, 7) for m in (1, 2, 5))  # steps at which views are rendered
PANELS = {"psnr": "PSNR [dB]", "depth_median_error_m": "median depth error [m]"}
TASKS = ("rendering", "maps", "mesh")
METRICS = [metric for metric in (*RENDERING, *MAPS, *MESH) if metric.name != "lpips"]


class Record:
    """Callback of ``fit`` that scores the model at :data:`MARKS`, in a file that a resumed training continues.

    Args:
        path: JSON file of the rows: step, seconds of training, scores.
        score: called with the model at each mark; its duration is not counted.
    """

    def __init__(self, path: Path, score: Callable[[Model], dict[str, Any]]) -> None:
        self.path, self._score = path, score
        self.rows: list[dict[str, Any]] = read_json(path, list[dict[str, Any]]) if path.exists() else []
        self._started: float | None = None

    def __call__(self, step: int, model: Model) -> None:
        """Score the model if the step is a mark."""
        arrived = time.perf_counter()
        if self._started is None:  # the steps before an interruption took as long as those before the last mark
            self.rows = [row for row in self.rows if row["step"] < step]
            before = self.rows[-1]["seconds"] * step / self.rows[-1]["step"] if self.rows else 0.0
            self._started = arrived - before
        if step in MARKS:
            self.rows.append({"step": step, "seconds": arrived - self._started, **self._score(model)})
            write_json(self.path, self.rows)
            self._started += time.perf_counter() - arrived


def shared_identity(options: argparse.Namespace) -> dict[str, Any]:
    """Return the part of the identity that all trainings of a table share."""
    identity = {"scene": options.scene, "policy": options.policy, "weights": weights_sha256(options.policy)}
    return identity | {"sizes": "smoke" if options.quick else "fast", "views": options.views}


def train(model: str, options: argparse.Namespace) -> None:
    """Train a model and save its scores and a picture of its surface, if they are not there."""
    identity = shared_identity(options) | {"settings": model_settings(model, options.preset)}
    identity |= {"device": options.device, "seconds": options.seconds}
    folder = options.out / slug(f"{options.scene} {options.policy} {model} {options.preset} {options.device or ''}")
    path = folder / "result.json"
    if saved_result(path, identity):
        return
    scene, sizes = scene_by_name(options.scene), PRESETS[identity["sizes"]]
    sim = Simulator.from_preset(scene, sizes)
    trajectory = explore(sim, options.policy, steps=sizes.episode_steps, seed=0, progress=False)
    test_views = Dataset.from_trajectory(photographs(sim, options.views, TEST_SEED))

    def score(model: Model) -> dict[str, Any]:
        values = evaluate_rendering(in_training(model, trajectory), photographed_views(test_views)).values
        return {key: value for key, value in values.items() if key != "lpips"}

    record = Record(folder / "rows.json", score)
    nerf = fit(
        trajectory, model, options.preset, seconds=options.seconds, device=options.device,
        checkpoint=folder / "training", progress=False, callback=record,
    )  # fmt: skip
    scores = evaluate(nerf, scene, sizes, tasks=TASKS, progress=False)
    result = {"identity": identity, "label": f"{model}, {options.preset}", "steps": nerf.meta["steps"]}
    result |= {"rows": record.rows, "scores": {metric.full_heading: scores[metric.key] for metric in METRICS}}
    Image.fromarray(bird_view(scores.artifacts["mesh"]["mesh"])).save(folder / "mesh.png")
    write_json(path, result)
    shutil.rmtree(folder / "training", ignore_errors=True)  # the checkpoint
    print(f"{result['label']}: {result['steps']} steps", flush=True)


def comparable(out: Path, shared: dict[str, Any]) -> dict[Path, dict[str, Any]]:
    """Return the results in a folder whose identity has these values, by their folders."""
    results = {path.parent: read_json(path, dict[str, Any]) for path in sorted(out.glob("*/result.json"))}
    return {  # the first results did not store the number of views
        folder: result
        for folder, result in results.items()
        if all(result["identity"].get(key, value) == value for key, value in shared.items())
    }


def draw(found: dict[Path, dict[str, Any]], out: Path) -> None:
    """Draw the scores over seconds of training, and the surfaces of the trained fields, by their folders."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, len(PANELS), figsize=(11, 4), layout="constrained")
    for ax, (key, name) in zip(axes, PANELS.items(), strict=True):
        for result in found.values():
            style = "o--" if result["label"].endswith("fast") else "o-"
            ax.plot(*zip(*((r["seconds"], r[key]) for r in result["rows"]), strict=True), style, ms=3,
                    label=_described(result))  # fmt: skip
        ax.set(xscale="log", xlabel="seconds of training", ylabel=name)
        ax.grid(alpha=0.3)
    axes[1].set(yscale="log")
    axes[0].legend(frameon=False, fontsize=8)
    figure.savefig(out / "long_trainings.png", dpi=110)
    plt.close(figure)
    rows = (len(found) + 1) // 2
    figure, axes = plt.subplots(rows, 2, figsize=(11, 4.2 * rows), layout="constrained", squeeze=False)
    for ax in axes.flat:
        ax.axis("off")
    for ax, (folder, result) in zip(axes.flat, found.items(), strict=False):
        ax.imshow(plt.imread(folder / "mesh.png"))
        ax.set_title(f"{_described(result)}, {result['steps']} steps", fontsize=10)
    figure.savefig(out / "long_trainings_meshes.png", dpi=90)


def _described(result: dict[str, Any]) -> str:
    return f"{result['label']}, {result['identity']['device'] or 'CPU'}"


def main() -> None:
    """Train the models; print the table and, as the last line, one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--models", nargs="+", choices=MODELS, help="Default: the three of the paper.",
                        default=["semantic-nerfacto", "instant-ngp", "semantic-nerf"])  # fmt: skip
    parser.add_argument("--preset", default="fast", choices=PRESETS, help="Settings of the models.")
    parser.add_argument("--scene", default="dev-0")
    parser.add_argument("--policy", default="modular-obs")
    parser.add_argument("--device", help="Torch device; default: compiled kernels on the CPU.")
    parser.add_argument("--seconds", type=float, help="Duration instead of steps; counts the rendering.")
    parser.add_argument("--views", type=int, default=60, help="Number of held-out views at each moment.")
    parser.add_argument("--out", type=Path, default=Path("runs/long"), help="Folder of results and checkpoints.")
    parser.add_argument("--quick", action="store_true", help="The preset smoke.")
    options = parser.parse_args()
    if options.quick:
        options.preset, options.views, options.out = "smoke", 8, Path(tempfile.mkdtemp())
    torch.set_float32_matmul_precision("high")  # matrix products of a GPU in TF32
    for model in options.models:
        train(model, options)
    folders = comparable(options.out, shared_identity(options))
    draw(folders, options.out)
    found = [*folders.values()]
    write_csv(options.out / "long_trainings.csv", [{"field": _described(f), **row} for f in found for row in f["rows"]])
    print(f"\n| {options.scene}, {options.policy} | " + " | ".join(map(_described, found)) + " |")
    print("|---" * (len(found) + 1) + "|")
    print("| steps | " + " | ".join(str(result["steps"]) for result in found) + " |")
    for metric in METRICS:
        values = [result["scores"][metric.full_heading] for result in found]
        cells = ["–" if value is None else metric.format(value) for value in values]
        print(f"| {metric.full_heading} | " + " | ".join(cells) + " |")
    print(json.dumps({_described(result): {"steps": result["steps"], **result["scores"]} for result in found}))


if __name__ == "__main__":
    main()
