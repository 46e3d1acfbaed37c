"""Load damaged files: each mutant loads, or raises an error of the package, within 2 seconds of CPU time and 512 MB.

Each format in the list has a valid file, made here, and a loader. Mutants change bytes, cut or repeat parts, or
replace, remove and add values of the JSON inside. ``--only FORMAT --seed S --first N --mutants 1`` repeats a violation.
The last line of the output is JSON, with the CPU seconds of each format.

A mutant depends only on the seed and its number, so a long run can be divided into ranges, for example five nights of

    nice -n 19 python benchmarks/fuzz.py --first 0 --mutants 20000     # then --first 20000, 40000, ...
"""

import argparse
import json
import os
import resource
import signal
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import torch
from common.fuzz_mutants import mutant
from common.fuzz_sources import make_sources
from PIL import Image
from stable_baselines3.common.vec_env import VecEnv

from autonerf_lab.benchmark import Grid
from autonerf_lab.benchmark.results import Outcome, StageCost, load_results, open_results
from autonerf_lab.data.dataset import load_dataset
from autonerf_lab.data.images import read_classes, read_depth, read_rgb
from autonerf_lab.data.trajectory import Trajectory, load_trajectory
from autonerf_lab.errors import AutoNerfError
from autonerf_lab.evaluators import Scores
from autonerf_lab.geometry import Intrinsics, planar_pose
from autonerf_lab.nerf import checkpoint, fit, load_nerf
from autonerf_lab.nerf.models import model_spec
from autonerf_lab.pipeline import outputs
from autonerf_lab.pipeline.gallery import Gallery, read_gallery
from autonerf_lab.pipeline.run_folder import STAGES, RunConfig, load_run, open_run
from autonerf_lab.policies import WEIGHTS, load_policy
from autonerf_lab.policies.networks import RecurrentNetwork
from autonerf_lab.policies.spec import make_interface, make_network
from autonerf_lab.rewards import make_reward
from autonerf_lab.scenes import export_glb, generate_apartment, import_scene, load_scene
from autonerf_lab.scenes.build import build
from autonerf_lab.scenes.semantics_file import read_semantics
from autonerf_lab.scenes.spec import dumps, read_spec
from autonerf_lab.training.checkpoint import CHECKPOINT, read_checkpoint
from autonerf_lab.training.ppo import make_ppo
from autonerf_lab.training.session import CheckpointHeader, TrainingSession
from autonerf_lab.training.settings import settings_of
from autonerf_lab.training.shortest_path_expert import Imitation
from autonerf_lab.training.train import IMITATION, make_env
from autonerf_lab.training.worker_pool import WorkerPool
from autonerf_lab.types import Score
from autonerf_lab.utils.resources import peak_gb, reset_peak, resident_gb

MAX_SECONDS, MAX_GB = 2.0, 0.512
HANGING = 10.0  # seconds of CPU time after which a loader is interrupted
MEMORY = Path("/dev/shm")  # files in memory: opening one on a disk takes longer than most loaders


@dataclass(frozen=True)
class Format:
    """One file format."""

    name: str
    file: Path  # valid; mutants take its place
    load: Callable[[], Any]
    after: Callable[[], None] = lambda: None  # called when the mutant is written, before it is loaded


class NoWorkers(WorkerPool):
    """Stands for the worker processes of a policy training: it has spaces, and accepts every call."""

    def __init__(self, network: dict[str, Any]) -> None:
        interface = make_interface(network)
        VecEnv.__init__(self, 1, interface.observation_space, interface.action_space)

    def call(self, name: str, *arguments: Any) -> list[Any]:
        """Do nothing."""
        return []


