"""Ladder of pose estimates: errors of the poses of noisy trajectories, and what they cost the field.

In each scene a policy acts on its own estimate (``poses="estimated"``), with noise of motion, odometry and depth. The
poses of the recorded trajectory are then those by odometry, of each estimator, and of bundle adjustment: from the pose
graph (``refined``), from calibrated odometry, and from the pose graph by colour alone, which trains a field.
``--fields`` trains a field with the true, measured, estimated and refined poses and scores it; its frame is aligned
with the scene first. Values are means over scenes with 95 % intervals.
``--quick`` takes one scene and 300 steps.

Run: python benchmarks/localization.py [--quick] [--fields] [--scenes dev-0 dev-1] [--noise ans] [--out DIR]
"""

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from common.output import write_csv

import autonerf_lab as lab
from autonerf_lab.benchmark.statistics import interval
from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.evaluators import METRICS
from autonerf_lab.localization import ESTIMATORS
from autonerf_lab.localization.se2 import to_planar
from autonerf_lab.localization.trajectory_alignment import trajectory_errors
from autonerf_lab.scenes import scene_names
from autonerf_lab.simulator.motion_noise import motion_noise

ERRORS = {"ate_m": 100, "ate_unaligned_m": 100, "heading_error_deg": 1, "error_per_metre": 100, "error_per_degree": 100}
SCORES = (
    ("rendering", "psnr"), ("rendering", "miou"), ("maps", "free_accuracy"), ("planning", "pointgoal_success"),
    ("pose_refinement", "convergence_rate"), ("mesh", "completion_ratio_all"),
)  # fmt: skip


def ladder(recorded: Trajectory, size: str) -> dict[str, tuple[Trajectory, float]]:
    """Return the trajectory with each estimate of its poses, and the seconds that each took; ``size``: of the field."""
    found = {"odometry": (recorded.with_poses("odometry"), 0.0)}
    for name in ESTIMATORS:
        start = time.process_time()
        found[name] = lab.estimate_poses(recorded, name), time.process_time() - start
    graph, calibrated = found["pose-graph"][0], found["calibrated"][0]
    refinements = {
        "refined": graph,
        "refined from calibrated": calibrated,
        "refined by colour alone": replace(graph, depth=None),
    }
    for name, rough in refinements.items():
        start = time.process_time()
        found[name] = lab.refine_poses(rough, preset=size, progress=False), time.process_time() - start
    return found


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="One scene, 300 steps, preset smoke for the fields.")
    parser.add_argument("--fields", action="store_true", help="Train and score fields (four per scene).")
    parser.add_argument("--scenes", nargs="+", default=scene_names("dev"), help="Names of scenes.")
    parser.add_argument("--policy", default="modular-obs", help="Policy.")
    parser.add_argument("--noise", default="ans", help="Noise of motion and odometry.")
    parser.add_argument("--noise-scale", type=float, default=1.0, help="Its factor.")
    parser.add_argument("--model", default="semantic-nerfacto", help="Model of the fields.")
    parser.add_argument("--out", type=Path, default=None, help="Folder for the rows as CSV.")
    options = parser.parse_args()
    scenes, steps, size = (options.scenes[:1], 300, "smoke") if options.quick else (options.scenes, 1500, "fast")
    rows: list[dict[str, Any]] = []
    for name in scenes:
        scene = lab.load_scene(name)
        noise = motion_noise(options.noise, options.noise_scale)
        sim = lab.Simulator(scene, noise=noise, depth_noise="redwood")
        recorded = lab.explore(sim, options.policy, steps=steps, seed=0, poses="estimated", progress=False)
        true = recorded.with_poses("true")
        estimates = ladder(recorded, size)
        for estimate, (trajectory, seconds) in estimates.items():
            found = trajectory_errors(to_planar(trajectory.poses), to_planar(true.poses))
            errors = {key: factor * getattr(found, key) for key, factor in ERRORS.items()}
            rows.append({"scene": name, "poses": estimate, **errors, "cpu_ms_per_step": 1000 * seconds / steps})
            print(name, estimate, {key: round(value, 3) for key, value in errors.items()}, flush=True)
        fields = {"true": true} | {k: estimates[k][0] for k in ("odometry", "pose-graph", "refined")}
        for estimate, trajectory in fields.items() if options.fields else ():
            nerf = lab.fit(trajectory, options.model, preset=size, progress=False)
            tasks = list(dict.fromkeys(task for task, _ in SCORES))
            scores = lab.evaluate(nerf, scene, size, tasks=tasks, progress=False, oracle=False)
            values = {f"{task}: {metric}": scores[task, metric] for task, metric in SCORES}
            rows.append({"scene": name, "poses": f"field, {estimate}", **values})
            print(name, estimate, values, flush=True)
    report(rows, options)


def report(rows: list[dict[str, Any]], options: argparse.Namespace) -> None:
    """Print the tables of pose errors and of scores, write the rows, and print them as JSON."""
    for start in ("", "field, "):
        names = [n for n in dict.fromkeys(row["poses"] for row in rows) if n.startswith("field, ") == bool(start)]
        if not names:
            continue
        keys = [key for key in next(row for row in rows if row["poses"] == names[0]) if key not in ("scene", "poses")]
        print(f"\n| poses | {' | '.join(_heading(key) for key in keys)} |\n|---{'|---' * len(keys)}|")
        for name in names:
            found = [row for row in rows if row["poses"] == name]
            texts = []
            for key in keys:
                values = {row["scene"]: [row[key]] for row in found if row[key] is not None and np.isfinite(row[key])}
                texts.append(_text(values) if values else "–")
            print(f"| {name.removeprefix(start)} | {' | '.join(texts)} |")
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
        columns = dict.fromkeys(key for row in rows for key in row)
        write_csv(options.out / "localization.csv", [{key: row.get(key) for key in columns} for row in rows])
    print(json.dumps(rows))


def _heading(key: str) -> str:
    task, _, metric = key.partition(": ")
    return METRICS[task, metric].heading if metric else key.replace("_m", "_cm", 1) if "ate" in key else key


def _text(values: dict[str, list[float]]) -> str:
    found = interval(values)
    return f"{found.mean:.2f}" if found.scenes == 1 else f"{found.mean:.2f} ± {found.half_width:.2f}"


if __name__ == "__main__":
    main()
