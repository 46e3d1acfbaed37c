"""Run a grid: here, in processes of this machine, or on a cluster, by the same call."""

import contextlib
import os
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

from autonerf_lab.benchmark.grid import Cell, Grid
from autonerf_lab.benchmark.local_workers import Limits, run_in_processes, share
from autonerf_lab.benchmark.results import OK, RETRY, Outcome, Results, open_results
from autonerf_lab.benchmark.worker import RUN_CELL, Job
from autonerf_lab.errors import DataError, UnknownNameError
from autonerf_lab.pipeline.run_folder import locked

HOUR = 3600.0
PATIENCE = 15.0  # seconds for which a network file system may show us the past


def run_grid(
    grid: Grid,
    out: str | Path,
    workers: int = 1,
    scheduler: str | None = None,
    timeout: float | None = None,
    memory_gb: float | None = None,
    retry: Iterable[str] = (),
    keep: bool = False,
    function: str = RUN_CELL,
    lpips: str | Path | None = None,
) -> Results:
    """Run the cells of a grid that have no outcome yet, and say what became of each.

    Killed at any moment, the same call goes on with the cells that are not finished, each from its last finished
    stage.

    Args:
        grid: its names are checked before anything starts.
        out: the results folder.
        workers: processes, which divide threads and memory among them; 0 runs the cells in this process, where nothing
            can end one that hangs.
        scheduler: the address of a scheduler of dask.distributed, whose workers run the cells instead.
        timeout: seconds a cell; an hour without, twelve with fine-tuning.
        memory_gb: a cell may hold; its share of the machine without.
        retry: outcomes to forget first: ``failed`` for all that are not ok, or words of ``RETRY``.
        keep: leave the run folder of each cell in ``runs/``.
        function: what runs a cell, ``module:name``.
        lpips: the file of its weights, which all workers see; it is not measured without.

    Raises:
        UnknownNameError: a name in the grid.
        WrongTypeError: a field of the grid is not what it should be.
        RunFolderError: ``out`` holds other results, or another process is at work there.
        DataError: a number that cannot be; weights of LPIPS that are not; the disk is full, or the scheduler was lost.
            What is finished stays.
        MissingPackageError: a scheduler, without the extra ``cluster``.

    Example::

        results = run_grid(Grid(("random", "frontier"), ("val",), starts=2), "runs/bench", workers=2)
        print(table("rendering", collect(results)).markdown())
    """
    grid, retry = grid.checked(), tuple(retry)
    for word in retry:
        if word not in RETRY:
            raise UnknownNameError("status to retry", word, RETRY)
    if type(workers) is not int or workers < 0:
        raise DataError(f"workers must be a whole number, 0 or more, not {workers!r}")
    seconds = timeout_of(grid) if timeout is None else timeout
    for name, value in (("timeout", seconds), ("memory_gb", memory_gb)):
        if value is not None and not value > 0:
            raise DataError(f"{name} must be more than 0, not {value}")
    weights = None if lpips is None else str(Path(lpips).resolve())
    sha256 = None if weights is None else _checked_weights(weights)
    path = Path(out).resolve()
    with locked(path):
        results = open_results(path, grid, sha256)
        results.tidy()
        results.discard([outcome for outcome in results.outcomes() if outcome.runs_again(retry)])
        cells = [cell for cell in grid.cells() if results.read(cell) is None]
        total = len(grid.cells())
        print(f"{total} cells, {total - len(cells)} finished before", flush=True)
        jobs = [Job(cell, str(path), keep, function, weights) for cell in cells]
        for count, (job, status) in enumerate(
            _run(jobs, workers, scheduler, seconds, memory_gb), total - len(jobs) + 1
        ):
            _settle(results, job.cell, status)
            print(f"{count:>{len(str(total))}}/{total} {job.cell.name:<50} {status}", flush=True)
        results.tidy()
    return results


def timeout_of(grid: Grid) -> float:
    """Seconds after which a cell of a grid is given up, where nobody says more.

    Example:
        >>> timeout_of(Grid(("random",), ("val",))), timeout_of(Grid(("random",), ("val",), optional=("finetuning",)))
        (3600.0, 43200.0)
    """
    return 12 * HOUR if "finetuning" in grid.optional else HOUR


def _run(
    jobs: list[Job], workers: int, scheduler: str | None, seconds: float, memory_gb: float | None
) -> Iterator[tuple[Job, str]]:
    if scheduler is not None:
        from autonerf_lab.benchmark.cluster import run_on_cluster

        return run_on_cluster(jobs, scheduler, Limits(0, memory_gb, seconds))
    if workers:
        return run_in_processes(jobs, workers, share(workers, seconds, memory_gb))
    return ((job, job.run()) for job in jobs)


def _checked_weights(file: str) -> str:
    from autonerf_lab.evaluators.lpips import Lpips  # torch: not for grids that do not measure it

    return Lpips(file).sha256


def _settle(results: Results, cell: Cell, status: str) -> None:
    """A cell whose process was ended has written nothing: that is its outcome. One that is ok has, or it is not."""
    file = results.file(cell)
    until = time.monotonic() + (PATIENCE if status == OK else 0.0)
    while results.read(cell) is None:
        if time.monotonic() < until:
            time.sleep(0.2)
            with contextlib.suppress(OSError):  # NFS remembers that a file was not there, until its folder is read
                os.listdir(file.parent)
        elif status == OK:
            raise DataError(
                f"a worker has finished {cell.name}, but {file} is not there: every worker must see the folder "
                f"{results.path}"
            )
        else:
            results.write(Outcome(cell, status))
