"""Calibration of the opacity threshold above which a voxel counts as an obstacle, on training scenes.

For each scene, the script records a trajectory, trains a field and computes the occupancy map at every candidate
threshold. The best threshold has the largest sum of free accuracy and F1 score of occupied cells (5 cm), averaged over
the scenes. Copy it to ``evaluators/maps.py``, with the last printed lines: date, model, scenes and table.

The result of each scene is saved in ``--out`` as soon as it is complete, and a training continues from its checkpoint:
after an interruption, run the same command again. With more ``--scenes``, only the new ones are measured.

    python benchmarks/calibrate_opacity.py [--scenes train-00 train-05] [--policy frontier] [--out DIR] [--quick]
"""

import argparse
import json
import shutil
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from common.output import model_settings, saved_result

import autonerf_lab as lab
from autonerf_lab.evaluators import maps
from autonerf_lab.evaluators.ground_truth import true_map
from autonerf_lab.utils.storage import write_json

THRESHOLDS = (0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 0.99)
MODEL = "semantic-nerfacto"
SCENES = ("train-00", "train-04", "train-08", "train-12", "train-16", "train-20")


def scores_of(name: str, preset: str, policy: str, folder: Path) -> list[dict[str, float]]:
    """Compute the map scores of one scene, one row per threshold; return saved scores if there are any."""
    identity: dict[str, Any] = {"scene": name, "preset": preset, "policy": policy, "model": MODEL}
    identity |= {"thresholds": THRESHOLDS, "settings": model_settings(MODEL, preset)}
    path = folder / f"{name}.json"
    if found := saved_result(path, identity):
        return found["rows"]
    sim, steps = lab.Simulator(lab.load_scene(name)), lab.preset(preset).episode_steps
    # the trajectory is recorded again, with the same bits; the training continues from its checkpoint
    trajectory = lab.explore(sim, policy, steps=steps, seed=0)
    nerf = lab.fit(trajectory, MODEL, preset, checkpoint=folder / name)
    truth = true_map(sim)
    rows = []
    for threshold in THRESHOLDS:
        states = maps.predict_states(nerf, truth.grid, threshold)
        scores = maps.free_scores(states, truth) | maps.occupancy_scores(states, truth)
        values = {key: 0.0 if value is None else value for key, value in scores.items()}
        precision, recall = values["occupancy_precision"], values["occupancy_recall"]
        values["occupancy_f1"] = 2 * precision * recall / max(precision + recall, 1e-9)
        rows.append(values)
    write_json(path, {"identity": identity, "rows": rows})
    shutil.rmtree(folder / name, ignore_errors=True)  # the checkpoint
    return rows


def main() -> None:
    """Run the calibration; print the table and, as the last line, one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", nargs="+", default=SCENES, help="Training scenes.")
    parser.add_argument("--policy", default="frontier", help="Exploration policy.")
    parser.add_argument("--out", type=Path, default=Path("runs/calibration"), help="Folder of results and checkpoints.")
    parser.add_argument("--quick", action="store_true", help="Measure one scene with the smoke preset.")
    args = parser.parse_args()
    scenes = ["train-00"] if args.quick else args.scenes
    preset = "smoke" if args.quick else "fast"
    table = [scores_of(name, preset, args.policy, args.out / preset) for name in scenes]
    names = list(table[0][0])
    mean = {name: np.array([[row[name] for row in rows] for rows in table]).mean(axis=0) for name in names}
    best = THRESHOLDS[int(np.argmax(mean["free_accuracy"] + mean["occupancy_f1"]))]
    today = datetime.now(UTC).date().isoformat()
    print(f"best threshold {best}: {today}, {MODEL}, {preset}, trajectories of {args.policy} in {', '.join(scenes)}")
    print("threshold " + " ".join(f"{name:>20}" for name in names))
    for i, threshold in enumerate(THRESHOLDS):
        print(f"{threshold:9.2f} " + " ".join(f"{mean[name][i]:20.1f}" for name in names))
    means = {name: values.tolist() for name, values in mean.items()}
    print(json.dumps({"threshold": best, "date": today, "scenes": scenes, "thresholds": THRESHOLDS, **means}))


if __name__ == "__main__":
    main()
