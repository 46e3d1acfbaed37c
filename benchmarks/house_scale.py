"""Time and memory of the whole chain over the floor area, from 40 to 300 m2, and the scores of the library's houses.

For homes of growing area, generated with one seed per area, the script measures the generation, the baked texture, the
exploration (frontier, images of the preset ``fast``), the training, and the evaluation of the trained field (rendering,
maps, mesh). Every home runs in a process of its own, so that peak memories are independent.
The number of training steps is that of the preset ``fast``, which grows with the explored area; ``--steps`` sets the
length of the episodes. The figure should be about linear.

``--houses`` scores houses of the library instead, with episodes of 4000 steps; the targets are a fit of at most 300 s,
27 dB, 85 % recall of free space and 70 % completion of the whole first floor. ``--quick`` measures two small homes with
the preset ``smoke``.

Run: python benchmarks/house_scale.py [--quick] [--houses house-0 house-4 --policies frontier modular-obs] [--out DIR]
"""

import argparse
import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numba
import numpy as np
from common.output import write_csv
from common.training import in_fresh_process
from skimage.io import imsave

from autonerf_lab.evaluators import evaluate, export_mesh, extract_mesh, semantic_mesh
from autonerf_lab.exploration import explore
from autonerf_lab.nerf import fit
from autonerf_lab.presets import preset
from autonerf_lab.scenes import Scene, generate_apartment, load_scene
from autonerf_lab.simulator import Simulator
from autonerf_lab.utils.resources import peak_gb
from autonerf_lab.viz.figures import bird_view

AREAS = (40, 80, 120, 160, 200, 250, 300)  # m2
TASKS = ("rendering", "maps", "mesh")
STAGES = ("generate", "texture", "explore", "fit", "evaluate")
TARGETS = {"fit_s": 300.0, "psnr": 27.0, "free_recall": 85.0, "completion_ratio_all": 70.0}
THREADS = min(2, numba.get_num_threads())


@contextmanager
def stopwatch(seconds: dict[str, float], name: str) -> Iterator[None]:
    """Add the duration of a block to ``seconds``."""
    start = time.perf_counter()
    yield
    seconds[f"{name}_s"] = time.perf_counter() - start


def chain(home: str | int, policy: str, model: str, steps: int, size: str, folder: Path | None) -> dict[str, Any]:
    """Run the chain in a house of the library, or in a generated home of an area; return its times, memory and scores.

    Args:
        home: name in the library, or area in m2.
        policy: name of the policy.
        model: name of the model of the field.
        steps: length of the episode.
        size: name of the preset.
        folder: for the trajectory, the field and the meshes; None stores nothing.
    """
    seconds: dict[str, float] = {}
    with stopwatch(seconds, "generate"):
        scene: Scene = load_scene(home) if isinstance(home, str) else generate_apartment(home, area=home)
    with stopwatch(seconds, "texture"):
        _ = scene.texture
    sim = Simulator.from_preset(scene, preset(size))
    explore(sim, policy, steps=20, progress=False)  # loads the compiled kernels
    with stopwatch(seconds, "explore"):
        trajectory = explore(sim, policy, steps=steps, seed=0, progress=False)
    explored, memory = trajectory.meta["explored_m2"], peak_gb()
    print(f"{scene.name} {policy}: explored {explored[-1]:.0f} m2 in {seconds['explore_s']:.0f} s", flush=True)
    with stopwatch(seconds, "fit"):
        field = fit(trajectory, model, preset=size, progress=False)
    if folder is not None:
        trajectory.save(folder / f"{scene.name}-{policy}/trajectory")
        field.save(folder / f"{scene.name}-{policy}/nerf")
    print(f"{scene.name} {policy}: {field.meta['steps']} training steps in {seconds['fit_s']:.0f} s", flush=True)
    with stopwatch(seconds, "evaluate"):
        scores = evaluate(field, scene, size, tasks=TASKS, progress=False)
    values = {score.metric: score.value for score in scores}
    row: dict[str, Any] = {"home": scene.name, "policy": policy, "model": model, "explored_m2": explored[-1], **seconds}
    row |= {"steps": field.meta["steps"], "explore_gb": memory, "peak_gb": peak_gb(), "total_s": sum(seconds.values())}
    row |= {name: values.get(name) for name in ("psnr", "free_recall", "completion_ratio", "completion_ratio_all")}
    if folder is not None:
        name = folder / f"{scene.name}-{policy}"
        color = extract_mesh(field, preset(size).mesh_voxel)
        classes = semantic_mesh(color)
        export_mesh(color, name / "color.ply")
        export_mesh(classes, name / "semantic.ply")
        imsave(name / "mesh.jpg", np.concatenate([bird_view(mesh, width=640) for mesh in (color, classes)], axis=1))
        scores.save(name / "scores.json")
    return row


