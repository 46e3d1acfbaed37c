"""Coverage over steps of the untrained policies: is there something to explore?

``python benchmarks/coverage.py [--plot docs/coverage.png]`` prints the share of the visible
cells after 10, 25, 50 and 100 % of the walk and the area under the curve, the mean over scenes and starts with its
spread over scenes; its last line is one JSON object. ``--quick`` for a look.
"""

import argparse
import json

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from autonerf_lab.evaluators.coverage import QUANTITIES, area_under, coverage, visible_map
from autonerf_lab.exploration import explore
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.scenes import load_scene, scene_names
from autonerf_lab.simulator import Simulator


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--split", default="dev", help="train, dev or val")
    parser.add_argument("--policies", default="random,random-waypoints,frontier", help="comma list")
    parser.add_argument("--steps", type=int, default=1500)
    parser.add_argument("--starts", type=int, default=2, help="seeded starts a scene")
    parser.add_argument("--plot", default=None, help="where to write the figure")
    parser.add_argument("--quick", action="store_true", help="one scene, one start, 300 steps")
    options = parser.parse_args()
    scenes, starts, steps = scene_names(options.split), options.starts, options.steps
    if options.quick:
        scenes, starts, steps = scenes[:1], 1, 300
    policies = options.policies.split(",")
    curves: dict[str, dict[str, list[np.ndarray]]] = {p: {q: [] for q in QUANTITIES.values()} for p in policies}
    for scene in scenes:
        sim = Simulator(load_scene(scene), Intrinsics.from_fov(64, 64), rgb=False)
        visible = visible_map(sim, 200 if options.quick else 2000)
        for policy in policies:
            walks = [explore(sim, policy, steps, seed, progress=False) for seed in range(starts)]
            shares = [coverage(sim, walk, visible) for walk in walks]
            for quantity in QUANTITIES.values():
                curves[policy][quantity].append(np.mean([share[quantity] for share in shares], axis=0))
    print(f"{'policy':<18}{'quantity':<12}{'10 %':>7}{'25 %':>7}{'50 %':>7}{'100 %':>7}{'AUC':>8}   over scenes")
    figures = {}
    marks = [steps // 10 - 1, steps // 4 - 1, steps // 2 - 1, steps - 1]
    for policy in policies:
        for quantity, rows in curves[policy].items():
            mean, areas = np.mean(rows, axis=0), [area_under(row) for row in rows]
            values = "".join(f"{mean[k]:>7.1f}" for k in marks)
            print(f"{policy:<18}{quantity:<12}{values}{np.mean(areas):>8.1f}   {min(areas):.1f} to {max(areas):.1f}")
            figures[f"{policy}_{quantity}_auc"] = round(float(np.mean(areas)), 2)
    if options.plot:
        draw(curves, options.plot, f"{len(scenes)} {options.split} scenes, {starts} starts each")
    print(json.dumps(figures))


def draw(curves: dict[str, dict[str, list[np.ndarray]]], path: str, title: str) -> None:
    """One panel a quantity, a line a policy, the band from the worst to the best scene."""
    fig, axes = plt.subplots(1, len(QUANTITIES), figsize=(13, 3.4), sharey=True, layout="constrained")
    for ax, quantity in zip(axes, QUANTITIES.values(), strict=True):
        for policy, by_quantity in curves.items():
            rows = np.array(by_quantity[quantity])
            (line,) = ax.plot(rows.mean(axis=0), label=policy)
            ax.fill_between(np.arange(rows.shape[1]), rows.min(0), rows.max(0), color=line.get_color(), alpha=0.15)
        ax.set(title=quantity, xlabel="step", xlim=(0, rows.shape[1]), ylim=(0, 100))
        ax.grid(alpha=0.3)
    axes[0].set_ylabel("share of what is visible [%]")
    axes[0].legend(frameon=False, loc="lower right")
    fig.suptitle(title)
    fig.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
