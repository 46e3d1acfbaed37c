"""How opaque must a voxel be to count as an obstacle? Measured on training scenes, stated in ``evaluators/maps.py``.

For each scene: a frontier walk, a fit, then the occupancy map at every candidate threshold. The threshold with the best
sum of free accuracy and of the F1 score of occupied cells (5 cm), averaged over the scenes, is the one to state.

    python benchmarks/calibrate_opacity.py [--scenes train-00,train-05] [--quick]
"""

import argparse
import json

import numpy as np

import autonerf_lab as lab
from autonerf_lab.evaluators import maps
from autonerf_lab.evaluators.truth import true_map

THRESHOLDS = (0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 0.99)


def scores_of(name: str, preset: str) -> list[dict[str, float]]:
    """The map scores of one scene, a row a threshold."""
    scene = lab.load_scene(name)
    sim = lab.Simulator(scene)
    nerf = lab.fit(lab.explore(sim, "frontier", steps=lab.preset(preset).walk_steps, seed=0), preset=preset)
    truth = true_map(sim)
    rows = []
    for threshold in THRESHOLDS:
        states = maps.predict_states(nerf, truth.grid, threshold)
        values = maps.free_scores(states, truth) | maps.occupancy_scores(states, truth)
        values = {key: 0.0 if value is None else value for key, value in values.items()}
        precision, recall = values["occupancy_precision"], values["occupancy_recall"]
        values["occupancy_f1"] = 2 * precision * recall / max(precision + recall, 1e-9)
        rows.append(values)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", default="train-00,train-05")
    parser.add_argument("--quick", action="store_true", help="one scene, smoke preset: only to see that it runs")
    args = parser.parse_args()
    scenes = ["train-00"] if args.quick else args.scenes.split(",")
    table = [scores_of(name, "smoke" if args.quick else "fast") for name in scenes]
    names = list(table[0][0])
    mean = {name: np.array([[row[name] for row in rows] for rows in table]).mean(axis=0) for name in names}
    print("threshold " + " ".join(f"{name:>20}" for name in names))
    for i, threshold in enumerate(THRESHOLDS):
        print(f"{threshold:9.2f} " + " ".join(f"{mean[name][i]:20.1f}" for name in names))
    best = THRESHOLDS[int(np.argmax(mean["free_accuracy"] + mean["occupancy_f1"]))]
    print(json.dumps({"threshold": best, "scenes": scenes, **{name: mean[name].tolist() for name in names}}))


if __name__ == "__main__":
    main()
