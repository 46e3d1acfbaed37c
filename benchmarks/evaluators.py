"""Time and memory of the evaluators, and their growth with the size of the apartment.

One trained field of an apartment near 80 m2 is evaluated in tasks 1 to 5. The target is 65 s and 3 GB with the preset
``fast``. Then the true geometry of apartments of 40 to 140 m2 is evaluated; its queries cost almost nothing, so this
measures the evaluators alone. The script counts the rays and density queries, whose cost a trained field adds. Each
apartment runs in a process of its own, so that peak memories are independent. Areas are floor areas of the rooms.
``--quick`` measures two small apartments with the smoke preset.

Run: python benchmarks/evaluators.py [--quick]
"""

import argparse
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from common.growth import spread_apartments
from common.training import in_fresh_process
from common.views import floor_area, scene_by_name

from autonerf_lab.evaluators import DEFAULT_TASKS, TrueField, evaluate
from autonerf_lab.evaluators.ground_truth import true_map
from autonerf_lab.exploration import explore
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.nerf import fit, load_nerf
from autonerf_lab.presets import preset
from autonerf_lab.scenes import Scene, generate_apartment
from autonerf_lab.scenes.generator import generate_spec
from autonerf_lab.simulator import Simulator
from autonerf_lab.types import Rendering
from autonerf_lab.utils.resources import peak_gb

TARGET_M2 = 80.0  # area of the apartment of the trained field
THREADS = 2
TASKS = ("truth", *DEFAULT_TASKS)


class CountingField(TrueField):
    """True geometry that counts its queries."""

    def __init__(self, scene: Scene, sim: Simulator) -> None:
        super().__init__(scene, sim)
        self.queries = {"rendered_rays": 0, "density_queries": 0, "gradient_rays": 0}

    def render(self, c2w: np.ndarray, intrinsics: Intrinsics) -> Rendering:
        """Render, and count the rays."""
        self.queries["rendered_rays"] += intrinsics.width * intrinsics.height
        return super().render(c2w, intrinsics)

    def density(self, points: np.ndarray) -> np.ndarray:
        """Return densities, and count the points."""
        self.queries["density_queries"] += len(points)
        return super().density(points)

    def ray_gradients(
        self, rays_o: np.ndarray, rays_d: np.ndarray, target: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return gradients, and count the rays."""
        self.queries["gradient_rays"] += len(rays_o)
        return super().ray_gradients(rays_o, rays_d, target)


def simulator(name: str, size: str) -> Simulator:
    """Create the simulator of an apartment with the camera of a preset and a baked texture."""
    scene = scene_by_name(name)
    _ = scene.texture  # baked once per scene, not part of the evaluation
    return Simulator.from_preset(scene, preset(size))


def train(name: str, size: str, folder: Path) -> None:
    """Explore an apartment, train a field and save it."""
    trajectory = explore(simulator(name, size), "frontier", steps=preset(size).episode_steps, seed=0, progress=False)
    fit(trajectory, preset=size, progress=False).save(folder)


def measure(name: str, size: str, folder: Path | None = None) -> dict[str, Any]:
    """Measure seconds per task and peak memory in one apartment, for the field in ``folder`` or the true geometry."""
    small = generate_apartment(0)
    evaluate(TrueField(small, views=2), small, "smoke", progress=False)  # loads the compiled kernels
    sim = simulator(name, size)
    start = time.perf_counter()
    true_map(sim)
    truth_s = time.perf_counter() - start
    field: Any = CountingField(sim.scene, sim) if folder is None else load_nerf(folder)
    scores = evaluate(field, sim.scene, size, progress=False)
    failed = [row.status for row in scores if row.status.startswith("failed")]
    if failed:
        raise RuntimeError(failed[0])
    seconds = {"truth": truth_s, **{row.task: row.seconds for row in scores}}
    row = {"area_m2": floor_area(sim.scene.spec), **seconds, "total": sum(seconds.values()), "peak_gb": peak_gb()}
    return row | (field.queries if folder is None else {})


def show(rows: list[dict[str, Any]]) -> None:
    """Print the rows as a table."""
    print("  ".join(name.rjust(max(8, len(name))) for name in rows[0]))
    for row in rows:
        print("  ".join(f"{value:.2f}".rjust(max(8, len(name))) for name, value in row.items()), flush=True)


def main() -> None:
    """Run the benchmark; print tables and, as the last line, one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="Measure two small apartments with the smoke preset.")
    quick = parser.parse_args().quick
    size, names = ("smoke", spread_apartments(2, 6)) if quick else ("fast", spread_apartments(6, 60))
    areas = {name: floor_area(generate_spec(int(name.rpartition("-")[2]))) for name in names}
    near = min(names, key=lambda name: abs(areas[name] - TARGET_M2))
    with tempfile.TemporaryDirectory() as folder:
        in_fresh_process(THREADS, train, near, size, Path(folder))
        trained = in_fresh_process(THREADS, measure, near, size, Path(folder))
    print(f"Trained field: seconds per task, preset {size}")
    show([trained])
    rows = [in_fresh_process(THREADS, measure, name, size) for name in names]
    rows.sort(key=lambda row: row["area_m2"])
    print("True geometry: seconds per task")
    show(rows)
    floor = [row["area_m2"] for row in rows]
    slopes = {key: float(np.polyfit(floor, [row[key] for row in rows], 1)[0]) for key in (*TASKS, "total", "peak_gb")}
    print("increase per square metre: " + ", ".join(f"{key} {slope:.3f}" for key, slope in slopes.items()))
    found = {"total_s": trained["total"], "peak_gb": trained["peak_gb"], "area_m2": trained["area_m2"], "preset": size}
    found["seconds"] = {task: trained[task] for task in TASKS}
    print(json.dumps(found | {"true_geometry": rows, "per_m2": slopes}))


if __name__ == "__main__":
    main()
