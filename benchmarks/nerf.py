"""Speed and quality of Semantic Nerfacto on two cores, compared with plain torch and with the arithmetic limit.

    python benchmarks/nerf.py                                       # all development scenes: about an hour
    python benchmarks/nerf.py --scenes dev-0 --seconds 5 --no-fast  # a minute or two
    python benchmarks/nerf.py --quick                               # the same, with fewer views
    python benchmarks/nerf.py --growth                              # seconds to 27 dB, by area and by views

Training step: the fused kernels, and the same model in vectorised torch on the same samples and threads, measured in
turns; the kernels should take at most a tenth of torch's time. Limit: the operations of the architecture (formulas in
benchmarks/common/operations.py) at the rate of a large matrix product in the same run; the step should take at most
twice that.

Quality: views are uniform over the scene. There is one fit with the number of steps of the preset, and one fit for
each of ``--seconds``, with the number of steps that takes so long: a fit that is cut short would not complete its
learning-rate schedule. ``--steps`` fits with given numbers of steps, which gives the same fields on any machine.
Models with -rgbd also train on depth. Seconds count the whole of ``fit`` without the evaluations. The baseline shows
the nearest training view. Each fit runs in its own process.

Prints tables and, as the last line, one JSON object, which is also written to ``--out`` with a CSV and a figure.
"""

import argparse
import json
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from common.growth import growth
from common.operations import describe, step_operations, total_operations
from common.output import mean_of, write_csv
from common.training import (
    Trainer,
    fit_and_score,
    in_fresh_process,
    interleaved,
    training_speed,
)
from common.views import read_views, write_views

from autonerf_lab.classes import NUM_CLASSES
from autonerf_lab.nerf.models import MODELS
from autonerf_lab.nerf.models.semantic_nerfacto import SETTINGS
from autonerf_lab.nerf.settings import ProposalSettings
from autonerf_lab.scenes import scene_names

MARKS = (5, 10, 20, 40, 60, 120, 300)  # seconds of training at which a field is evaluated
SIDE = 2048  # size of the matrices whose product measures the arithmetic rate of the machine
PANELS = {
    "psnr": "PSNR [dB]",
    "per_class_accuracy": "per-class accuracy [%]",
    "depth_median_error_m": "median depth error [m]",
}


def measure_step(folder: Path, settings: ProposalSettings, rounds: int, warm_up: int) -> dict[str, float]:
    """Return the milliseconds of a step by kernels and by torch, from the same training state, and the limit."""
    views = read_views(folder)[0]
    kernels, reference = Trainer(views, settings), Trainer(views, settings, device="cpu")
    for _ in range(warm_up):
        kernels.step()
    reference.copy_state(kernels)
    all_samples = Trainer(views, replace(settings, min_weight=0.0))
    all_samples.copy_state(kernels)
    active = kernels.active_share()
    # The random numbers are equal, so the first losses must be equal, up to samples that the kernels skip.
    first = {name: t.step()["mse"] for name, t in (("all", all_samples), ("torch", reference))}
    a, b = torch.randn(SIDE, SIDE), torch.randn(SIDE, SIDE)
    product = torch.empty(SIDE, SIDE)
    products: list[float] = []

    def multiply() -> None:
        started = time.perf_counter()
        torch.mm(a, b, out=product)
        products.append(1000 * (time.perf_counter() - started))

    steps = {"kernels": kernels.step, "all": all_samples.step, "torch": reference.step, "multiply": multiply}
    every = settings.proposal_every  # steps between two updates of the proposals: each turn has as many
    repeats = {"kernels": 5 * every, "all": 2 * every, "torch": every, "multiply": 4}
    times = interleaved({name: (step, repeats[name]) for name, step in steps.items()}, rounds)
    rate = 2 * SIDE**3 / min(products)  # operations per millisecond
    return {
        "step_ms": times["kernels"],
        "all_samples_step_ms": times["all"],
        "reference_step_ms": times["torch"],
        "limit_step_ms": total_operations(step_operations(settings, NUM_CLASSES)) / rate,
        "active_limit_step_ms": total_operations(step_operations(settings, NUM_CLASSES, active)) / rate,
        "gflops": rate / 1e6,
        "active_share": active,
        "mse_difference": abs(first["all"] / first["torch"] - 1),
    }


