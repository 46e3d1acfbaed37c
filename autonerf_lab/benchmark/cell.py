"""Run one cell of a grid: explore, fit and evaluate in a run folder."""

import contextlib
import io
import shutil
import time
import traceback
from dataclasses import replace
from pathlib import Path
from typing import cast

from PIL import Image

from autonerf_lab import pipeline
from autonerf_lab.benchmark.grid import Cell, label
from autonerf_lab.benchmark.results import OK, Outcome, Results, StageCost, load_results
from autonerf_lab.errors import DataError
from autonerf_lab.evaluators import Scores
from autonerf_lab.pipeline.run_folder import load_run, locked
from autonerf_lab.presets import preset
from autonerf_lab.types import Score
from autonerf_lab.utils import resources, storage

# figure of a cell -> stage and name of the figure of the run
FIGURES = {
    "trajectory": ("explore", "from_above"),
    "rendering": ("evaluate", "comparison"),
    "maps": ("evaluate", "overlay"),
    "paths": ("evaluate", "paths"),
    "drift": ("explore", "drift"),  # only with noise
}
FIGURE_WIDTH = 900  # pixels
_NAMED_BY_REWARD = ("modular", "paper", "e2e", "oracle")  # families of policies


def run_cell(cell: Cell, out: Path, save_run: bool = False, lpips: str | None = None, device: str | None = None) -> str:
    """Run or continue a cell and write its outcome.

    Args:
        cell: Cell of the grid of ``out``.
        out: Results folder.
        save_run: Save the run folder in ``runs/CELL``; otherwise only scores and small figures are saved.
        lpips: File of the LPIPS weights; None: LPIPS is not computed.
        device: Torch device of the field; None: compiled kernels on the CPU.

    Returns:
        Status of the cell. An error inside the cell is recorded as its status, with the reason.

    Raises:
        DataError: The disk is full.
        RunFolderError: The results folder was made by another version of the package.
    """
    results = load_results(out, to_run=True)
    with locked(results.work_folder(cell), wait=True):  # a worker of a killed process may still be running
        done = results.read(cell)
        if done is None:
            done = _attempt(cell, results, save_run, lpips, device)
            results.write(done)
        if done.finished:
            shutil.rmtree(results.work_folder(cell), ignore_errors=True)
        return done.status


def _attempt(cell: Cell, results: Results, save_run: bool, lpips: str | None, device: str | None) -> Outcome:
    resources.reset_peak()  # discard the peak of the previous cell of this process
    folder = results.saved_run(cell) if save_run else results.work_folder(cell) / "run"
    try:
        return _run(cell, results, folder, save_run, lpips, device)
    except Exception as error:  # one failed cell must not stop the grid
        if storage.is_disk_full(error):
            raise DataError(f"{error}; finished cells are saved, run the same command again to continue") from error
        with contextlib.suppress(OSError):  # the log may be on a full disk; the outcome is more important
            traceback.print_exc()
        kind = "oom" if resources.is_out_of_memory(error) else "failed"
        return Outcome(cell, f"{kind}: {type(error).__name__}: {error}")


def _run(cell: Cell, results: Results, folder: Path, save_run: bool, lpips: str | None, device: str | None) -> Outcome:
    if not ((folder / "run.json").exists() and load_run(folder).finished("evaluate")):
        weights = None
        if lpips is not None:
            from autonerf_lab.evaluators.lpips import Lpips  # imports torch

            weights = Lpips(lpips, results.lpips)
        figures = None if save_run else [figure for _, figure in FIGURES.values()]
        options = pipeline.StageOptions(
            weights, device, cell.baselines, cell.baselines, optional_tasks=cell.optional, figures=figures
        )
        pipeline.run_pipeline(
            folder, cell.scene, cell.policy, cell.preset, cell.start, cell.model, "evaluate", options=options,
            **cell.conditions,
        )  # fmt: skip
    run = load_run(folder)
    started = time.perf_counter()
    exploration = folder / "exploration.json"
    if not exploration.exists():
        from autonerf_lab.evaluators.exploration import trajectory_scores

        context = pipeline.StageContext(run)
        rows, curves = trajectory_scores(
            context.trajectory, context.scene, preset(cell.preset), results.path / "scenes"
        )
        storage.write_json(folder / "curves.json", curves)
        Scores(rows).save(exploration)
    for name, (stage, figure) in FIGURES.items():
        source = run / f"figures/{stage}_{figure}.png"
        if name != "drift" or source.exists():
            _shrink(source, results.path / "figures" / f"{cell.name}_{name}.webp")
    stages = cast("dict[str, StageCost]", dict(run.stages))
    stages["exploration"] = StageCost(seconds=round(time.perf_counter() - started, 3), peak_gb=resources.peak_gb())
    found = Scores.load(run / "scores.json")
    scores = _labelled(cell, found, Scores.load(exploration))
    baselines = {file.stem: _labelled(cell, Scores.load(file)) for file in sorted((run / "baselines").glob("*.json"))}
    curves = storage.read_json(folder / "curves.json", dict[str, list[float]])
    return Outcome(cell, OK, scores, stages, curves, baselines, found.details)


def _labelled(cell: Cell, *scores: Scores) -> tuple[Score, ...]:
    policy = label(cell.policy)
    return tuple(
        replace(
            row, scene=label(cell.scene), start=cell.start, policy=policy, reward=reward_of(policy),
            model=cell.model, preset=cell.preset, seed=cell.start,
        )
        for rows in scores
        for row in rows
    )  # fmt: skip


def reward_of(policy: str) -> str:
    """Return the reward that a policy is named by; empty for other names.

    Example:
        >>> reward_of("modular-obs"), reward_of("oracle-view"), reward_of("frontier-classic")
        ('obs', 'view', '')
    """
    family, _, reward = policy.partition("-")
    return reward if family in _NAMED_BY_REWARD else ""


def _shrink(source: Path, target: Path) -> None:
    with Image.open(source) as image:
        small = image.convert("RGB")
    small.thumbnail((FIGURE_WIDTH, 4 * FIGURE_WIDTH))
    data = io.BytesIO()
    small.save(data, "WEBP", quality=80)
    storage.write_bytes(target, data.getvalue())