def show(row: dict[str, Any]) -> None:
    """Print one row."""
    texts = (f"{name} {value:.1f}" if isinstance(value, float) else f"{name} {value}" for name, value in row.items())
    print(", ".join(texts), flush=True)


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Write the figure: seconds of each stage and peak memory over the explored area."""
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    area = [row["explored_m2"] for row in rows]
    for stage in STAGES:
        left.plot(area, [row[f"{stage}_s"] for row in rows], marker="o", label=stage)
    left.set(xlabel="explored area (m²)", ylabel="seconds")
    left.legend()
    for key, label in (("explore_gb", "exploration"), ("peak_gb", "whole chain")):
        right.plot(area, [row[key] for row in rows], marker="o", label=label)
    right.set(xlabel="explored area (m²)", ylabel="peak memory (GB)", ylim=(0, None))
    right.legend()
    figure.savefig(path, dpi=120)


def main() -> None:
    """Run the benchmark; print a table and, as the last line, one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="Measure two small homes with the smoke preset.")
    parser.add_argument("--houses", nargs="*", default=[], help="Houses of the library to score instead.")
    parser.add_argument("--policies", nargs="*", default=["frontier"], help="Policies of the houses.")
    parser.add_argument("--model", default="semantic-nerfacto", help="Model of the fields.")
    parser.add_argument("--areas", nargs="*", type=int, default=AREAS, help="Areas of the generated homes, m2.")
    parser.add_argument("--steps", type=int, default=None, help="Steps of an episode; default: 1500, houses 4000.")
    parser.add_argument("--out", type=Path, default=None, help="Folder for house_scale.csv and house_scale.png.")
    options = parser.parse_args()
    size = "smoke" if options.quick else "fast"
    steps = options.steps or (60 if options.quick else 4000 if options.houses else 1500)
    homes = options.houses or ((40, 60) if options.quick else options.areas)
    policies = options.policies if options.houses else ["frontier"]
    rows = []
    for home in homes:
        for policy in policies:
            folder = options.out if options.houses else None
            rows.append(in_fresh_process(THREADS, chain, home, policy, options.model, steps, size, folder))
            show(rows[-1])
            if options.out is not None:  # after each home: an interrupted run keeps its rows
                options.out.mkdir(parents=True, exist_ok=True)
                write_csv(options.out / "house_scale.csv", rows)
    if options.out is not None and not options.houses:
        draw(rows, options.out / "house_scale.png")
    found: dict[str, Any] = {"preset": size, "steps": steps, "rows": rows}
    if options.houses:
        found["targets"] = TARGETS
    else:
        area = [row["explored_m2"] for row in rows]
        keys = (*(f"{stage}_s" for stage in STAGES), "total_s", "peak_gb")
        found["per_m2"] = {key: float(np.polyfit(area, [row[key] for row in rows], 1)[0]) for key in keys}
    print(json.dumps(found))


if __name__ == "__main__":
    main()