def print_step(found: dict[str, float], settings: ProposalSettings, threads: int) -> None:
    """Print the measured step with its reference and its limit."""
    step = found["step_ms"]
    print(f"A training step, {threads} threads: {settings.rays} rays x {settings.samples} samples")
    print(f"  kernels                       {step:>9.1f} ms")
    print(f"  kernels, min_weight 0         {found['all_samples_step_ms']:>9.1f} ms")
    print(f"  torch                         {found['reference_step_ms']:>9.1f} ms")
    print(f"  ratio of torch to kernels     {found['reference_step_ms'] / step:>9.1f}    (target: at least 10)")
    print(f"  first loss of both differs by {found['mse_difference']:>9.1e}    (relative, min_weight 0)")
    print(describe(settings, NUM_CLASSES))
    print(f"  float32 product of {SIDE}x{SIDE} matrices: {found['gflops']:.0f} GFLOP/s")
    ratio = step / found["limit_step_ms"]
    print(f"  limit {found['limit_step_ms']:.1f} ms, the step takes {ratio:.1f} times that (target: at most 2)")
    print(
        f"  {100 * found['active_share']:.0f} % of the samples are active; the kernels skip the heads and the backward "
        f"pass of the others, so that their own limit is {found['active_limit_step_ms']:.1f} ms",
        flush=True,
    )


def learn_scene(
    folder: Path, model: str, fits: dict[str, int], speed: tuple[float, float], threads: int
) -> dict[str, dict]:
    """Run all fits of one model to one scene, and return the results by name; marks near the end are dropped."""
    found = {}
    step_ms, start = speed
    for name, steps in fits.items():
        marks = tuple(mark for mark in MARKS if mark < 0.9 * (start + steps * step_ms / 1000))
        settings = replace(MODELS[model].settings["fast"], steps=steps)
        found[name] = in_fresh_process(threads, fit_and_score, folder, settings, marks, model)
        last = found[name]["rows"][-1]
        print(
            f"  {model:<24}{name:<12}{last['step']:>7} steps {last['seconds']:>7.1f} s  PSNR {last['psnr']:.2f} dB  "
            f"per-class accuracy {last['per_class_accuracy']:.1f} %  "
            f"depth error {100 * last['depth_median_error_m']:.2f} cm",
            flush=True,
        )
    return found


