"""Run a grid: in this process, in worker processes of this machine, or on a cluster."""

import contextlib
import os
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

from autonerf_lab.benchmark.grid import Cell, Grid
from autonerf_lab.benchmark.local_workers import Limits, limits_per_worker, run_in_processes
from autonerf_lab.benchmark.results import OK, RETRY, Outcome, Results, open_results
from autonerf_lab.benchmark.worker import RUN_CELL, Job
from autonerf_lab.errors import DataError, UnknownNameError
from autonerf_lab.pipeline.run_folder import locked

HOUR = 3600.0
FILE_TIMEOUT = 15.0  # seconds; a network file system may show a new file late


def run_grid(
    grid: Grid,
    out: str | Path,
    workers: int = 1,
    scheduler: str | None = None,
    timeout: float | None = None,
    memory_gb: float | None = None,
    retry: Iterable[str] = (),
    save_runs: bool = False,
    function: str = RUN_CELL,
    lpips: str | Path | None = None,
    device: str | None = None,
) -> Results:
    """Run the cells of a grid that have no outcome yet, and print the status of each.

    After an interruption, the same call continues with the unfinished cells, each after its last finished stage.

    Args:
        grid: Grid; validated before the first cell runs.
        out: Results folder.
        workers: Number of worker processes, which share threads and memory. 0: run in this process, without limits.
        scheduler: Address of a dask.distributed scheduler whose workers run the cells instead.
        timeout: Time limit per cell, s; None: see :func:`default_timeout`.
        memory_gb: Memory limit per cell, GB; None: an equal share of the memory.
        retry: Statuses of cells to run again, from ``RETRY``; ``failed`` selects all cells that are not ok.
        save_runs: Save the run folder of each cell in ``runs/``.
        function: Function that runs a cell, ``module:name``.
        lpips: File of the LPIPS weights, readable by all workers; None: LPIPS is not computed.
        device: Torch device of the fields on the workers, such as "cuda"; None: compiled kernels on the CPU.

    Returns:
        Results of the grid.

    Raises:
        UnknownNameError: A name in the grid or in ``retry`` does not exist.
        WrongTypeError: A field of the grid has the wrong type.
        RunFolderError: ``out`` holds other results, or another process uses it.
        DataError: A value is out of range, the LPIPS weights are invalid, the disk is full, or the connection to the
            scheduler was lost. Outcomes of finished cells are saved.
        DeviceError: The device does not exist on this machine.
        MissingPackageError: A scheduler needs the extra ``cluster``.

    Example::

        results = run_grid(Grid(("random", "frontier"), ("val",), starts=2), "runs/bench", workers=2)
        print(table("rendering", load_results_table(results)).markdown())
    """
    grid, retry = grid.checked(), tuple(retry)
    for word in retry:
        if word not in RETRY:
            raise UnknownNameError("status to retry", word, RETRY)
    if type(workers) is not int or workers < 0:
        raise DataError(f"workers must be a whole number, 0 or more, not {workers!r}")
    seconds = default_timeout(grid) if timeout is None else timeout
    for name, value in (("timeout", seconds), ("memory_gb", memory_gb)):
        if value is not None and not value > 0:
            raise DataError(f"{name} must be more than 0, not {value}")
    if device is not None and scheduler is None:
        from autonerf_lab.nerf.model import check_device  # imports torch

        check_device(device)
    weights = None if lpips is None else str(Path(lpips).resolve())
    sha256 = None if weights is None else _checked_weights(weights)
    path = Path(out).resolve()
    with locked(path):
        results = open_results(path, grid, sha256)
        results.clean_up()
        results.discard([outcome for outcome in results.outcomes() if outcome.should_retry(retry)])
        cells = [cell for cell in grid.cells() if results.read(cell) is None]
        total = len(grid.cells())
        print(f"{total} cells, {total - len(cells)} already finished", flush=True)
        jobs = [Job(cell, str(path), save_runs, function, weights, device) for cell in cells]
        for count, (job, status) in enumerate(
            _run(jobs, workers, scheduler, seconds, memory_gb), total - len(jobs) + 1
        ):
            _record(results, job.cell, status)
            print(f"{count:>{len(str(total))}}/{total} {job.cell.name:<50} {status}", flush=True)
        results.clean_up()
    return results


def default_timeout(grid: Grid) -> float:
    """Return the default time limit per cell, s: 1 h, with fine-tuning 12 h.

    Example:
        >>> default_timeout(Grid(("random",), ("val",)))
        3600.0
        >>> default_timeout(Grid(("random",), ("val",), optional=("finetuning",)))
        43200.0
    """
    return 12 * HOUR if "finetuning" in grid.optional else HOUR


def _run(
    jobs: list[Job], workers: int, scheduler: str | None, seconds: float, memory_gb: float | None
) -> Iterator[tuple[Job, str]]:
    if scheduler is not None:
        from autonerf_lab.benchmark.cluster import run_on_cluster

        return run_on_cluster(jobs, scheduler, Limits(0, memory_gb, seconds))
    if workers:
        return run_in_processes(jobs, workers, limits_per_worker(workers, seconds, memory_gb))
    return ((job, job.run()) for job in jobs)


def _checked_weights(file: str) -> str:
    from autonerf_lab.evaluators.lpips import Lpips  # imports torch

    return Lpips(file).sha256


def _record(results: Results, cell: Cell, status: str) -> None:
    """Write the outcome of a cell whose process was killed, and check that a finished cell has written its own."""
    file = results.cell_file(cell)
    until = time.monotonic() + (FILE_TIMEOUT if status == OK else 0.0)
    while results.read(cell) is None:
        if time.monotonic() < until:
            time.sleep(0.2)
            with contextlib.suppress(OSError):  # NFS caches the absence of a file until its folder is read
                os.listdir(file.parent)
        elif status == OK:
            raise DataError(
                f"a worker has finished {cell.name}, but {file} does not exist: all workers must share the folder "
                f"{results.path}"
            )
        else:
            results.write(Outcome(cell, status))
