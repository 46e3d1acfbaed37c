"""Generate many apartments and count violated invariants: ``python benchmarks/scenes.py [--quick]``."""

import argparse
import json
import time

import numpy as np

from autonerf_lab.scenes import generate_apartment
from autonerf_lab.scenes.inspection import problems


def main() -> None:
    """Run the benchmark and print a table, then one JSON object as the last line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="Use 25 seeds instead of 1000.")
    parser.add_argument("--seeds", type=int, default=None, help="Number of random seeds.")
    parser.add_argument("--first", type=int, default=100_000, help="First random seed.")
    options = parser.parse_args()
    count = options.seeds or (25 if options.quick else 1000)
    generate_apartment(0).texture  # noqa: B018  compile the kernels before the measurement
    failures, made, baked, triangles, areas = 0, [], [], [], []
    for seed in range(options.first, options.first + count):
        start = time.perf_counter()
        scene = generate_apartment(seed)
        made.append(time.perf_counter() - start)
        if (seed - options.first) % max(1, count // 10) == 0:
            start = time.perf_counter()
            scene.texture  # noqa: B018
            baked.append(time.perf_counter() - start)
        found = problems(scene)
        failures += bool(found)
        for line in found:
            print(f"seed {seed}: {line}")
        triangles.append(len(scene.faces))
        areas.append(float(np.prod((scene.bounds[1] - scene.bounds[0])[:2])))
    total = float(np.mean(made) + np.mean(baked))
    print(f"{'seeds':<28}{count:>10}\n{'failures':<28}{failures:>10}")
    for label, values, unit in (
        ("generate + mesh", made, "s"),
        ("bake", baked, "s"),
        ("triangles", triangles, ""),
        ("bounding area", areas, "m2"),
    ):
        print(
            f"{label:<28}{np.mean(values):>10.2f} mean {np.min(values):>10.2f} min {np.max(values):>10.2f} max {unit}"
        )
    print(json.dumps({"seeds": count, "failures": failures, "seconds_per_scene": round(total, 3)}))


if __name__ == "__main__":
    main()
