"""Fake cells with prescribed behaviour, for tests of the code that runs cells."""

import errno
import os
import signal
import threading
import time
import zlib
from pathlib import Path
from typing import Any

from autonerf_lab.benchmark import paper
from autonerf_lab.benchmark.grid import Cell, label
from autonerf_lab.benchmark.results import Outcome, load_results
from autonerf_lab.errors import DataError
from autonerf_lab.types import Score
from autonerf_lab.utils.storage import read_json

FUNCTION = "fake_cell:run"
METRICS = (*paper.RENDERING, *paper.MAPS, *paper.PLANNING, *paper.POSE, *paper.CORRELATED[-2:], *paper.MESH)
KEYS = [*(metric.key for metric in METRICS), *(("reward", name) for name in ("cov", "obs", "sem", "view"))]


def scores_of(cell: Cell) -> tuple[Score, ...]:
    """Return scores that depend on the cell only: an offset per policy and scene, plus noise."""
    base = {"random": 0.0, "frontier": 5.0}.get(cell.policy, 8.0) - 3.0 * int(cell.scene[-1])
    rows = []
    for task, metric in KEYS:
        noise = zlib.crc32(f"{cell.name} {metric}".encode()) % 100 / 100
        value, status = (None, "weights_missing") if metric == "lpips" else (base + 20 + noise, "ok")
        where = {"scene": label(cell.scene), "start": cell.start, "policy": label(cell.policy)}
        rows.append(Score(task, metric, value, "", status, 8, model=cell.model, preset=cell.preset, **where))
    return tuple(rows)


def finished(cell: Cell) -> Outcome:
    """Return the outcome of a finished cell."""
    curve = [50.0, 100.0]
    curves = dict.fromkeys(("coverage", "obstacle_coverage", "semantic_coverage", "viewpoint_coverage"), curve)
    details = {"planning": {"reasons": {"PointGoal": {"success": 7, "no path": 1}}}}
    return Outcome(cell, "ok", scores_of(cell), {"explore": {"seconds": 36.0, "peak_gb": 0.5}}, curves, details=details)


def run(cell: Cell, out: Path, save_run: bool, lpips: str | None, device: str | None) -> str:
    """Follow ``behaviour.json`` next to the results folder, by cell. Each call appends a line to ``log``."""
    with (out.parent / "log").open("a") as log:
        log.write(f"{cell.name} {os.environ.get('OMP_NUM_THREADS')}\n")
    file = out.parent / "behaviour.json"
    what = read_json(file, dict[str, Any]).get(cell.name) if file.exists() else None
    if what == "hang":
        time.sleep(600)
    elif what == "slow":
        time.sleep(2)
    elif what == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    elif what == "grow":
        block = bytearray(1 << 30)
        block[:: 1 << 10] = b"x" * len(block[:: 1 << 10])
        time.sleep(600)
    elif what == "forget":
        return "ok"
    elif what == "late":
        threading.Timer(0.5, lambda: load_results(out).write(finished(cell))).start()
        return "ok"
    elif what == "full":
        raise DataError("cannot write scores: No space left") from OSError(errno.ENOSPC, "No space left")
    elif what is not None:
        load_results(out).write(Outcome(cell, what))
        return what
    load_results(out).write(finished(cell))
    return "ok"


def run_real(cell: Cell, out: Path, save_run: bool, lpips: str | None, device: str | None) -> str:
    """Run a real cell that fails with the error number in ``behaviour.json``, or else with a ``ValueError``."""
    number = read_json(out.parent / "behaviour.json", dict[str, Any]).get(cell.name)

    def fail(*arguments: object, **options: object) -> None:
        raise ValueError("odd") if number is None else OSError(number, os.strerror(number))

    from autonerf_lab import pipeline  # imports torch, which the other fake cells do not need
    from autonerf_lab.benchmark.cell import run_cell

    pipeline.run_pipeline = fail
    return run_cell(cell, out, save_run, lpips)
