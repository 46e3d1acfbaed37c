"""LPIPS of finished cells whose fields are saved, without training them again."""

from dataclasses import replace
from typing import Any

from tqdm import tqdm

from autonerf_lab.benchmark.fingerprint import LPIPS
from autonerf_lab.benchmark.results import Results, load_results
from autonerf_lab.errors import RunFolderError
from autonerf_lab.evaluators.evaluation import evaluate
from autonerf_lab.evaluators.lpips import Lpips
from autonerf_lab.pipeline.context import StageContext
from autonerf_lab.pipeline.run_folder import load_run
from autonerf_lab.types import Score
from autonerf_lab.utils import storage


def add_lpips(results: Results, lpips: Lpips, progress: bool = True) -> Results:
    """Compute LPIPS for the cells of a grid that was run with ``save_runs`` and without LPIPS.

    The test views are rendered again from the saved fields; all other scores stay. After an interruption, the same call
    continues.

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
    if results.lpips not in (None, lpips.sha256):
        raise RunFolderError(
            f"{results.path} has LPIPS of the weights {results.lpips}, not {lpips.sha256}; give the same file"
        )
    todo = [o for o in results.outcomes() for row in o.scores if _is_lpips(row) and row.value is None]
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
            lpips_weights=lpips, oracle=False,
        )  # fmt: skip
        (row,) = filter(_is_lpips, found)
        scores = [replace(old, value=row.value, status=row.status) if _is_lpips(old) else old for old in outcome.scores]
        results.write(replace(outcome, scores=tuple(scores)))
    return load_results(results.path)


def _is_lpips(row: Score) -> bool:
    return (row.task, row.metric) == ("rendering", "lpips")
