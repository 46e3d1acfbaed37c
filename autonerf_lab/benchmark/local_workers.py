"""Run cells in worker processes on this machine, with limits on threads, memory and time per cell."""

import contextlib
import json
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice

from autonerf_lab.benchmark.worker import Job
from autonerf_lab.errors import DataError
from autonerf_lab.utils.resources import cores, memory_gb, resident_gb

THREAD_VARIABLES = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
CHECK_SECONDS = 0.5  # seconds between two checks of time and memory


@dataclass(frozen=True)
class Limits:
    """Resource limits of one cell."""

    threads: int = 1
    memory_gb: float | None = None  # None: no limit
    seconds: float | None = 3600.0  # None: no limit


def limits_per_worker(workers: int, seconds: float | None = 3600.0, memory: float | None = None) -> Limits:
    """Divide the threads and 90 % of the memory of this process among workers.

    Args:
        workers: Number of workers.
        seconds: Time limit per cell, s.
        memory: Memory limit per cell, GB; None: an equal share.

    Example:
        >>> limits_per_worker(10**6).threads, limits_per_worker(2, memory=4.0).memory_gb
        (1, 4.0)
    """
    if memory is None and (whole := memory_gb()) is not None:
        memory = 0.9 * whole / workers
    return Limits(max(1, cores() // workers), memory, seconds)


def run_in_processes(jobs: Iterable[Job], workers: int, limits: Limits) -> Iterator[tuple[Job, str]]:
    """Run jobs in parallel worker processes.

    A worker is killed when its cell exceeds a limit, and replaced by a new one for the next cell.

    Args:
        jobs: Jobs to run.
        workers: Number of worker processes.
        limits: Limits of each worker.

    Yields:
        Each job with its status, in the order of completion. A cell whose process was killed or died has the status
        ``timeout: ...``, ``oom: ...`` or ``died: ...``.

    Raises:
        DataError: A worker reports that no further cell can run, such as on a full disk.
    """
    waiting = iter(jobs)
    answers: queue.Queue[tuple[_Process, str]] = queue.Queue()
    running: list[_Process] = []
    try:
        for job in islice(waiting, workers):
            running.append(_Process(limits, answers))
            running[-1].submit(job)
        checked = time.monotonic()
        while running:
            if time.monotonic() >= checked + CHECK_SECONDS:  # independent of the rate of answers
                checked = time.monotonic()
                for process in running:
                    process.check_limits()
            try:
                process, line = answers.get(timeout=max(0.0, checked + CHECK_SECONDS - time.monotonic()))
            except queue.Empty:
                continue
            if process not in running:
                continue  # last line of a stopped process
            yield process.job, process.status(line)
            next_job = next(waiting, None)
            if next_job is None or process.ended(line):
                running.remove(process)
                process.stop()
            if next_job is not None:
                if process not in running:
                    process = _Process(limits, answers)
                    running.append(process)
                process.submit(next_job)
    finally:
        for process in running:
            process.stop()


class _Process:
    """Worker process and its current job."""

    job: Job

    def __init__(self, limits: Limits, answers: "queue.Queue[tuple[_Process, str]]") -> None:
        self.limits = limits
        self.reason = ""  # why the process was killed
        self.started = 0.0
        self.process = subprocess.Popen(
            [sys.executable, "-c", "from autonerf_lab.benchmark.worker import main; main()"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | dict.fromkeys(THREAD_VARIABLES, str(limits.threads)),
            start_new_session=True,  # Ctrl-C must reach only the parent
        )
        threading.Thread(target=self._listen, args=(answers,), daemon=True).start()

    def submit(self, job: Job) -> None:
        """Start a job."""
        self.job, self.started = job, time.monotonic()
        assert self.process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # the process is dead; the listener thread reports it
            self.process.stdin.write(job.dumps())
            self.process.stdin.flush()

    def check_limits(self) -> None:
        """Kill the process if it exceeds its time or memory limit."""
        seconds, memory = self.limits.seconds, self.limits.memory_gb
        if seconds is not None and time.monotonic() - self.started > seconds:
            self.reason = f"timeout: not finished after {seconds:g} s"
        elif memory is not None and (used := resident_gb(self.process.pid)) > memory:
            self.reason = f"oom: {used:.1f} GB used, the limit is {memory:.1f} GB"
        if self.reason:
            self.process.kill()

    def status(self, line: str) -> str:
        """Return the status of an answer. An empty line means that the process has ended."""
        if line:
            answer = json.loads(line)
            if "stop" in answer:
                raise DataError(answer["stop"])
            return str(answer["status"])
        if self.reason:
            return self.reason
        code = self.process.wait()
        name = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        hint = ", possibly by the system because memory ran out" if name == "SIGKILL" else ""
        return f"died: {name}{hint}"

    def ended(self, line: str) -> bool:
        """Return True if the process cannot run another job: it is dead, or was killed during its last answer."""
        return not line or bool(self.reason)

    def stop(self) -> None:
        """Kill the process and release its pipes."""
        self.process.kill()
        self.process.wait()
        assert self.process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # unwritten input of a dead process
            self.process.stdin.close()

    def _listen(self, answers: "queue.Queue[tuple[_Process, str]]") -> None:
        assert self.process.stdout is not None
        with self.process.stdout as lines:
            for line in lines:
                answers.put((self, line))
        answers.put((self, ""))
