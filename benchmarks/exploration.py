"""Exploration benchmark: coverage of the map and speed of every policy.

    python benchmarks/exploration.py                          # development scenes, 2 starts: about an hour
    python benchmarks/exploration.py --split val --starts 5 --plot docs/coverage.png
    python benchmarks/exploration.py --policies frontier,modular-obs --no-speed
    python benchmarks/exploration.py --quick

Coverage: share of the visible quantity after 10, 25, 50 and 100 % of the steps, and the area under the curve; means
over scenes with 95 % intervals (Student's t on scene means). Each learned policy is compared with its baselines, paired
by scene and start, by the area under the curve of the quantity it was trained for. Baselines are its own untrained
network, and frontier and random waypoints for policies with waypoints, random actions for the others. Curiosity,
novelty and reconstruction are compared by explored area. References are greedy oracles with ground truth
(``oracle-cov`` etc., one per quantity). Each rollout is saved as a JSON file under ``--cells``; an interrupted run
resumes there, and changed weights are evaluated again.

Speed: duration of a recorded episode (128 x 128, supersampled), and training steps per second with 1 and 2 workers,
learning included; the functions that take the time of a training environment. ``--quick`` trains with 2 workers, fewer
environments and shorter rollouts.

Prints tables and, as the last line, one JSON object.
"""

import argparse
import cProfile
import json
import pstats
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import torch
from common.output import saved_result, write_csv
from common.training import in_fresh_process, set_threads

from autonerf_lab.benchmark.statistics import Interval, Runs, difference, interval
from autonerf_lab.evaluators.coverage import QUANTITIES, area_under, coverage
from autonerf_lab.evaluators.exploration import SENSOR, cached_visible_map
from autonerf_lab.exploration import explore
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.policies import POLICIES, Policy, load_policy, make_policy, weights_path, weights_sha256
from autonerf_lab.policies.spec import make_interface
from autonerf_lab.presets import preset
from autonerf_lab.scenes import load_scene, scene_names
from autonerf_lab.simulator import Simulator
from autonerf_lab.types import MapState
from autonerf_lab.utils.storage import write_json

UNTRAINED = "untrained "
TRAINED_FOR = {"cov": "area", "obs": "obstacles", "sem": "semantics", "view": "viewpoints"}
STRIDE = 5  # steps between two points of a saved curve


def main() -> None:
    """Run the rollouts and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--split", default="dev", choices=["train", "dev", "val"])
    parser.add_argument(
        "--policies", default=None, help="Policies, separated by commas. Default: all, with untrained and oracles."
    )
    parser.add_argument("--steps", type=int, default=1500, help="Actions per episode.")
    parser.add_argument("--starts", type=int, default=2, help="Start poses per scene.")
    parser.add_argument("--workers", type=int, default=2, help="Number of worker processes.")
    parser.add_argument("--cells", type=Path, default=Path("runs/exploration"), help="Folder of the saved rollouts.")
    parser.add_argument("--plot", default=None, help="File of the figure.")
    parser.add_argument("--keep", type=Path, default=None, help="CSV file of the areas of each rollout.")
    parser.add_argument("--no-speed", action="store_true", help="Skip the speed measurements.")
    parser.add_argument("--quick", action="store_true", help="One scene, two policies, 200 steps, as a test.")
    options = parser.parse_args()
    learned = [name for name in POLICIES if weights_path(name).exists()]
    policies = [*POLICIES, *(UNTRAINED + name for name in learned)]
    scenes = scene_names(options.split)
    if options.policies:
        policies = options.policies.split(",")
    if options.quick:
        scenes, policies, options.steps, options.starts = scenes[:1], ["random", "frontier"], 200, 1
        options.cells = Path(tempfile.mkdtemp())
    for name in policies:
        make(name)  # an unknown name fails here
    curves = run_all(policies, scenes, options.starts, options.steps, options.cells, options.workers)
    print_curves(curves, options.steps)
    print_differences(curves)
    if options.keep:
        write_csv(options.keep, area_rows(curves))
    if options.plot:
        draw(curves, options.plot, f"{len(scenes)} {options.split} scenes, {options.starts} starts each")
    figures = dict.fromkeys(("modular_steps_per_s", "e2e_steps_per_s", "episode_s"))
    if not options.no_speed:
        figures |= speed(options.quick)
    areas = {f"{p} {q} auc": interval(areas_of(by[q])).mean for p, by in curves.items() for q in by}
    print(json.dumps({k: v if v is None else round(v, 2) for k, v in (figures | areas).items()}))


Curves = dict[
    str, dict[str, dict[str, list[np.ndarray]]]
]  # policy -> quantity -> scene -> curve of each start, percent


def run_all(policies: list[str], scenes: list[str], starts: int, steps: int, cells: Path, workers: int) -> Curves:
    """Evaluate every policy in every scene, in processes of one thread each."""
    curves: Curves = {p: {q: {s: [] for s in scenes} for q in QUANTITIES.values()} for p in policies}
    jobs = [
        (policy, scene, start, steps, str(cells)) for scene in scenes for policy in policies for start in range(starts)
    ]
    with ProcessPoolExecutor(workers, get_context("spawn"), set_threads, (1,)) as pool:
        for job, cell in zip(jobs, pool.map(run_one, *zip(*jobs, strict=True)), strict=True):
            for quantity, curve in cell["curves"].items():
                curves[job[0]][quantity][job[1]].append(np.array(curve))
    return curves


def run_one(policy: str, scene: str, start: int, steps: int, cells: str) -> dict[str, Any]:
    """Run one episode and compute its curves at every fifth step, or read the saved result."""
    path = Path(cells) / policy.replace(" ", "-").replace("/", "-") / f"{scene}-{start}-{steps}.json"
    fingerprint = {"policy": policy, "scene": scene, "start": start, "steps": steps, "weights": hash_of(policy)}
    if saved := saved_result(path, fingerprint):
        return saved
    sim, visible = scene_with_visible_map(scene, cells)
    trajectory = explore(sim, make(policy), steps, start, progress=False)
    shares = {
        name: curve[STRIDE - 1 :: STRIDE].round(3).tolist()
        for name, curve in coverage(sim, trajectory, visible).items()
    }
    cell = {"identity": fingerprint, "curves": shares, "collisions": int(sum(trajectory.meta["collided"]))}
    write_json(path, cell)
    print(
        f"{scene} {start} {policy:<24}" + "".join(f"{area_under(np.array(c)):7.1f}" for c in shares.values()),
        flush=True,
    )
    return cell


@cache
def scene_with_visible_map(scene: str, cells: str) -> tuple[Simulator, MapState]:
    """Return the simulator of a scene and the map of everything visible in it."""
    sim = Simulator(load_scene(scene), Intrinsics.from_fov(SENSOR, SENSOR), supersample=1)
    return sim, cached_visible_map(sim, preset("fast").visible_poses, Path(cells) / "scenes")


def make(policy: str) -> Policy:
    """Make a policy by name or path; the prefix ``untrained`` gives its network before training."""
    torch.manual_seed(0)
    if policy.startswith(UNTRAINED):
        return load_policy(weights_path(policy.removeprefix(UNTRAINED)), trained=False)
    return make_policy(policy)


def hash_of(policy: str) -> str | None:
    """Return the first digits of the hash of a policy's weights."""
    digest = weights_sha256(policy.removeprefix(UNTRAINED))
    return digest and digest[:16]


