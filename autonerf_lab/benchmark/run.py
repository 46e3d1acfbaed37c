"""Run a grid: here, in processes of this machine, or on a cluster, by the same call."""

from collections.abc import Iterable, Iterator
from pathlib import Path

from autonerf_lab.benchmark.grid import Cell, Grid
from autonerf_lab.benchmark.processes import Limits, run_in_processes, share
from autonerf_lab.benchmark.results import Outcome, Results, open_results
from autonerf_lab.benchmark.worker import RUN_CELL, Job
from autonerf_lab.errors import UnknownNameError
from autonerf_lab.run_folder import locked

RETRY = ("failed", "timeout", "oom", "died")


def run_grid(
    grid: Grid,
    out: str | Path,
    workers: int = 1,
    scheduler: str | None = None,
    timeout: float | None = 3600.0,
    memory_gb: float | None = None,
    retry: Iterable[str] = (),
    keep: bool = False,
    function: str = RUN_CELL,
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
        timeout: seconds a cell.
        memory_gb: a cell may hold; its share of the machine without.
        retry: outcomes to forget first: ``failed`` for all that are not ok, or words of ``RETRY``.
        keep: leave the run folder of each cell in ``runs/``.
        function: what runs a cell, ``module:name``.

    Raises:
        UnknownNameError: a name in the grid.
        RunFolderError: ``out`` holds other results, or another process is at work there.
        DataError: the disk is full. What is finished stays.
        MissingPackageError: a scheduler, without the extra ``cluster``.
    """
    grid = grid.checked()
    for word in retry:
        if word not in RETRY:
            raise UnknownNameError("status to retry", word, RETRY)
    path = Path(out).resolve()
    results = open_results(path, grid)
    with locked(path):
        results.tidy()
        results.discard([outcome for outcome in results.outcomes() if _again(outcome, set(retry))])
        cells = [cell for cell in grid.cells() if results.read(cell) is None]
        total = len(grid.cells())
        print(f"{total} cells, {total - len(cells)} finished before", flush=True)
        jobs = [Job(cell, str(path), keep, function) for cell in cells]
        for count, (job, status) in enumerate(
            _run(jobs, workers, scheduler, timeout, memory_gb), total - len(jobs) + 1
        ):
            _settle(results, job.cell, status)
            print(f"{count:>{len(str(total))}}/{total} {job.cell.name:<50} {status}", flush=True)
        results.tidy()
    return results


def _run(
    jobs: list[Job], workers: int, scheduler: str | None, timeout: float | None, memory_gb: float | None
) -> Iterator[tuple[Job, str]]:
    if scheduler is not None:
        from autonerf_lab.benchmark.cluster import run_on_cluster

        return run_on_cluster(jobs, scheduler, Limits(0, memory_gb, timeout))
    if workers:
        return run_in_processes(jobs, workers, share(workers, timeout, memory_gb))
    return ((job, job.run()) for job in jobs)


def _again(outcome: Outcome, retry: set[str]) -> bool:
    return not outcome.finished and ("failed" in retry or outcome.status.split(":")[0] in retry)


def _settle(results: Results, cell: Cell, status: str) -> None:
    """A cell whose process was ended has written nothing: that is its outcome."""
    if results.read(cell) is None:
        results.write(Outcome(cell, status))
