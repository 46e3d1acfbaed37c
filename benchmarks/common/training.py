"""Measured trainings: single steps of several models side by side, and whole fits with evaluations in between."""

import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numba
import numpy as np
import torch
from common.views import read_views

from autonerf_lab.data.dataset import Dataset
from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.evaluators.rendering import evaluate_rendering, photographed_views
from autonerf_lab.nerf import fit
from autonerf_lab.nerf.fit import prepare, train_step
from autonerf_lab.nerf.model import Model
from autonerf_lab.nerf.models import model_spec
from autonerf_lab.nerf.radiance_field import NeRF
from autonerf_lab.nerf.ray_batch import assign, to_numpy
from autonerf_lab.nerf.settings import HashSettings, Settings
from autonerf_lab.nerf.visibility import VOXEL, Visibility
from autonerf_lab.utils.resources import peak_gb

NOTHING_SEEN = Visibility(np.zeros(3), VOXEL, np.zeros((1, 1, 1), bool))


def in_fresh_process(threads: int, function: Callable[..., Any], *args: Any, **options: Any) -> Any:
    """Return the result of a module-level function, called in a new process with a number of threads.

    Memory used before does not count towards the peak of the new process, as long as the caller itself stays small.
    """
    with ProcessPoolExecutor(1, get_context("spawn"), set_threads, (threads,)) as pool:
        return pool.submit(function, *args, **options).result()


def set_threads(count: int) -> None:
    """Set the number of threads of numba and torch."""
    numba.set_num_threads(count)
    torch.set_num_threads(count)


class Trainer:
    """Training of a model, one step at a time.

    Args:
        views: training views.
        settings: hyper-parameters.
        model: name of the model.
        device: None for the kernels, or a torch device.
    """

    def __init__(
        self, views: Trajectory, settings: Settings, model: str = "semantic-nerfacto", device: str | None = None
    ):
        data = Dataset.from_trajectory(views)
        self.state, self.pixels = prepare(data, model_spec(model), settings, device=device)
        self.model = self.state.model
        self.settings = self.model.settings

    def step(self) -> dict[str, float]:
        """Do one training step of ``fit`` at the initial learning rate, and return the losses."""
        train_step(self.state, self.pixels, self.settings.warmup)
        return self.state.losses

    def copy_state(self, other: "Trainer") -> None:
        """Copy parameters, optimiser and random state of another training of the same model."""
        mine, theirs = self.state.optimizer, other.state.optimizer
        groups = [(self.model.state, other.model.state)]
        groups += [(getattr(mine, key), getattr(theirs, key)) for key in ("parameters", "first", "second")]
        for target, source in groups:
            for name in target:
                assign(target[name], to_numpy(source[name]))
        mine.steps.update(theirs.steps)
        self.state.rng.bit_generator.state = other.state.rng.bit_generator.state

    def active_share(self) -> float:
        """Return the share of samples whose weight exceeds ``min_weight``."""
        rays = self.pixels.rays(self.pixels.sample(self.settings.rays, np.random.default_rng(0)))
        samples = self.model.sampler.sample(rays, np.full(len(rays), 0.5, np.float32))
        weights = self.model.field.render(rays, samples).weights
        assert isinstance(self.settings, HashSettings)
        return float((weights > self.settings.min_weight).mean())


def training_speed(folder: Path, settings: Settings, model: str, warm_up: int) -> tuple[float, float]:
    """Return how long a training step takes after ``warm_up`` steps, with views of a folder, and how long the start.

    Returns:
        Milliseconds per step, and the seconds by which the preparation and the first ``warm_up`` steps, in which more
        samples are active, take longer than that.
    """
    views = read_views(folder, depth=settings.depth_weight > 0)[0]
    compile_kernels(views, settings, model)
    started = time.perf_counter()
    trainer = Trainer(views, settings, model)
    for _ in range(warm_up):
        trainer.step()
    passed = time.perf_counter() - started
    # 16 steps, because the occupancy grid is updated every 16 steps and the proposals every 2
    step = interleaved({model: (trainer.step, 16)}, 7)[model]
    return step, passed - warm_up * step / 1000


