"""Effect of PPO on the modular policies: PPO from scratch, imitation alone, and imitation followed by PPO.

    python benchmarks/policy_training.py --frames 1e6                       # hours; continues after an interruption
    python benchmarks/policy_training.py --seeds 1 3 1 1 --plot docs/learning_curves.png  # three trainings for obs
    python benchmarks/policy_training.py --quick                            # two minutes, as a check of the script

For each reward, one policy is trained by PPO from scratch and one by imitation of ``frontier`` and PPO, with the same
settings, frames and random seeds; the imitation alone is the start of the latter. Only the reward differs among the
four. All are evaluated from the same start poses: area under the coverage curve of the quantity that the policy was
trained for. Differences are paired by scene and start, with 95 % intervals (Student's t on scene means): PPO after
imitation minus imitation, PPO from scratch minus the untrained network, and either minus ``frontier``. With several
seeds, the means of the seeds are compared.

Trainings and rollouts are kept in ``--out``; ``--keep`` copies the weights and the results that a table needs. The last
line of the output is JSON; ``--plot`` draws the learning curves, with a band over the seeds.
"""

import argparse
import json
import shutil
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import cycle
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from common.output import write_csv
from common.training import set_threads
from exploration import TRAINED_FOR, UNTRAINED, Curves, area_rows, areas_of, run_all, verdict
from scipy.ndimage import uniform_filter1d

from autonerf_lab.benchmark.statistics import Runs, difference, interval
from autonerf_lab.policies.weights import read_meta
from autonerf_lab.scenes import scene_names
from autonerf_lab.training.checkpoint import CHECKPOINT
from autonerf_lab.training.settings import PolicySettings, settings_of
from autonerf_lab.training.train import train_policy

KINDS = ("scratch", "imitation", "ppo")  # of trainings
SMOOTH = 5  # updates of the running mean in the figure
DIFFERENCES = (("ppo", "imitation"), ("scratch", "untrained"), ("ppo", "frontier"), ("scratch", "frontier"))
TITLES = {
    "untrained": "untrained",
    "scratch": "PPO from scratch",
    "imitation": "imitation",
    "ppo": "imitation, PPO",
    "frontier": "frontier",
}


@dataclass(frozen=True)
class Variants:
    """Folders of the trainings for one reward and seed."""

    scratch: Path
    imitation: Path
    ppo: Path

    def policies(self) -> dict[str, str]:
        """Return the names by which the exploration benchmark makes the policies."""
        weights = {name: f"{getattr(self, name)}/policy.safetensors" for name in KINDS}
        return {"untrained": UNTRAINED + weights["scratch"], **weights, "frontier": "frontier"}


def train(trainings: dict[str, list[PolicySettings]], out: Path, workers: int) -> dict[str, list[Variants]]:
    """Train the policies of each reward and seed, or continue their trainings, one in each process."""
    folders = {
        reward: [Variants(*(out / f"{reward}-{s.seed}-{name}" for name in KINDS)) for s in seeds]
        for reward, seeds in trainings.items()
    }
    alone: list[tuple[str, Path, PolicySettings]] = []
    after: list[tuple[str, Path, PolicySettings, Path]] = []
    for reward, seeds in trainings.items():
        for settings, folder in zip(seeds, folders[reward], strict=True):
            alone.append((reward, folder.imitation, replace(settings, frames=0)))
            alone.append((reward, folder.scratch, replace(settings, demonstrations=0)))
            after.append((reward, folder.ppo, settings, folder.imitation))
    with ProcessPoolExecutor(workers, get_context("spawn"), set_threads, (1,)) as pool:
        for jobs in (alone, after):
            for done in [pool.submit(train_one, *job) for job in jobs]:
                print(f"trained: {done.result()}", flush=True)
    return folders


def train_one(reward: str, folder: Path, settings: PolicySettings, start: Path | None = None) -> Path:
    """Train a policy, or continue its training; ``start`` is the folder of a training that it goes on with."""
    if start is not None and not (folder / CHECKPOINT).exists():
        folder.mkdir(parents=True, exist_ok=True)
        shutil.copy(start / CHECKPOINT, folder)
    return train_policy(f"modular-{reward}", folder, settings, workers=1, progress=False)


def mean_of_seeds(curves: Curves, policies: list[str], quantity: str) -> Runs:
    """Return the areas under the curves, means over the policies, by scene and start."""
    areas = [areas_of(curves[policy][quantity]) for policy in policies]
    return {scene: np.mean([part[scene] for part in areas], axis=0).tolist() for scene in areas[0]}


def print_table(reward: str, areas: dict[str, Runs]) -> dict[str, float]:
    """Print the areas and the differences for one reward; return the differences."""
    print(f"\nmodular-{reward}: area under the curve of {TRAINED_FOR[reward]}, %")
    for name, runs in areas.items():
        print(f"  {TITLES[name]:<20}{interval(runs)!s:>16}")
    found = {}
    for a, b in DIFFERENCES:
        change = difference(areas[a], areas[b])
        print(f"  {TITLES[a]} - {TITLES[b]}: {change!s} ({verdict(change)})")
        found[f"{reward} {a} - {b}"] = round(change.mean, 2)
    return found