def small_spec() -> dict[str, Any]:
    """Return the specification of an apartment with few objects, and few but different parts of these."""
    spec = generate_apartment(3).spec
    assert spec is not None
    objects = [entry for entry in spec["objects"] if entry["name"] in ("building", "bath tub", "potted plant (palm)")]
    objects += [next(entry for entry in spec["objects"] if entry["name"] == "curtain")]
    for entry in objects:
        different = list({frozenset(part): part for part in entry["parts"]}.values())
        entry["parts"] = [*entry["parts"][:12], *different] if entry["name"] == "building" else different
    used = {part["m"] for entry in objects for part in entry["parts"]}
    materials = {name: material for name, material in spec["materials"].items() if name in used}
    lights = list({light["kind"]: light for light in spec["lights"]}.values())
    few = {"rooms": spec["rooms"][:2], "openings": spec["openings"][:2], "lights": lights}
    return spec | few | {"materials": materials, "objects": objects}


def policy_training(folder: Path) -> Callable[[], None]:
    """Write the checkpoint of a policy training with a learned reward; return a function that resumes from it."""
    settings = settings_of(
        "e2e-cur", environments=1, rollout=4, batch=4, sensor=16, network={"kind": "egocentric", "memory": 4}
    )
    pool = NoWorkers(settings.network)
    fingerprint = {"policy": "e2e-cur", "lr": settings.lr, "scenes": ["train-00"]}
    run = TrainingSession(folder, fingerprint, settings, pool, make_reward("cur"), False, lambda row: None)
    run.model = make_ppo(pool, lambda: make_network(settings.network)[1], settings, None)
    torch.stack([value.sum() for value in run.model.policy.parameters()]).sum().backward()
    run.model.policy.optimizer.step()
    run.curve = [{"frames": 8.0, "reward": 0.5, "explored_m2": 3.0}]
    run.save()

    def resume() -> None:
        found = read_checkpoint(folder / CHECKPOINT, fingerprint, CheckpointHeader)
        assert found is not None
        run.resume(*found)

    return resume


def imitation(path: Path) -> Callable[[], None]:
    """Write the checkpoint of an imitation of shortest paths; return a function that resumes from it."""
    settings = settings_of("pointgoal", environments=1, network={"kind": "goal", "memory": 4})
    env = make_env(settings, "", [load_scene("dev-0")])
    network = make_network(settings.network)[1]
    assert isinstance(network, RecurrentNetwork)
    fingerprint = {"policy": "pointgoal", "lr": settings.lr}
    run = Imitation(network, lambda: env, settings)
    run.advance()
    run.save(path, fingerprint)
    return lambda: run.resume(path, fingerprint)


