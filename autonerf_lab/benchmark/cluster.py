"""Run cells on a cluster with dask.distributed. All workers share the results folder.

Any scheduler works: ``dask scheduler``, ``dask_jobqueue.SLURMCluster``, ``dask_kubernetes``. A worker runs each cell in
a process of its own, which it can kill when the cell exceeds a limit. The dashboard shows the cells by name.
"""

import hashlib
import os
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace

from autonerf_lab.benchmark.local_workers import Limits, limits_per_worker, run_in_processes
from autonerf_lab.benchmark.worker import Job
from autonerf_lab.errors import DataError, MissingPackageError
from autonerf_lab.utils.resources import cores

CONNECT_SECONDS = 30


def run_on_cluster(jobs: Sequence[Job], address: str, limits: Limits) -> Iterator[tuple[Job, str]]:
    """Run jobs on the workers of a scheduler, one job per worker thread at a time.

    A cell whose worker is lost continues on another worker after its last finished stage.

    Args:
        jobs: Jobs whose results folder is shared by all workers.
        address: Address of the scheduler, such as ``tcp://10.0.0.1:8786``.
        limits: ``seconds`` and ``memory_gb`` per cell. The threads of a machine are divided among its cells.

    Yields:
        Each job with its status, in the order of completion.

    Raises:
        MissingPackageError: The extra ``cluster`` is not installed.
        DataError: The scheduler does not answer, the connection to it was lost, or the disk is full.
    """
    try:
        from distributed import CancelledError, Client, as_completed
        from distributed.comm import CommClosedError
    except ImportError as error:
        raise MissingPackageError('a scheduler needs dask.distributed: pip install "autonerf-lab[cluster]"') from error
    try:
        client = Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError) as error:  # a timeout is an OSError
        raise DataError(f"no scheduler answers at {address}: {error}") from error
    with client:
        print(f"dashboard: {client.dashboard_link}", flush=True)
        threads: Counter[str] = Counter()
        for worker in client.scheduler_info(n_workers=-1)["workers"].values():
            threads[worker["host"]] += worker["nthreads"]
        futures = {
            client.submit(on_worker, job, limits, dict(threads), key=key_of(job), pure=False): job for job in jobs
        }
        for future in as_completed(list(futures), loop=client.loop):
            job = futures[future]
            try:
                status = future.result()
            except DataError:
                raise
            except (CancelledError, CommClosedError) as error:  # this package cancels nothing
                raise DataError(
                    f"the connection to the scheduler at {address} was lost; run the same command again to continue"
                ) from error
            except Exception as error:  # its workers died repeatedly, or the job could not start
                status = f"died: {type(error).__name__}: {error}"
            yield job, status


def key_of(job: Job) -> str:
    """Return the unique dask key of a job. The dashboard shows the part before the last hyphen.

    The digest distinguishes grids with the same cells on one scheduler, because dask merges jobs with equal keys.

    Example:
        >>> from autonerf_lab.benchmark.grid import Cell
        >>> key_of(Job(Cell("modular-obs", "val-0", 0, "instant-ngp", "fast"), "/shared/bench")).rpartition("-")[0]
        'val.0_modular.obs_0_instant.ngp'
    """
    digest = hashlib.sha256(f"{job.out}\n{job.cell!r}".encode()).hexdigest()
    return f"{job.cell.name.replace('-', '.')}-{digest[:8]}"


def on_worker(job: Job, limits: Limits, threads: dict[str, int]) -> str:
    """Run one job in a new process on the machine of this dask worker.

    Args:
        job: Job to run.
        limits: Limits of the cell; ``threads`` is ignored.
        threads: Total number of worker threads, and thus of simultaneous cells, by host.

    Returns:
        Status of the cell.

    Raises:
        DataError: The disk is full.
    """
    from distributed import get_worker

    worker = get_worker()
    own = int(worker.state.nthreads)
    # a batch job with limited cores does not share them with other jobs on the machine
    slots = own if cores() < (os.cpu_count() or 1) else max(own, threads.get(worker.ip, 0))
    own_limits = limits_per_worker(slots, limits.seconds, limits.memory_gb)
    memory = worker.memory_manager.memory_limit
    if limits.memory_gb is None and memory:
        own_limits = replace(own_limits, memory_gb=memory / own / 1e9)
    return next(run_in_processes([job], 1, own_limits))[1]
