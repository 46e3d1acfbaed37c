"""How opaque must a voxel be to count as an obstacle? Measured on training scenes, stated in ``evaluators/maps.py``.

For each scene: a walk, a fit, then the occupancy map at every candidate threshold. The threshold with the best sum of
free accuracy and of the F1 score of occupied cells (5 cm), averaged over the scenes, is the one to state, with the last
lines that are printed: date, model, scenes and table.

Each scene is kept in ``--out`` as soon as it is done, and a fit goes on from its checkpoint: interrupted, the same
command goes on, and another one with more ``--scenes`` measures only those that are new.

    python benchmarks/calibrate_opacity.py [--scenes train-00,train-05] [--policy frontier] [--out DIR] [--quick]
"""

import argparse
import json
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

import autonerf_lab as lab
from autonerf_lab.evaluators import maps
from autonerf_lab.evaluators.ground_truth import true_map
from autonerf_lab.utils import storage

THRESHOLDS = (0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 0.99)
SCENES = ("train-00", "train-04", "train-08", "train-12", "train-16", "train-20")


def scores_of(name: str, preset: str, policy: str, folder: Path) -> list[dict[str, float]]:
    """The map scores of one scene, a row a threshold; those of the folder, if it has them."""
    asked = {"scene": name, "preset": preset, "policy": policy, "model": "semantic-nerfacto"}
    asked["thresholds"] = list(THRESHOLDS)
    kept = folder / f"{name}.json"
    if kept.exists() and (found := storage.read_json(kept)).pop("rows") and found == asked:
        return storage.read_json(kept)["rows"]
    sim, steps = lab.Simulator(lab.load_scene(name)), lab.preset(preset).walk_steps
    # a walk is walked again in seconds, to the same bits; a fit goes on
    walk = lab.explore(sim, policy, steps=steps, seed=0)
    nerf = lab.fit(walk, asked["model"], preset, checkpoint=folder / name)
    truth = true_map(sim)
    rows = []
    for threshold in THRESHOLDS:
        states = maps.predict_states(nerf, truth.grid, threshold)
        values = maps.free_scores(states, truth) | maps.occupancy_scores(states, truth)
        values = {key: 0.0 if value is None else value for key, value in values.items()}
        precision, recall = values["occupancy_precision"], values["occupancy_recall"]
        values["occupancy_f1"] = 2 * precision * recall / max(precision + recall, 1e-9)
        rows.append(values)
    storage.write_json(kept, {**asked, "rows": rows})
    return rows


def main() -> None:
    """Measure what is missing, print the table, and one JSON object as the last line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", default=",".join(SCENES), help="comma list of training scenes")
    parser.add_argument("--policy", default="frontier", help="who walks")
    parser.add_argument("--out", type=Path, default=Path("runs/calibration"), help="where scenes are kept")
    parser.add_argument("--quick", action="store_true", help="one scene, smoke preset: only to see that it runs")
    args = parser.parse_args()
    scenes = ["train-00"] if args.quick else args.scenes.split(",")
    preset = "smoke" if args.quick else "fast"
    table = [scores_of(name, preset, args.policy, args.out / preset) for name in scenes]
    names = list(table[0][0])
    mean = {name: np.array([[row[name] for row in rows] for rows in table]).mean(axis=0) for name in names}
    best = THRESHOLDS[int(np.argmax(mean["free_accuracy"] + mean["occupancy_f1"]))]
    today = datetime.now(UTC).date().isoformat()
    print(f"{best} is best: {today}, semantic-nerfacto, {preset}, walks of {args.policy} in {', '.join(scenes)}")
    print("threshold " + " ".join(f"{name:>20}" for name in names))
    for i, threshold in enumerate(THRESHOLDS):
        print(f"{threshold:9.2f} " + " ".join(f"{mean[name][i]:20.1f}" for name in names))
    means = {name: values.tolist() for name, values in mean.items()}
    print(json.dumps({"threshold": best, "date": today, "scenes": scenes, "thresholds": THRESHOLDS, **means}))


if __name__ == "__main__":
    main()