def make_formats(folder: Path) -> list[Format]:
    """Write a valid file of every format."""
    spec = small_spec()
    (folder / "scene.json").write_text(dumps(spec))
    export_glb(build(spec), folder / "home.glb", semantic=True)
    import trimesh

    box = trimesh.creation.box((4, 3, 2.5))
    box.invert()
    for suffix in ("ply", "obj"):
        box.export(folder / f"box.{suffix}")
    rng = np.random.default_rng(0)
    poses = np.stack([planar_pose(x, 0.5, 0.1 * x) for x in range(4)])
    depth, classes = rng.uniform(1, 3, (4, 8, 8)).astype(np.float32), rng.integers(0, 16, (4, 8, 8), dtype=np.uint8)
    rgb = rng.integers(0, 255, (4, 8, 8, 3), dtype=np.uint8)
    trajectory = Trajectory(poses, rgb, depth, classes, Intrinsics.from_fov(8, 8), {"scene": "x"})
    trajectory.save(folder / "trajectory")
    for name, array in (("rgb", rgb[0]), ("depth", (depth[0] * 1000).astype(np.uint16)), ("classes", classes[0])):
        Image.fromarray(array).save(folder / f"{name}.png")
    sizes: dict[str, Any] = {"levels": 2, "log2_entries": 4, "hidden": 8}
    sizes |= {"proposal_levels": 2, "proposal_log2_entries": 4}
    settings = replace(model_spec("semantic-nerfacto").settings["smoke"], steps=2, rays=32, far=3.0, **sizes)
    field = fit(trajectory, settings=settings, preset="smoke", progress=False)
    field.save(folder / "field")
    with patch.object(checkpoint, "SAVE_EVERY", 0.0):
        fit(trajectory, settings=settings, preset="smoke", progress=False, checkpoint=folder / "training")
    for suffix in (".json", ".safetensors"):
        (folder / f"policy{suffix}").write_bytes((WEIGHTS / f"modular-obs{suffix}").read_bytes())
    run = open_run(folder / "run", RunConfig("val-0", "f00", "random", "smoke", model="instant-ngp"))
    (folder / "run/scene.json").write_text("{}")
    run.mark_finished("scene", 1.0, 0.5)
    resume_policy = policy_training(folder / "policy-training")
    resume_imitation = imitation(folder / IMITATION)
    grid = Grid(("random",), ("val-0",), 1, preset="smoke")
    results = open_results(folder / "results", grid)
    cell = grid.cells()[0]
    cost: dict[str, StageCost] = {"scene": {"seconds": 1.0, "peak_gb": None}}
    results.write(Outcome(cell, "ok", (Score("rendering", "psnr", 20.0, "dB"),), cost, {"coverage": [1.0, 2.0]}))
    Scores([Score("rendering", "psnr", 20.0, "dB", n=3)]).save(folder / "scores.json")
    gallery = Gallery(folder / "figures", "explore")
    gallery.add("trajectory", "red", lambda: rgb[0], title="Red", caption="A square.", alt="Square")
    gallery.close()

    def train_on() -> None:
        fit(trajectory, settings=settings, preset="smoke", progress=False, checkpoint=folder / "training")

    def remove_outputs() -> None:
        outputs.check_unchanged(folder / "run", STAGES)
        outputs.remove(folder / "run", STAGES)

    return [
        Format("scene.json", folder / "scene.json", lambda: read_spec(folder / "scene.json")),
        Format(
            "semantics.json", folder / "home.semantics.json", lambda: read_semantics(folder / "home.semantics.json")
        ),
        Format("mesh.glb", folder / "home.glb", lambda: import_scene(folder / "home.glb")),
        Format("mesh.ply", folder / "box.ply", lambda: import_scene(folder / "box.ply")),
        Format("mesh.obj", folder / "box.obj", lambda: import_scene(folder / "box.obj")),
        Format("trajectory", folder / "trajectory/transforms.json", lambda: load_trajectory(folder / "trajectory")),
        Format("photographs", folder / "trajectory/transforms.json", lambda: load_dataset(folder / "trajectory")),
        Format("rgb.png", folder / "rgb.png", lambda: read_rgb(folder / "rgb.png")),
        Format("depth.png", folder / "depth.png", lambda: read_depth(folder / "depth.png")),
        Format("classes.png", folder / "classes.png", lambda: read_classes(folder / "classes.png")),
        Format("nerf.safetensors", folder / "field/nerf.safetensors", lambda: load_nerf(folder / "field")),
        Format("training.safetensors", folder / "training/training.safetensors", train_on),
        Format("policy.json", folder / "policy.json", lambda: load_policy(folder / "policy")),
        Format("policy.safetensors", folder / "policy.safetensors", lambda: load_policy(folder / "policy")),
        Format("checkpoint.safetensors", folder / "policy-training" / CHECKPOINT, resume_policy),
        Format("imitation.safetensors", folder / IMITATION, resume_imitation),
        Format("run.json", folder / "run/run.json", lambda: load_run(folder / "run").save()),
        Format("outputs.json", folder / "run/outputs.json", remove_outputs),
        Format("grid.json", folder / "results/grid.json", lambda: load_results(folder / "results").outcomes()),
        Format(
            "cell.json",
            results.cell_file(cell),
            lambda: [o.seconds for o in load_results(folder / "results").outcomes()],
        ),
        Format("scores.json", folder / "scores.json", lambda: Scores.load(folder / "scores.json").table()),
        Format("figures.json", folder / "figures/explore.json", lambda: read_gallery(folder / "figures", "explore")),
    ]


class Hanging(BaseException):
    """A loader does not end."""


def _interrupt(*_: object) -> None:
    raise Hanging(f"after {HANGING:g} s")


