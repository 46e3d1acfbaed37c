"""Time and memory of ``autonerf-lab demo`` in a process of its own.

    python benchmarks/pipeline.py            # the fast preset: minutes
    python benchmarks/pipeline.py --quick    # the smoke preset

Prints a table of the stages and, as its last line, one JSON object. A run with the preset smoke compiles the kernels
first and is not measured.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path


def demo(preset: str, scene: str, out: Path) -> float:
    """Run the demo and return its wall-clock time, s."""
    command = [
        sys.executable,
        "-m",
        "autonerf_lab.cli",
        "demo",
        "--preset",
        preset,
        "--scene",
        scene,
        "--out",
        str(out),
    ]
    started = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - started


def main() -> None:
    """Run the benchmark and print the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="use the preset smoke")
    parser.add_argument("--scene", default="val-0")
    arguments = parser.parse_args()
    preset = "smoke" if arguments.quick else "fast"
    with tempfile.TemporaryDirectory() as folder:
        first = demo("smoke", arguments.scene, Path(folder) / "warm")
        seconds = demo(preset, arguments.scene, Path(folder) / "run")
        run = json.loads((Path(folder) / "run" / "run.json").read_text())
        scores = json.loads((Path(folder) / "run" / "scores.json").read_text())["scores"]
    print(f"{arguments.scene}, {preset}; the previous smoke run took {first:.1f} s, including compilation")
    print(f"{'stage':<10}{'seconds':>9}{'peak GB':>9}")
    for stage, row in run["stages"].items():
        print(f"{stage:<10}{row['seconds']:9.1f}{row['peak_gb']:9.2f}")
    print(f"{'process':<10}{seconds:9.1f}")
    for row in scores:
        if row["metric"] in ("psnr", "per_class_accuracy", "free_precision", "free_recall", "depth_median_error_m"):
            print(f"{row['task']} {row['metric']}: {row['value']:.3f} {row['unit']}")
    print(
        json.dumps(
            {
                "demo_s": round(seconds, 1),
                "fit_s": round(run["stages"]["fit"]["seconds"], 1),
                "peak_gb": max(row["peak_gb"] for row in run["stages"].values()),
            }
        )
    )


if __name__ == "__main__":
    main()
