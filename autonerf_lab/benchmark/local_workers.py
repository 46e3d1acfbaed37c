"""Cells in processes of this machine, each with its share of threads and memory; one that hangs or grows is ended."""

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

THREADS = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
LOOK_EVERY = 0.5  # seconds between two looks at clock and memory


@dataclass(frozen=True)
class Limits:
    """What one cell may use."""

    threads: int = 1
    memory_gb: float | None = None  # None where the machine does not say what it has
    seconds: float | None = 3600.0


def share(workers: int, seconds: float | None = 3600.0, memory: float | None = None) -> Limits:
    """What this process may use of its machine, divided among workers; a tenth of the memory is left to others.

    Args:
        workers: at a time.
        seconds: of a cell.
        memory: of a cell, GB; its share without.

    Example:
        >>> share(10**6).threads, share(2, memory=4.0).memory_gb
        (1, 4.0)
    """
    if memory is None and (whole := memory_gb()) is not None:
        memory = 0.9 * whole / workers
    return Limits(max(1, cores() // workers), memory, seconds)


def run_in_processes(jobs: Iterable[Job], workers: int, limits: Limits) -> Iterator[tuple[Job, str]]:
    """Run jobs, as many at a time as there are workers.

    Yields:
        Each job with its status, in the order in which they end. ``timeout: ...``, ``oom: ...`` and ``died: ...`` are
        those of cells whose process was ended, or ended by itself; the next cell gets a new one.

    Raises:
        DataError: a worker cannot go on at all: the disk is full.
    """
    waiting = iter(jobs)
    answers: queue.Queue[tuple[_Process, str]] = queue.Queue()
    running: list[_Process] = []
    try:
        for job in islice(waiting, workers):
            running.append(_Process(limits, answers))
            running[-1].give(job)
        looked = time.monotonic()
        while running:
            if time.monotonic() >= looked + LOOK_EVERY:  # however many answers come in between
                looked = time.monotonic()
                for process in running:
                    process.look()
            try:
                process, line = answers.get(timeout=max(0.0, looked + LOOK_EVERY - time.monotonic()))
            except queue.Empty:
                continue
            if process not in running:
                continue  # the end of one that was stopped
            yield process.job, process.status(line)
            after = next(waiting, None)
            if after is None or process.ended(line):
                running.remove(process)
                process.stop()
            if after is not None:
                if process not in running:
                    process = _Process(limits, answers)
                    running.append(process)
                process.give(after)
    finally:
        for process in running:
            process.stop()


class _Process:
    """A worker, and what it is doing."""

    job: Job

    def __init__(self, limits: Limits, answers: "queue.Queue[tuple[_Process, str]]") -> None:
        self.limits = limits
        self.reason = ""  # why it was ended
        self.started = 0.0
        self.process = subprocess.Popen(
            [sys.executable, "-c", "from autonerf_lab.benchmark.worker import main; main()"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | dict.fromkeys(THREADS, str(limits.threads)),
            start_new_session=True,  # Ctrl-C is for the one who started it
        )
        threading.Thread(target=self._listen, args=(answers,), daemon=True).start()

    def give(self, job: Job) -> None:
        self.job, self.started = job, time.monotonic()
        assert self.process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # it is dead already, which the listener says
            self.process.stdin.write(job.dumps())
            self.process.stdin.flush()

    def look(self) -> None:
        """End it if it takes too long or too much."""
        seconds, memory = self.limits.seconds, self.limits.memory_gb
        if seconds is not None and time.monotonic() - self.started > seconds:
            self.reason = f"timeout: not finished after {seconds:g} s"
        elif memory is not None and (used := resident_gb(self.process.pid)) > memory:
            self.reason = f"oom: {used:.1f} GB, its share is {memory:.1f}"
        if self.reason:
            self.process.kill()

    def status(self, line: str) -> str:
        """What an answer means; an empty one is the end of the process."""
        if line:
            answer = json.loads(line)
            if "stop" in answer:
                raise DataError(answer["stop"])
            return str(answer["status"])
        if self.reason:
            return self.reason
        code = self.process.wait()
        name = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        hint = ", which is also what the system does when memory runs out" if name == "SIGKILL" else ""
        return f"died: {name}{hint}"

    def ended(self, line: str) -> bool:
        """Whether it cannot take another job: it is dead, or was ended while it gave its last answer."""
        return not line or bool(self.reason)

    def stop(self) -> None:
        self.process.kill()
        self.process.wait()
        assert self.process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # what was not written to a dead process is no loss
            self.process.stdin.close()

    def _listen(self, answers: "queue.Queue[tuple[_Process, str]]") -> None:
        assert self.process.stdout is not None
        with self.process.stdout as lines:
            for line in lines:
                answers.put((self, line))
        answers.put((self, ""))
