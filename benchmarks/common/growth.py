"""Training time to a given PSNR, as a function of floor area and of the number of training views."""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from common.output import write_csv
from common.training import Stopwatch, compile_kernels, in_fresh_process, in_training
from common.views import floor_area, read_views, write_views

from autonerf_lab.evaluators.rendering import psnr
from autonerf_lab.nerf import NeRF, fit
from autonerf_lab.nerf.models.semantic_nerfacto import SETTINGS
from autonerf_lab.nerf.settings import Settings
from autonerf_lab.scenes.generator import generate_spec

GOAL = 27.0  # dB
EVERY = 4.0  # seconds of training between two evaluations
COUNTS = (100, 200, 400, 600, 1200)  # training views
AXES = {"area": ("area_m2", "floor area [m²]"), "views": ("views", "training views")}


class ReachedError(Exception):
    """The goal is reached; raised by the callback to stop the training."""


def seconds_to(folder: Path, settings: Settings, goal: float, horizon: float, count: int) -> dict[str, Any]:
    """Train on the first ``count`` views until the mean PSNR of the test views reaches ``goal`` dB.

    All trainings share one learning-rate schedule of about ``horizon`` seconds; a schedule adapted to each result would
    be faster.

    Returns:
        ``seconds``, interpolated between two evaluations, None if the goal was not reached; ``psnr``, the best value.
    """
    train, test = read_views(folder, count)
    compile_kernels(train, settings, "semantic-nerfacto")
    measured = [(0.0, 0.0)]  # seconds, PSNR

    def measure(field: NeRF) -> float:
        images = [np.clip(field.render(c2w).rgb, 0, 1) for c2w in test.poses]
        decibel = float(np.mean([psnr(image, truth / 255) for image, truth in zip(images, test.rgb, strict=True)]))
        measured.append((watch.seconds, decibel))
        return decibel

    def evaluate(step: int, model: Any) -> None:
        if measure(in_training(model, train)) >= goal:
            raise ReachedError

    # More marks than the schedule has, in case steps take longer than measured.
    watch = Stopwatch(tuple(np.arange(EVERY, 4 * horizon, EVERY)), evaluate)
    seconds = None
    try:
        # Only the returned field has the average of the parameters.
        if measure(fit(train, settings=settings, progress=False, callback=watch)) >= goal:
            raise ReachedError
    except ReachedError:
        (t0, before), (t1, after) = measured[-2:]
        seconds = t0 + (t1 - t0) * (goal - before) / (after - before)
    return {"seconds": seconds, "psnr": max(decibel for _, decibel in measured)}


def spread_apartments(count: int, seeds: int) -> list[str]:
    """Return generated apartments with floor areas evenly spread between 40 and 140 m²."""
    areas = {f"apartment-{seed}": floor_area(generate_spec(seed)) for seed in range(seeds)}
    wanted = np.linspace(40, 140, count)
    return list(dict.fromkeys(min(areas, key=lambda name: abs(areas[name] - area)) for area in wanted))


def growth(options: argparse.Namespace, step_ms: float, folder: Path) -> dict[str, Any]:
    """Measure, print, and write ``growth.csv`` and ``growth.png``; return the values of the JSON."""
    scenes = spread_apartments(2, 6) if options.quick else spread_apartments(6, 60)
    counts = (50, 150) if options.quick else COUNTS
    goal, horizon = (15.0 if options.quick else GOAL), options.growth_seconds
    settings = replace(SETTINGS["fast"], steps=round(1000 * horizon / step_ms))
    print(f"Seconds to {goal:g} dB within a schedule of {settings.steps} steps, planned as {horizon:g} s")
    rows = []
    studies = [("area", name, options.views) for name in scenes]
    studies += [("views", options.scenes[0], count) for count in counts]
    areas: dict[str, float] = {}
    for study, name, count in studies:
        path = folder / f"{study}-{name}"
        if not path.exists():  # smaller counts use the first views of a larger set
            largest = max(counts) if study == "views" else count
            made = in_fresh_process(options.threads, write_views, name, path, largest, options.test_views)
            areas[name] = made["area_m2"]
        found = in_fresh_process(options.threads, seconds_to, path, settings, goal, horizon, count)
        found = {key: value and round(value, 2) for key, value in found.items()}
        rows.append({"study": study, "scene": name, "area_m2": round(areas[name], 1), "views": count, **found})
        reached = "not reached" if found["seconds"] is None else f"{found['seconds']:.1f} s"
        print(f"  {name}, {areas[name]:.0f} m2, {count} views: {reached}, best {found['psnr']:.2f} dB", flush=True)
    write_csv(options.out / "growth.csv", rows)
    draw_growth(rows, goal, horizon, options.out / "growth.png")
    values: dict[str, Any] = {"goal_db": goal, "horizon_s": horizon}
    for study, (key, _) in AXES.items():
        values[f"seconds_by_{study}"] = [[row[key], row["seconds"]] for row in rows if row["study"] == study]
    return values


def draw_growth(rows: list[dict[str, Any]], goal: float, horizon: float, path: Path) -> None:
    """Plot seconds over area and over views; a cross marks a training that did not reach the goal."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(10, 3.8), sharey=True, layout="constrained")
    for ax, (study, (key, label)) in zip(axes, AXES.items(), strict=True):
        here = [row for row in rows if row["study"] == study]
        there = [row for row in here if row["seconds"] is not None]
        ax.plot([row[key] for row in there], [row["seconds"] for row in there], "o-")
        missed = [row for row in here if row["seconds"] is None]
        ax.plot([row[key] for row in missed], [horizon] * len(missed), "x", color="tab:red", label="not reached")
        fixed = f"{here[0]['views']} views" if study == "area" else f"{here[0]['scene']}, {here[0]['area_m2']:.0f} m²"
        ax.set(xlabel=label, title=fixed)
        ax.grid(alpha=0.3)
        if missed:
            ax.legend(loc="lower right")
    axes[0].set_ylim(0, 1.05 * max(row["seconds"] or horizon for row in rows))
    axes[0].set_ylabel(f"seconds of training to {goal:g} dB")
    figure.savefig(path, dpi=110)
