"""One cell of a grid: explore, fit, evaluate, in a run folder that any other command understands."""

import contextlib
import io
import re
import shutil
import time
import traceback
from dataclasses import replace
from pathlib import Path

from PIL import Image

from autonerf_lab import pipeline
from autonerf_lab.benchmark.grid import Cell, label
from autonerf_lab.benchmark.results import OK, Outcome, Results, load_results
from autonerf_lab.config import preset
from autonerf_lab.errors import DataError
from autonerf_lab.evaluators import Scores
from autonerf_lab.evaluators.lpips import Lpips
from autonerf_lab.pipeline.run_folder import load_run, locked
from autonerf_lab.types import Score
from autonerf_lab.utils import resources, storage

PICTURES = {"walk": ("explore", "from_above"), "rendering": ("evaluate", "comparison"), "maps": ("evaluate", "overlay")}
PICTURE_WIDTH = 900


def run_cell(cell: Cell, out: Path, keep: bool = False, lpips: str | None = None) -> str:
    """Run a cell, or what is left of it, and write its outcome.

    Args:
        cell: of the grid of ``out``.
        out: the results folder.
        keep: leave everything that was made in ``runs/CELL``; else only scores and small pictures stay.
        lpips: the file of its weights; it is not measured without.

    Returns:
        The status. Whatever goes wrong inside a cell is one: it is written down, with the reason.

    Raises:
        DataError: no space is left: nothing more can be written down.
        RunFolderError: the grid was begun by another version of the package.
    """
    results = load_results(out, to_run=True)
    with locked(results.work(cell), wait=True):  # one that lost its parent a moment ago may not know yet
        done = results.read(cell)
        if done is None:
            done = _attempt(cell, results, keep, lpips)
            results.write(done)
        if done.finished:
            shutil.rmtree(results.work(cell), ignore_errors=True)
        return done.status


def _attempt(cell: Cell, results: Results, keep: bool, lpips: str | None) -> Outcome:
    resources.forget_peak()  # of the cell that this process ran before
    folder = results.kept(cell) if keep else results.work(cell) / "run"
    try:
        return _run(cell, results, folder, keep, lpips)
    except Exception as error:  # a grid must survive one odd cell
        if storage.out_of_space(error):
            raise DataError(f"{error}; what is finished stays, and the same command goes on") from error
        with contextlib.suppress(OSError):  # the log is on the same disk: words are worth less than the outcome
            traceback.print_exc()
        if isinstance(error, MemoryError):
            return Outcome(cell, f"oom: {error}")
        kind = "oom" if re.search("not enough memory|out of memory|allocate", str(error)) else "failed"
        return Outcome(cell, f"{kind}: {type(error).__name__}: {error}")


def _run(cell: Cell, results: Results, folder: Path, keep: bool, lpips: str | None) -> Outcome:
    if not ((folder / "run.json").exists() and load_run(folder).finished("evaluate")):
        weights = None if lpips is None else Lpips(lpips, results.lpips)
        pictures = None if keep else [picture for _, picture in PICTURES.values()]
        options = pipeline.Options(weights, baselines=False, optional=cell.optional, pictures=pictures)
        pipeline.begin(
            folder, cell.scene, cell.policy, cell.preset, cell.start, cell.model, "evaluate", options=options
        )  # fmt: skip
    run = load_run(folder)
    started = time.perf_counter()
    walked = folder / "exploration.json"
    if not walked.exists():
        from autonerf_lab.evaluators.exploration import walk_scores

        work = pipeline.Workspace(run)
        rows, curves = walk_scores(work.trajectory, work.scene, preset(cell.preset), results.path / "scenes")
        storage.write_json(folder / "curves.json", curves)
        Scores(rows).save(walked)
    for name, (stage, picture) in PICTURES.items():
        _shrink(run / f"figures/{stage}_{picture}.png", results.path / "pictures" / f"{cell.name}_{name}.webp")
    last = {"seconds": round(time.perf_counter() - started, 3), "peak_gb": resources.peak_gb()}
    scores = tuple(_signed(row, cell) for row in [*Scores.load(run / "scores.json"), *Scores.load(walked)])
    return Outcome(cell, OK, scores, {**run.stages, "exploration": last}, storage.read_json(folder / "curves.json"))


def _signed(row: Score, cell: Cell) -> Score:
    policy = label(cell.policy)
    return replace(
        row, scene=label(cell.scene), start=cell.start, policy=policy, reward=policy.partition("-")[2],
        model=cell.model, preset=cell.preset, seed=cell.start,
    )  # fmt: skip


def _shrink(source: Path, target: Path) -> None:
    with Image.open(source) as image:
        small = image.convert("RGB")
    small.thumbnail((PICTURE_WIDTH, 4 * PICTURE_WIDTH))
    data = io.BytesIO()
    small.save(data, "WEBP", quality=80)
    storage.write_bytes(target, data.getvalue())