def _state(path: str) -> tuple[int, ...] | None:
    """Return what changes if a file is written, or None without a file."""
    try:
        found = os.stat(path)
    except OSError:
        return None
    return found.st_ino, found.st_size, found.st_mtime_ns


def _cpu_seconds(form: Format) -> float:
    """Load a file again and return the CPU time: a machine that does other work makes seconds on the clock longer."""
    started = time.process_time()
    with suppress(AutoNerfError):
        form.load()
    return time.process_time() - started


def attack(form: Format, mutants: int, first: int, seed: int) -> dict[str, Any]:
    """Load the mutants of one format."""
    valid = form.file.read_bytes()
    beside = [path for path in form.file.parent.glob("*") if path.is_file() and path != form.file]
    companions = {str(path): path.read_bytes() for path in beside if path.stat().st_size < 4 << 20}
    states = {path: _state(path) for path in companions}
    violations: Counter[str] = Counter()
    examples: dict[str, int] = {}
    slowest, refused = 0.0, 0
    reset_peak()
    base, began = resident_gb(os.getpid()), time.process_time()
    signal.signal(signal.SIGPROF, _interrupt)
    for index in range(first, first + mutants):
        rng = np.random.default_rng([seed, index])
        form.file.write_bytes(mutant(valid, form.file.suffix, rng))
        form.after()
        started, found = time.perf_counter(), None
        signal.setitimer(signal.ITIMER_PROF, HANGING)
        try:
            form.load()
        except AutoNerfError:
            refused += 1
        except BaseException as error:  # anything else is a violation, also SystemExit
            if isinstance(error, KeyboardInterrupt):
                raise
            found = f"{type(error).__name__}: {str(error)[:80]}"
        signal.setitimer(signal.ITIMER_PROF, 0)
        seconds = time.perf_counter() - started
        if found is None and seconds > MAX_SECONDS and (seconds := _cpu_seconds(form)) > MAX_SECONDS:
            found = "slow"
        slowest = max(slowest, seconds)
        largest = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6  # of the whole process: quick to ask
        if found is None and largest - base > MAX_GB and (peak_gb() or 0) - base > MAX_GB:
            found = "memory"
            reset_peak()
        if found:
            violations[found] += 1
            examples.setdefault(found, index)
        for path, data in companions.items():
            if _state(path) != states[path]:
                Path(path).write_bytes(data)
                states[path] = _state(path)
    form.file.write_bytes(valid)
    row = {"format": form.name, "mutants": mutants, "refused": refused, "violations": sum(violations.values())}
    row |= {"seconds": round(time.process_time() - began, 1), "slowest": round(slowest, 2)}
    counts = f"{mutants:7} mutants, {refused:7} refused, {row['violations']:4} violations"
    print(f"{form.name:22} {counts}, slowest {slowest:.2f} s", flush=True)
    for text, count in violations.most_common(8):
        print(f"    {count:4} {text}  (first: mutant {examples[text]})")
    return row


def main() -> None:
    """Attack all formats."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mutants", type=int, default=2000, help="Mutants per format.")
    parser.add_argument("--first", type=int, default=0, help="Number of the first mutant.")
    parser.add_argument("--seed", type=int, default=0, help="Random seed.")
    parser.add_argument("--only", default=None, help="Formats, separated by commas.")
    parser.add_argument("--quick", action="store_true", help="100 mutants per format.")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory(dir=MEMORY if MEMORY.is_dir() else None) as folder:
        forms = [*make_formats(Path(folder)), *(Format(*entry) for entry in make_sources(Path(folder) / "sources"))]
        only = arguments.only.split(",") if arguments.only else [form.name for form in forms]
        mutants = 100 if arguments.quick else arguments.mutants
        rows = [attack(form, mutants, arguments.first, arguments.seed) for form in forms if form.name in only]
    print(json.dumps({"violations": sum(row["violations"] for row in rows), "formats": rows}))


if __name__ == "__main__":
    main()