def plot(rows: list[dict[str, Any]], path: Path) -> None:
    """Plot quality over seconds of training, one line per fit: mean over scenes, band from worst to best scene."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, len(PANELS), figsize=(13, 3.8), layout="constrained")
    scenes = sorted({row["scene"] for row in rows})
    for ax, (key, label) in zip(axes, PANELS.items(), strict=True):
        baseline = [row for row in rows if row["fit"] == "nearest view"]
        if key != "depth_median_error_m":
            ax.axhline(mean_of(baseline, key), color="grey", ls=":", label="nearest training view")
        for fit in dict.fromkeys(row["fit"] for row in rows if row["fit"] != "nearest view"):
            here = [row for row in rows if row["fit"] == fit]
            moments = [
                [row for row in here if row["mark_s"] == mark] for mark in dict.fromkeys(r["mark_s"] for r in here)
            ]
            values = [[row[key] for row in moment] for moment in moments]
            seconds = [mean_of(moment, "seconds") for moment in moments]
            (line,) = ax.plot(seconds, [np.mean(v) for v in values], "o-", ms=4, label=f"fit: {fit}")
            if len(scenes) > 1:
                ax.fill_between(
                    seconds, [min(v) for v in values], [max(v) for v in values], color=line.get_color(), alpha=0.12
                )
        ax.set(xscale="log", xlabel="seconds of training", ylabel=label)
        ticks = [mark for mark in MARKS if mark <= 1.1 * max(row["seconds"] or 0 for row in rows)]
        ax.set_xticks(ticks, [str(tick) for tick in ticks])
        ax.minorticks_off()
        ax.grid(alpha=0.3)
    axes[2].set(yscale="log")
    marks = [0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0]
    low, high = axes[2].get_ylim()
    axes[2].set_yticks([mark for mark in marks if low <= mark <= high])
    axes[2].yaxis.set_major_formatter("{x:g}")
    axes[2].yaxis.set_minor_formatter("")
    axes[0].legend(frameon=False, fontsize=8)
    figure.suptitle(f"{', '.join(scenes)}: mean and range of held-out views" if len(scenes) > 1 else scenes[0])
    figure.savefig(path, dpi=110)


def quality(options: argparse.Namespace, views: dict[str, Path], nearest: dict[str, dict]) -> dict:
    """Fit every scene, write ``nerf.csv`` and ``nerf.png``, and return the values of the JSON."""
    speed = {}
    for model in options.models:
        settings, warm_up = MODELS[model].settings["fast"], 30 if options.quick else 500
        speed[model] = in_fresh_process(
            options.threads, training_speed, views[options.scenes[0]], settings, model, warm_up
        )
        print(f"a step of {model} takes {speed[model][0]:.1f} ms, the start {speed[model][1]:.1f} s more")
    rows: list[dict[str, Any]] = []
    processes = []
    for scene, folder in views.items():
        print(f"{scene}, nearest view {nearest[scene]['psnr']:.2f} dB")
        scores = {key: value for key, value in nearest[scene].items() if key not in ("area_m2", "lpips")}
        scores["depth_median_error_m"] = None  # the training views have no depth
        rows.append({"scene": scene, "fit": "nearest view", "mark_s": None, "seconds": None, "step": None} | scores)
        for model in options.models:
            fits = {} if options.no_fast else {"fast": MODELS[model].settings["fast"].steps}
            step_ms, start = speed[model]
            fits |= {f"{s:g} s": max(1, round(1000 * (s - start) / step_ms)) for s in options.seconds}
            fits |= {f"{steps} steps": steps for steps in options.steps}
            for name, result in learn_scene(folder, model, fits, speed[model], options.threads).items():
                processes.append(result)
                scored = [{key: value for key, value in row.items() if key != "lpips"} for row in result["rows"]]
                label = name if model == "semantic-nerfacto" else f"{name}, {model}"
                rows += [{"scene": scene, "fit": label} | row for row in scored]
    write_csv(options.out / "nerf.csv", rows)
    plot(rows, options.out / "nerf.png")
    ends = [row for row in rows if row["mark_s"] is None]
    minute = [row for row in ends if row["fit"] == "60 s"]
    rgbd = [row for row in ends if row["fit"] == "60 s, semantic-nerfacto-rgbd"]
    return {
        "psnr_60s_rgbd": mean_of(rgbd, "psnr"),
        "depth_median_error_m_60s_rgbd": mean_of(rgbd, "depth_median_error_m"),
        "psnr_60s": mean_of(minute, "psnr"),
        "per_class_accuracy_60s": mean_of(minute, "per_class_accuracy"),
        "depth_median_error_m_60s": mean_of(minute, "depth_median_error_m"),
        "psnr_300s": mean_of([row for row in ends if row["fit"] == "300 s"], "psnr"),
        "nearest_view_psnr": mean_of([row for row in ends if row["fit"] == "nearest view"], "psnr"),
        "render_fps": mean_of(processes, "render_fps"),
        "peak_gb": max((p["peak_gb"] for p in processes if p["peak_gb"]), default=None),
    }


def arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", nargs="+", default=scene_names("dev"), help="Names of scenes.")
    parser.add_argument("--seconds", nargs="*", type=float, default=[60, 300], help="Durations of fits, seconds.")
    parser.add_argument("--steps", nargs="*", type=int, default=[], help="Numbers of steps of further fits.")
    parser.add_argument(
        "--models", nargs="+", default=["semantic-nerfacto", "semantic-nerfacto-rgbd"], help="Names of models."
    )
    parser.add_argument("--no-fast", action="store_true", help="Skip the fit of the preset.")
    parser.add_argument("--views", type=int, default=600, help="Training views per scene.")
    parser.add_argument("--test-views", type=int, default=60, help="Test views per scene.")
    parser.add_argument("--threads", type=int, default=2, help="Number of threads.")
    parser.add_argument("--growth", action="store_true", help="Measure the seconds to 27 dB instead.")
    parser.add_argument("--growth-seconds", type=float, default=180, help="Schedule of --growth, seconds.")
    parser.add_argument("--out", type=Path, default=Path("runs/bench-nerf"), help="Output folder.")
    parser.add_argument("--quick", action="store_true", help="One scene, few views, five seconds.")
    options = parser.parse_args()
    if options.quick:
        options.scenes, options.seconds, options.no_fast = options.scenes[:1], [5], True
        options.views, options.test_views, options.growth_seconds = 150, 8, 6
    return options


def main() -> None:
    """Measure, print and write the results."""
    options = arguments()
    options.out.mkdir(parents=True, exist_ok=True)
    settings = SETTINGS["fast"]
    rounds, warm_up = (3, 30) if options.quick else (7, settings.steps // 4)
    with tempfile.TemporaryDirectory() as folder:
        views = {scene: Path(folder) / scene for scene in (options.scenes[:1] if options.growth else options.scenes)}
        nearest = {
            scene: in_fresh_process(options.threads, write_views, scene, path, options.views, options.test_views)
            for scene, path in views.items()
        }
        step = in_fresh_process(options.threads, measure_step, views[options.scenes[0]], settings, rounds, warm_up)
        print_step(step, settings, options.threads)
        values: dict[str, Any] = {key: step[key] for key in ("step_ms", "reference_step_ms", "limit_step_ms")}
        values |= growth(options, step["step_ms"], Path(folder)) if options.growth else quality(options, views, nearest)
    values = {key: round(value, 3) if isinstance(value, float) else value for key, value in values.items()}
    (options.out / ("growth.json" if options.growth else "nerf.json")).write_text(json.dumps(values, indent=2) + "\n")
    print(f"figure and tables: {options.out}/")
    print(json.dumps(values))


if __name__ == "__main__":
    main()
