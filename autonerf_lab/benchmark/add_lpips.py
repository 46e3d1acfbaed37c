"""LPIPS of finished cells whose fields are saved, without training them again."""

from collections.abc import Iterable
from dataclasses import replace
from itertools import chain
from typing import Any

from tqdm import tqdm

from autonerf_lab.benchmark.fingerprint import LPIPS
from autonerf_lab.benchmark.results import Results, load_results
from autonerf_lab.errors import RunFolderError
from autonerf_lab.evaluators.evaluation import evaluate
from autonerf_lab.evaluators.lpips import Lpips
from autonerf_lab.pipeline.context import StageContext
from autonerf_lab.pipeline.run_folder import load_run, locked
from autonerf_lab.types import Score
from autonerf_lab.utils import storage


def add_lpips(results: Results, lpips: Lpips, progress: bool = True) -> Results:
    """Compute LPIPS for the cells of a grid that was run with ``save_runs`` and without LPIPS.

    The test views are rendered again from the saved fields, and by the baselines that the cells have; all other scores
    stay. After an interruption, the same call continues.

    Args:
        results: results with saved runs.
        lpips: network with its weights.
        progress: show a progress bar.

    Returns:
        The results with the weights in their fingerprint.

    Raises:
        RunFolderError: a finished cell has no saved run, or the cells have LPIPS of other weights.
        DataError: a file is damaged or cannot be written.
    """
    with locked(results.path):
        return _add(load_results(results.path), lpips, progress)


def _add(results: Results, lpips: Lpips, progress: bool) -> Results:
    if results.lpips not in (None, lpips.sha256):
        raise RunFolderError(
            f"{results.path} has LPIPS of the weights {results.lpips}, not {lpips.sha256}; give the same file"
        )
    todo = [
        outcome
        for outcome in results.outcomes()
        if any(_is_lpips(row) and row.value is None for row in chain(outcome.scores, *outcome.baselines.values()))
    ]
    for outcome in todo:  # before the first of many minutes
        if not (results.saved_run(outcome.cell) / "run.json").exists():
            raise RunFolderError(
                f"{results.path} does not hold the field of {outcome.cell.name}; run the grid with --save-runs or "
                "--lpips-weights"
            )
    # First, so that a continued call cannot mix weights.
    content = storage.read_json(results.path / "grid.json", dict[str, Any])
    content["grid"]["weights"] = {**content["grid"].get("weights", {}), LPIPS: lpips.sha256}
    storage.write_json(results.path / "grid.json", content)
    for outcome in tqdm(todo, desc="lpips", disable=not progress, unit="cell"):
        context = StageContext(load_run(results.saved_run(outcome.cell)))
        found = evaluate(
            context.nerf, context.scene, context.preset, outcome.cell.start, ["rendering"], progress=False,
            trajectory=context.trajectory if outcome.baselines else None, lpips_weights=lpips,
            oracle="oracle" in outcome.baselines,
        )  # fmt: skip
        baselines = {name: _with_lpips(rows, found.baselines.get(name, ())) for name, rows in outcome.baselines.items()}
        results.write(replace(outcome, scores=_with_lpips(outcome.scores, found), baselines=baselines))
    return load_results(results.path)


def _with_lpips(rows: Iterable[Score], found: Iterable[Score]) -> tuple[Score, ...]:
    """Return scores with the LPIPS of others, if these have one."""
    new = next(filter(_is_lpips, found), None)
    return tuple(
        replace(row, value=new.value, status=new.status) if new is not None and _is_lpips(row) else row for row in rows
    )


def _is_lpips(row: Score) -> bool:
    return (row.task, row.metric) == ("rendering", "lpips")
