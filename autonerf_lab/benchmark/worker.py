"""Worker process that runs cells one after the other.

The worker reads one job per line from its standard input and writes one answer per line to its standard output, both
JSON. It exits as soon as its input ends, also during a cell, so it never outlives its parent process. The output of a
cell goes to ``work/CELL.log`` in the results folder.
"""

import contextlib
import importlib
import json
import os
import queue
import sys
import threading
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from autonerf_lab.benchmark.grid import Cell
from autonerf_lab.errors import AutoNerfError
from autonerf_lab.utils.storage import is_disk_full

RUN_CELL = "autonerf_lab.benchmark.cell:run_cell"


@dataclass(frozen=True)
class Job:
    """Cell to run and its arguments, as sent to a worker."""

    cell: Cell
    out: str  # results folder
    save_run: bool = False
    function: str = RUN_CELL  # "module:name" of a function with the arguments of :func:`.cell.run_cell`
    lpips: str | None = None  # file of the LPIPS weights
    device: str | None = None  # torch device of the fields

    def run(self) -> str:
        """Run the cell in this process and return its status.

        Raises:
            AutoNerfError: No further cell can run, such as on a full disk.
        """
        module, _, name = self.function.partition(":")
        call: Callable[..., str] = getattr(importlib.import_module(module), name)
        return call(self.cell, Path(self.out), self.save_run, self.lpips, self.device)

    def dumps(self) -> str:
        """Return the job as one line of JSON."""
        return json.dumps(asdict(self)) + "\n"

    @classmethod
    def loads(cls, line: str) -> "Job":
        """Return the job of one line of JSON.

        Example:
            >>> job = Job(Cell("random", "val-0", 0, "instant-ngp", "smoke"), "/results")
            >>> Job.loads(job.dumps()) == job
            True
        """
        content = json.loads(line)
        return cls(**content | {"cell": Cell(**content["cell"])})


def main() -> None:
    """Run jobs until the standard input ends."""
    answers = os.fdopen(os.dup(1), "w")
    lines: queue.Queue[str] = queue.Queue()
    threading.Thread(target=_listen, args=(lines,), daemon=True).start()
    while True:
        job = Job.loads(lines.get())
        _redirect_output(Path(job.out) / "work" / f"{job.cell.name}.log")
        answers.write(json.dumps(_answer(job)) + "\n")
        answers.flush()


def _answer(job: Job) -> dict[str, Any]:
    try:
        return {"status": job.run()}
    except Exception as error:
        if not (isinstance(error, AutoNerfError) or is_disk_full(error)):
            raise
        return {"stop": str(error)}


def _listen(lines: "queue.Queue[str]") -> None:
    for line in sys.stdin:
        lines.put(line)
    os._exit(0)  # the parent process has ended


def _redirect_output(path: Path) -> None:
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError):  # the buffered output does not fit on a full disk
            stream.flush()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    except OSError:  # continue without a log; the cell itself will report a full disk
        handle = os.open(os.devnull, os.O_WRONLY)
    os.dup2(handle, 1)
    os.dup2(handle, 2)
    os.close(handle)