def interleaved(steps: dict[str, tuple[Callable[[], object], int]], rounds: int) -> dict[str, float]:
    """Return the milliseconds per call of several functions, measured in turns, so that other load affects all alike.

    Args:
        steps: function and number of calls per turn, large enough to contain work that is done every few steps.
        rounds: number of turns, of which the fastest counts, as in ``timeit``.
    """
    times: dict[str, list[float]] = {name: [] for name in steps}
    for _ in range(rounds):
        for name, (step, repeats) in steps.items():
            started = time.perf_counter()
            for _ in range(repeats):
                step()
            times[name].append(1000 * (time.perf_counter() - started) / repeats)
    return {name: min(values) for name, values in times.items()}


class Stopwatch:
    """Callback of ``fit`` that measures the seconds of a training and evaluates the model at given times.

    Args:
        marks: increasing times of the evaluations, seconds of training.
        evaluate: called with the step and the model at each mark; its duration is not counted.
    """

    def __init__(self, marks: tuple[float, ...], evaluate: Callable[[int, Model], None]) -> None:
        self.marks, self.evaluate = list(marks), evaluate
        self.seconds, self.step = 0.0, 0
        self.mark: float | None = None  # the mark under evaluation
        self._started, self._paused = time.perf_counter(), 0.0

    def __call__(self, step: int, model: Model) -> None:
        """Update the clock, and evaluate if a mark has passed."""
        arrived = time.perf_counter()
        self.seconds, self.step = arrived - self._started - self._paused, step
        while self.marks and self.marks[0] <= self.seconds:
            self.mark = self.marks.pop(0)
            if not self.marks or self.marks[0] > self.seconds:  # if one step passes several marks, the last
                self.evaluate(step, model)
        self._paused += time.perf_counter() - arrived


def compile_kernels(train: Trajectory, settings: Settings, model: str) -> None:
    """Compile the kernels, so that the time of compilation is not measured."""
    fit(train, model, settings=replace(settings, steps=2, seen_rays=4096), progress=False)


def fit_and_score(
    folder: Path, settings: Settings, marks: tuple[float, ...] = (), model: str = "semantic-nerfacto", seed: int = 0,
) -> dict[str, Any]:  # fmt: skip
    """Fit a model to the views of a folder and evaluate it on the test views, at marks and at the end.

    Returns:
        ``rows``, one per evaluation: ``mark_s`` (None at the end), ``seconds`` and ``step`` of the training, and the
        scores; ``render_fps``, frames per second at 128x128; ``peak_gb``, memory of the process.
    """
    train, test = read_views(folder, depth=settings.depth_weight > 0)
    compile_kernels(train, settings, model)
    rows: list[dict[str, Any]] = []
    test_views = Dataset.from_trajectory(test)

    def score(field: NeRF, mark: float | None) -> None:
        scores = evaluate_rendering(field, photographed_views(test_views)).values
        rows.append({"mark_s": mark, "seconds": watch.seconds, "step": watch.step, **scores})

    watch = Stopwatch(marks, lambda step, model: score(in_training(model, train), watch.mark))
    nerf = fit(train, model, settings=settings, seed=seed, progress=False, callback=watch)
    score(nerf, None)
    times = []
    for c2w in test.poses:
        started = time.perf_counter()
        nerf.render(c2w)
        times.append(time.perf_counter() - started)
    return {"rows": rows, "render_fps": 1 / float(np.median(times)), "peak_gb": peak_gb()}


def in_training(model: Model, train: Trajectory) -> NeRF:
    """Return a model in training as a field."""
    return NeRF(model, train.poses, train.intrinsics, NOTHING_SEEN, train.meta)