def areas_of(by_scene: dict[str, list[np.ndarray]]) -> Runs:
    """Compute the area under each curve."""
    return {scene: [area_under(curve) for curve in curves] for scene, curves in by_scene.items()}


def area_rows(curves: Curves) -> list[dict[str, Any]]:
    """Return the areas under the curves of every rollout, a row each."""
    return [
        {"policy": policy, "scene": scene, "start": start}
        | {quantity: area_under(runs[scene][start]) for quantity, runs in by_quantity.items()}
        for policy, by_quantity in curves.items()
        for scene, starts in next(iter(by_quantity.values())).items()
        for start in range(len(starts))
    ]


def print_curves(curves: Curves, steps: int) -> None:
    """Print a row per policy and quantity."""
    print(f"\n{'policy':<24}{'quantity':<12}{'10 %':>7}{'25 %':>7}{'50 %':>7}{'100 %':>7}   area under the curve")
    marks = [round(share * steps / STRIDE) - 1 for share in (0.1, 0.25, 0.5, 1)]
    for policy, by_quantity in curves.items():
        for quantity, by_scene in by_quantity.items():
            mean = np.mean([np.mean(rows, axis=0) for rows in by_scene.values()], axis=0)
            values = "".join(f"{mean[k]:7.1f}" for k in marks)
            print(f"{policy:<24}{quantity:<12}{values}   {interval(areas_of(by_scene))}")


def print_differences(curves: Curves) -> None:
    """Print the difference of each learned policy to its baselines."""
    for policy, by_quantity in curves.items():
        kind, _, reward = policy.partition("-")
        if kind not in ("modular", "paper", "e2e"):
            continue
        quantity = TRAINED_FOR.get(reward, "area")
        baselines = ["random"] if kind == "e2e" else ["frontier", "random-waypoints"]
        for baseline in (*baselines, UNTRAINED + policy):
            if baseline in curves:
                found = difference(areas_of(by_quantity[quantity]), areas_of(curves[baseline][quantity]))
                print(f"{policy:<14} - {baseline:<24} area under {quantity:<11} {found!s:<14} {verdict(found)}")


def verdict(change: Interval) -> str:
    """Say whether the interval of a difference excludes zero, and on which side."""
    return ("better" if change.mean > 0 else "worse") if change.excludes_zero else "not significant"


