"""A process that runs cells, one after the other.

It reads a job a line from its standard input and answers with a line for each, both JSON. When the input ends, so does
the process, in the middle of a cell if need be: a worker never outlives who started it. What a cell prints goes to
``work/CELL.log`` in the results folder.
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
from autonerf_lab.utils.storage import out_of_space

RUN_CELL = "autonerf_lab.benchmark.cell:run_cell"


@dataclass(frozen=True)
class Job:
    """A cell to run, as it travels to a worker."""

    cell: Cell
    out: str  # the results folder
    keep: bool = False
    function: str = RUN_CELL  # "module:name", called with cell, out, keep and lpips; returns a status
    lpips: str | None = None  # the file of its weights

    def run(self) -> str:
        """Run it here.

        Raises:
            AutoNerfError: nothing more can be run: the disk is full.
        """
        module, _, name = self.function.partition(":")
        call: Callable[..., str] = getattr(importlib.import_module(module), name)
        return call(self.cell, Path(self.out), self.keep, self.lpips)

    def dumps(self) -> str:
        """As a line."""
        return json.dumps(asdict(self)) + "\n"

    @classmethod
    def loads(cls, line: str) -> "Job":
        """From a line.

        Example:
            >>> job = Job(Cell("random", "val-0", 0, "instant-ngp", "smoke"), "/results")
            >>> Job.loads(job.dumps()) == job
            True
        """
        content = json.loads(line)
        return cls(**content | {"cell": Cell(**content["cell"])})


def main() -> None:
    """Work until the input ends."""
    answers = os.fdopen(os.dup(1), "w")
    lines: queue.Queue[str] = queue.Queue()
    threading.Thread(target=_listen, args=(lines,), daemon=True).start()
    while True:
        job = Job.loads(lines.get())
        _print_to(Path(job.out) / "work" / f"{job.cell.name}.log")
        answers.write(json.dumps(_answer(job)) + "\n")
        answers.flush()


def _answer(job: Job) -> dict[str, Any]:
    try:
        return {"status": job.run()}
    except Exception as error:
        if not (isinstance(error, AutoNerfError) or out_of_space(error)):
            raise
        return {"stop": str(error)}


def _listen(lines: "queue.Queue[str]") -> None:
    for line in sys.stdin:
        lines.put(line)
    os._exit(0)  # whoever waits for the answer is gone


def _print_to(path: Path) -> None:
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError):  # what the last cell said does not fit on a full disk
            stream.flush()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    except OSError:  # words are not worth a stop; the cell itself will say that there is no space
        handle = os.open(os.devnull, os.O_WRONLY)
    os.dup2(handle, 1)
    os.dup2(handle, 2)
    os.close(handle)
