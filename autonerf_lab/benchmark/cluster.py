"""Cells on a cluster: dask.distributed hands them to workers that share the results folder.

A scheduler is whatever made one: ``dask scheduler`` by hand, ``dask_jobqueue.SLURMCluster``, ``dask_kubernetes``. Each
worker runs a cell in a process of its own, which can be ended when it hangs or grows; its dashboard shows the cells by
name.
"""

import hashlib
import os
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace

from autonerf_lab.benchmark.local_workers import Limits, run_in_processes, share
from autonerf_lab.benchmark.worker import Job
from autonerf_lab.errors import DataError, MissingPackageError
from autonerf_lab.utils.resources import cores

CONNECT_SECONDS = 30


def run_on_cluster(jobs: Sequence[Job], address: str, limits: Limits) -> Iterator[tuple[Job, str]]:
    """Run jobs on the workers of a scheduler, as many at a time as these have threads.

    A cell whose worker is lost goes to another one, and on from its last finished stage.

    Args:
        jobs: their results folder is one that all workers see.
        address: such as ``tcp://10.0.0.1:8786``.
        limits: ``seconds`` and ``memory_gb`` of a cell; threads are those of a worker's machine, divided.

    Yields:
        Each job with its status, in the order in which they end.

    Raises:
        MissingPackageError: the extra ``cluster`` is not installed.
        DataError: nobody answers at the address, the scheduler was lost, or the disk is full.
    """
    try:
        from distributed import CancelledError, Client, as_completed
        from distributed.comm import CommClosedError
    except ImportError as error:
        raise MissingPackageError('a scheduler needs dask: pip install "autonerf-lab[cluster]"') from error
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
            except (CancelledError, CommClosedError) as error:  # nobody here cancels anything
                raise DataError(f"the scheduler at {address} was lost; the same command goes on") from error
            except Exception as error:  # its worker died, again and again; or it could not even begin
                status = f"died: {type(error).__name__}: {error}"
            yield job, status


def key_of(job: Job) -> str:
    """What dask calls a job: the dashboard shows all before the last hyphen, the rest tells it from all others.

    Two grids of the same cells may be under way at one scheduler, and dask takes equal keys for equal work.

    Example:
        >>> from autonerf_lab.benchmark.grid import Cell
        >>> key_of(Job(Cell("modular-obs", "val-0", 0, "instant-ngp", "fast"), "/shared/bench"))
        'val.0_modular.obs_0_instant.ngp-421ba663'
    """
    digest = hashlib.sha256(f"{job.out}\n{job.cell!r}".encode()).hexdigest()
    return f"{job.cell.name.replace('-', '.')}-{digest[:8]}"


def on_worker(job: Job, limits: Limits, threads: dict[str, int]) -> str:
    """Run one job in a new process of the machine that this worker is on.

    Args:
        job: the cell.
        limits: ``threads`` does not matter.
        threads: of all workers together, by machine: so many cells may run there at a time.

    Raises:
        DataError: the disk is full.
    """
    from distributed import get_worker

    worker = get_worker()
    own = int(worker.state.nthreads)
    # a job of a batch system sees its own cores only: whoever else is on the machine has others
    slots = own if cores() < (os.cpu_count() or 1) else max(own, threads.get(worker.ip, 0))
    mine = share(slots, limits.seconds, limits.memory_gb)
    memory = worker.memory_manager.memory_limit
    if limits.memory_gb is None and memory:
        mine = replace(mine, memory_gb=memory / own / 1e9)
    return next(run_in_processes([job], 1, mine))[1]