def draw(curves: Curves, path: str, title: str) -> None:
    """Draw one panel per quantity and one line per policy, with a band from the worst to the best scene."""
    fig, axes = plt.subplots(1, len(QUANTITIES), figsize=(14, 4), sharey=True, layout="constrained")
    shown = [policy for policy in curves if not policy.startswith((UNTRAINED, "oracle-"))]
    colors = plt.get_cmap("tab20").colors  # type: ignore[attr-defined]
    for ax, quantity in zip(axes, QUANTITIES.values(), strict=True):
        for policy, color in zip(shown, colors, strict=False):
            rows = np.array([np.mean(rows, axis=0) for rows in curves[policy][quantity].values()])
            steps = (np.arange(rows.shape[1]) + 1) * STRIDE
            ax.plot(steps, rows.mean(axis=0), label=policy, color=color)
            ax.fill_between(steps, rows.min(0), rows.max(0), color=color, alpha=0.1, linewidth=0)
        ax.set(title=quantity, xlabel="step", xlim=(0, steps[-1]), ylim=(0, 100))
        ax.grid(alpha=0.3)
    axes[0].set_ylabel("coverage [% of the visible quantity]")
    fig.legend(*axes[0].get_legend_handles_labels(), frameon=False, loc="outside lower center", ncols=6)
    fig.suptitle(title)
    fig.savefig(path, dpi=110)


def speed(quick: bool) -> dict[str, float]:
    """Measure the duration of an episode, and training with one and two workers."""
    figures = {"episode_s": in_fresh_process(1, episode_seconds, 200 if quick else 1500)}
    print(f"\nepisode of 1500 steps, 128 x 128, supersampled, with map: {figures['episode_s']:.1f} s")
    for kind, policy in (("modular", "modular-obs"), ("e2e", "e2e-cov")):
        print(in_fresh_process(1, time_table, policy, 20 if quick else 200))
        for workers in (2,) if quick else (1, 2):
            rate = in_fresh_process(workers, steps_per_second, policy, workers, quick)
            print(
                f"training {policy}, {workers} worker{'s' * (workers > 1)}: {rate:.0f} robot steps/s, updates included"
            )
            figures[f"{kind}_steps_per_s"] = rate
    return figures


def episode_seconds(steps: int) -> float:
    """Measure the duration of an episode and scale it to 1500 steps."""
    sim = Simulator(load_scene("dev-0"))
    explore(sim, "frontier", steps=40, progress=False)  # excludes compilation and texture baking
    started = time.perf_counter()
    explore(sim, "frontier", steps=steps, progress=False)
    return (time.perf_counter() - started) * 1500 / steps


def steps_per_second(policy: str, workers: int, quick: bool) -> float:
    """Measure robot steps per second over the later rollouts, updates included.

    The first rollouts load the scenes, which a long training does once. Here there are four of them, and a few rollouts
    are enough.
    """
    from autonerf_lab.training.settings import settings_of
    from autonerf_lab.training.train import train_policy

    settings = settings_of(policy, demonstrations=0, scenes=tuple(scene_names("train")[:4]))
    short: dict[str, Any] = {"environments": 4, "rollout": 25, "batch": 50} if quick else {}
    settings = replace(settings, **short)
    settings = replace(settings, episode=settings.rollout)  # an episode ends, and the callback is called, every rollout
    decisions = settings.rollout * settings.environments
    settings = replace(settings, frames=(4 if quick else 8) * decisions * make_interface(settings.network).follow)
    marks: list[tuple[float, float]] = []  # seconds, frames
    with tempfile.TemporaryDirectory() as folder:
        train_policy(
            policy, folder, settings, workers=workers, progress=False,
            callback=lambda row: marks.append((time.perf_counter(), row["frames"])),
        )  # fmt: skip
    first = marks[len(marks) // 2 - 1]
    return (marks[-1][1] - first[1]) / (marks[-1][0] - first[0])


def time_table(policy: str, decisions: int) -> str:
    """Return the ten functions that take most of the time of a training environment, with random actions."""
    from autonerf_lab.training.settings import settings_of
    from autonerf_lab.training.train import make_env

    env = make_env(settings_of(policy, demonstrations=0), policy.partition("-")[2])
    rng = np.random.default_rng(0)
    profile, steps = cProfile.Profile(), 0
    for decisions_of_pass in (2, decisions):  # the first pass compiles the kernels
        profile, steps = cProfile.Profile(), 0
        obs, _ = env.reset(seed=0)
        profile.enable()
        for _ in range(decisions_of_pass):
            blocks = np.flatnonzero(obs["reach"][0]) if "reach" in obs else np.arange(3)
            obs, _, _, _, info = env.step(rng.choice(blocks))
            steps += info.get("steps", 1)
        profile.disable()
    found: dict[Any, Any] = pstats.Stats(profile).stats  # type: ignore[attr-defined]
    rows = sorted(found.items(), key=lambda row: -row[1][2])[:10]  # by own time
    lines = [f"  {1000 * row[2] / steps:6.3f} ms  {name} ({Path(file).name})" for (file, _, name), row in rows]
    return "\n".join([f"\n{policy}: own time per robot step, one environment, profiled", *lines])


if __name__ == "__main__":
    main()