def draw(trained: dict[str, list[Variants]], path: str) -> None:
    """Draw the discounted return over the frames: each update, and the running mean with the range of the seeds."""
    fig, axes = plt.subplots(1, len(trained), figsize=(4.2 * len(trained), 3.2), layout="constrained", squeeze=False)
    for ax, (reward, seeds) in zip(axes[0], trained.items(), strict=True):
        for name, color in (("scratch", "#0072B2"), ("ppo", "#D55E00")):
            rows = [read_meta(getattr(variants, name) / "policy")["curve"] for variants in seeds]
            count = min(map(len, rows))
            frames = np.mean([[r["frames"] for r in part[:count]] for part in rows], axis=0)
            returns = np.array([[r["return"] for r in part[:count]] for part in rows])
            smooth = uniform_filter1d(returns, SMOOTH, axis=1)
            ax.plot(frames, returns.mean(axis=0), ".", color=color, alpha=0.4)
            ax.plot(frames, smooth.mean(axis=0), color=color, label=TITLES[name])
            ax.fill_between(frames, smooth.min(axis=0), smooth.max(axis=0), color=color, alpha=0.2, linewidth=0)
        ax.set(title=f"modular-{reward}", xlabel="frames")
        ax.grid(alpha=0.3)
    axes[0, 0].set_ylabel("discounted return")
    axes[0, 0].legend(frameon=False)
    fig.savefig(path, dpi=110)


def keep(trained: dict[str, list[Variants]], curves: Curves, folder: Path) -> None:
    """Copy the weights, and write the area under each curve of each rollout to ``cells.csv``."""
    folder.mkdir(parents=True, exist_ok=True)
    kept: Curves = {}
    for reward, seeds in trained.items():
        for seed, variants in enumerate(seeds):
            suffix = f"-{seed}" if seed else ""
            for kind, policy in variants.policies().items():
                name = "frontier" if kind == "frontier" else f"modular-{reward}-{kind}{suffix}"
                kept[name] = curves[policy]
                if kind in KINDS:
                    for extension in (".safetensors", ".json"):
                        shutil.copy(getattr(variants, kind) / f"policy{extension}", folder / f"{name}{extension}")
    write_csv(folder / "cells.csv", area_rows(kept))


def main() -> None:
    """Train, evaluate and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rewards", default=",".join(TRAINED_FOR), help="Separated by commas.")
    parser.add_argument("--frames", type=float, default=1e6, help="Robot actions of each training by PPO.")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1], help="Trainings of each kind, or for each reward.")
    parser.add_argument("--starts", type=int, default=5, help="Start poses in each scene.")
    parser.add_argument("--steps", type=int, default=1500, help="Actions per episode of the evaluation.")
    parser.add_argument("--split", default="dev", choices=["dev", "val"])
    parser.add_argument("--workers", type=int, default=2, help="Trainings or rollouts at a time.")
    parser.add_argument("--out", type=Path, default=Path("runs/policy_training"), help="Folder of all results.")
    parser.add_argument("--plot", default=None, help="File of the figure of the learning curves.")
    parser.add_argument("--keep", type=Path, default=None, help="Folder for weights and the areas of every rollout.")
    parser.add_argument("--quick", action="store_true", help="One reward, 4000 frames, one scene, 100 steps.")
    options = parser.parse_args()
    rewards, scenes = options.rewards.split(","), scene_names(options.split)
    if len(options.seeds) not in (1, len(rewards)) or min(options.seeds) < 1:
        parser.error(f"--seeds takes one positive number, or one for each of the {len(rewards)} rewards")
    changes: dict[str, Any] = {"frames": round(options.frames)}
    if options.quick:
        rewards, scenes, options.starts, options.steps, options.seeds = rewards[:1], scenes[:1], 1, 100, [1]
        changes = {"frames": 4000, "environments": 4, "episode": 20, "rollout": 20, "batch": 40, "demonstrations": 2}
        options.out = Path(tempfile.mkdtemp())
    settings = {
        reward: [settings_of(f"modular-{reward}", seed=seed, **changes) for seed in range(count)]
        for reward, count in zip(rewards, cycle(options.seeds), strict=False)
    }
    trained = train(settings, options.out / "trainings", options.workers)
    names = {reward: [variants.policies() for variants in seeds] for reward, seeds in trained.items()}
    policies = sorted({policy for seeds in names.values() for part in seeds for policy in part.values()})
    curves = run_all(policies, scenes, options.starts, options.steps, options.out / "rollouts", options.workers)
    found: dict[str, float] = {}
    for reward, seeds in names.items():
        quantity = TRAINED_FOR[reward]
        areas = {name: mean_of_seeds(curves, [part[name] for part in seeds], quantity) for name in TITLES}
        found |= print_table(reward, areas)
    if options.keep:
        keep(trained, curves, options.keep)
    if options.plot:
        draw(trained, options.plot)
    print(json.dumps(found))


if __name__ == "__main__":
    main()
