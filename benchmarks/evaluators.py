"""How long do the evaluators take, and how do they grow with the apartment? The true geometry is what is scored.

The field costs nothing here, so these are the seconds of the evaluators themselves: what a trained field adds are its
own renderings and density queries, counted in the table. ``--quick`` looks at one small apartment only.

Run: python benchmarks/evaluators.py [--quick]
"""

import argparse
import json
import resource
import time

import numpy as np

from autonerf_lab.config import preset
from autonerf_lab.evaluators import METRICS, Scores, TrueField, evaluate
from autonerf_lab.evaluators.truth import true_map
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.scenes import Scene, generate_apartment
from autonerf_lab.simulator import Simulator


class Counting(TrueField):
    """The true geometry, counting what it is asked."""

    def __init__(self, scene: Scene, sim: Simulator) -> None:
        super().__init__(scene, sim)
        self.asked = {"rendered_rays": 0, "density_queries": 0, "gradient_rays": 0}

    def render(self, c2w, intrinsics):
        self.asked["rendered_rays"] += intrinsics.width * intrinsics.height
        return super().render(c2w, intrinsics)

    def density(self, points):
        self.asked["density_queries"] += len(points)
        return super().density(points)

    def ray_gradients(self, rays_o, rays_d, target):
        self.asked["gradient_rays"] += len(rays_o)
        return super().ray_gradients(rays_o, rays_d, target)


def measure(seed: int, size: str) -> dict[str, float]:
    """Seconds a task in one apartment, its area, and what was asked of the field."""
    scene, sizes = generate_apartment(seed), preset(size)
    sim = Simulator(scene, Intrinsics.from_fov(sizes.width, sizes.height), supersample=sizes.supersample)
    _ = scene.texture  # baked once for a scene: no part of the evaluation
    start = time.perf_counter()
    truth = true_map(sim)
    truth_s = time.perf_counter() - start
    field = Counting(scene, sim)
    scores: Scores = evaluate(field, scene, size, progress=False)
    seconds = {row.task: row.seconds for row in scores}
    failed = [row.status for row in scores if row.status.startswith("failed")]
    if failed:
        raise RuntimeError(failed[0])
    area = float(truth.scored.sum() * truth.grid.cell**2)
    return {"area_m2": area, "truth": truth_s, **seconds, "total": truth_s + sum(seconds.values()), **field.asked}


def main() -> None:
    """Measure, print a table, and one JSON object as the last line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="the smoke preset in one apartment")
    quick = parser.parse_args().quick
    size, seeds = ("smoke", [0]) if quick else ("fast", [0, 1, 2, 3])
    measure(0, "smoke")  # compiles the kernels
    rows = sorted((measure(seed, size) for seed in seeds), key=lambda row: row["area_m2"])
    columns = ["area_m2", "truth", *METRICS, "total", "rendered_rays", "density_queries", "gradient_rays"]
    print(f"Seconds a task, preset {size}, true geometry as the field")
    print("  ".join(name.rjust(max(8, len(name))) for name in columns))
    for row in rows:
        print("  ".join(f"{row[name]:.1f}".rjust(max(8, len(name))) for name in columns))
    peak_gb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    areas, totals = np.array([r["area_m2"] for r in rows]), np.array([r["total"] for r in rows])
    per_m2 = float(np.polyfit(areas, totals, 1)[0]) if len(rows) > 1 else None
    print(f"peak memory {peak_gb:.2f} GB" + (f", {per_m2:.2f} s more for each square metre" if per_m2 else ""))
    nearest = rows[int(np.abs(areas - 80).argmin())]
    print(
        json.dumps(
            {
                "total_s": nearest["total"],
                "area_m2": nearest["area_m2"],
                "peak_gb": peak_gb,
                "seconds": {name: nearest[name] for name in ("truth", *METRICS)},
                "asked": {k: nearest[k] for k in ("rendered_rays", "density_queries", "gradient_rays")},
                "seconds_per_m2": per_m2,
                "preset": size,
            }
        )
    )


if __name__ == "__main__":
    main()
