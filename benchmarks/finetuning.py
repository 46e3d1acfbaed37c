"""Fine-tuning of the PointGoal policy in reconstructions and in true scenes, with several learning rates.

    python benchmarks/finetuning.py                 # two development scenes, three rates: about four hours on one core
    python benchmarks/finetuning.py --scenes val-0 val-1 val-2 val-3 --rates 1e-4
    python benchmarks/finetuning.py --quick         # one scene, a few frames

In each scene, a field is trained on a trajectory of ``--policy``. The pre-trained policy is fine-tuned in the mesh of
the field, and, as an upper bound, in the true scene (``autonerf_lab.evaluators.finetuning``). All policies run the same
episodes in the true scene. Trainings and results are saved under ``--out``; an interrupted run continues there.

Prints a table and, as the last line, one JSON object.
"""

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

from common.output import mean_of, model_settings, saved_result

from autonerf_lab.evaluators.context import EvaluationContext
from autonerf_lab.evaluators.finetuning import PRETRAINED, evaluate_finetuning
from autonerf_lab.evaluators.metrics import FINETUNING_STAGES
from autonerf_lab.exploration import explore
from autonerf_lab.nerf import fit, load_nerf
from autonerf_lab.policies import weights_sha256
from autonerf_lab.presets import preset
from autonerf_lab.scenes import load_scene
from autonerf_lab.simulator import Simulator
from autonerf_lab.utils.storage import read_json, write_json

MODEL = "semantic-nerfacto"
TUNED = [stage for stage in FINETUNING_STAGES if stage != "pretrained"]


def measure(name: str, rate: float, options: argparse.Namespace) -> dict[str, Any]:
    """Return success, SPL and hours of the policies in a scene; saved results if there are any."""
    field: dict[str, Any] = {"policy": options.policy, "weights": weights_sha256(options.policy)}
    field |= {"preset": options.preset, "settings": model_settings(MODEL, options.preset)}
    identity = {"scene": name, "rate": rate, "frames": options.frames, "episodes": options.episodes, "field": field}
    identity["pretrained"] = weights_sha256(str(PRETRAINED))
    folder = options.out / name
    path = folder / f"{rate:g}.json"
    if found := saved_result(path, identity):
        return found
    scene, sizes = load_scene(name), preset(options.preset)
    made = folder / "field.json"
    if not made.exists() or read_json(made, dict[str, Any]) != field:
        sim = Simulator.from_preset(scene, sizes)
        trajectory = explore(sim, options.policy, steps=sizes.episode_steps, seed=0, progress=False)
        fit(trajectory, MODEL, sizes, checkpoint=folder / "field", progress=False).save(folder / "field")
        write_json(made, field)
    mesh = EvaluationContext(load_nerf(folder / "field"), scene, sizes, 0).surface_with_floor
    result = evaluate_finetuning(
        mesh, scene, options.frames, options.episodes, 0, folder / "trainings", dict.fromkeys(TUNED, rate)
    )
    row = {"identity": identity, "scores": result.values, "details": result.details}
    print(f"{name} {rate:g}: {result.values} {result.status}", flush=True)
    if not result.status:
        write_json(path, row)
    return row


def print_table(found: dict[str, dict[str, dict[str, Any]]]) -> None:
    """Print success rates and SPL of every scene and rate, and their means, as a Markdown table."""
    headings = [f"{title}: {score}" for title in FINETUNING_STAGES.values() for score in ("success", "SPL")]
    print("| learning rate | scene | " + " | ".join(headings) + " |")
    print("|---" * (len(headings) + 2) + "|")
    names = [f"{score}_{stage}" for stage in FINETUNING_STAGES for score in ("success", "spl")]
    for rate, rows in found.items():
        scores = {scene: row["scores"] for scene, row in rows.items()}
        scores["mean"] = {name: mean_of([row["scores"] for row in rows.values()], name) for name in names}
        for scene, values in scores.items():
            cells = ["–" if values[name] is None else f"{values[name]:.1f}" for name in names]
            print(f"| {rate} | {scene} | " + " | ".join(cells) + " |")


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", nargs="+", default=["dev-0", "dev-1"], help="Names of scenes.")
    parser.add_argument("--rates", nargs="+", type=float, default=[2.5e-6, 2.5e-5, 1e-4], help="Learning rates.")
    parser.add_argument("--frames", type=int, default=preset("fast").finetuning_frames, help="Frames of a training.")
    parser.add_argument("--episodes", type=int, default=200, help="Episodes of each policy in the true scene.")
    parser.add_argument("--policy", default="modular-obs", help="Policy of the trajectory.")
    parser.add_argument("--out", type=Path, default=Path("runs/finetuning"), help="Folder of results and trainings.")
    parser.add_argument("--quick", action="store_true", help="One scene, one rate, a few frames.")
    options = parser.parse_args()
    options.preset = "fast"
    if options.quick:
        options.scenes, options.rates, options.frames, options.episodes = ["dev-0"], [1e-4], 4096, 10
        options.policy, options.preset, options.out = "frontier", "smoke", Path(tempfile.mkdtemp())
    found: dict[str, dict[str, dict[str, Any]]] = {f"{rate:g}": {} for rate in options.rates}
    for name in options.scenes:
        for rate in options.rates:
            found[f"{rate:g}"][name] = measure(name, rate, options)
    print_table(found)
    print(json.dumps({rate: {name: row["scores"] for name, row in rows.items()} for rate, rows in found.items()}))


if __name__ == "__main__":
    main()
