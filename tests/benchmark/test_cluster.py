"""Cluster: a real scheduler and two workers over TCP on loopback."""

import json
import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import fake_cell
import pytest
from fake_grid import GRID, NAMES, SUPPORT, log, statuses

from autonerf_lab.benchmark import load_results, run_grid
from autonerf_lab.benchmark import run as run_module
from autonerf_lab.benchmark.cluster import key_of
from autonerf_lab.benchmark.export import table_files
from autonerf_lab.benchmark.results_table import load_results_table
from autonerf_lab.benchmark.worker import Job
from autonerf_lab.errors import DataError

distributed = pytest.importorskip("distributed")

SCHEDULER = """
import asyncio, sys
from distributed import Scheduler
async def main():
    async with Scheduler(host="127.0.0.1", port=0, dashboard=False) as scheduler:
        print(scheduler.address, flush=True)
        await scheduler.finished()
asyncio.run(main())
"""
WORKER = """
import asyncio, sys
from distributed import Worker
async def main():
    async with Worker(sys.argv[1], nthreads=1, host="127.0.0.1", dashboard=False) as worker:
        print("ready", flush=True)
        await worker.finished()
asyncio.run(main())
"""


def start(code, *arguments):
    process = subprocess.Popen(
        [sys.executable, "-c", code, *arguments], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    return process, process.stdout.readline().strip()


@pytest.fixture
def cluster(monkeypatch):
    """Address of a scheduler, its two workers and its process."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(SUPPORT), os.environ.get("PYTHONPATH", "")]))
    scheduler, address = start(SCHEDULER)
    workers = [start(WORKER, address)[0] for _ in range(2)]
    yield address, workers, scheduler
    for process in (*workers, scheduler):
        process.kill()
        process.wait()
        process.stdout.close()


def test_killed_worker_loses_no_cell(tmp_path: Path, cluster) -> None:
    address, workers, _ = cluster
    behaviour = dict.fromkeys(NAMES[:4], "slow") | {NAMES[5]: "failed: odd"}
    (tmp_path / "behaviour.json").write_text(json.dumps(behaviour))
    code = (
        "import sys; from pathlib import Path; import fake_grid as t, fake_cell\n"
        "from autonerf_lab.benchmark import run_grid\n"
        "run_grid(t.GRID, Path(sys.argv[1]) / 'out', scheduler=sys.argv[2], function=fake_cell.FUNCTION)"
    )
    run = subprocess.Popen([sys.executable, "-c", code, str(tmp_path), address], stdout=subprocess.DEVNULL)
    deadline = time.monotonic() + 300
    while not (tmp_path / "log").exists() or len(log(tmp_path)) < 2:
        assert time.monotonic() < deadline and run.poll() is None
        time.sleep(0.05)
    workers[0].kill()
    assert run.wait(timeout=300) == 0
    results = run_grid(GRID, tmp_path / "out", scheduler=address, function=fake_cell.FUNCTION)
    assert statuses(results) == dict.fromkeys(NAMES, "ok") | {NAMES[5]: "failed"}
    assert set(log(tmp_path)) == set(NAMES) and len(log(tmp_path)) <= len(NAMES) + 1, "at most one cell starts again"
    (tmp_path / "alone").mkdir()
    (tmp_path / "alone/behaviour.json").write_text(json.dumps({NAMES[5]: "failed: odd"}))
    alone = run_grid(GRID, tmp_path / "alone/out", workers=0, function=fake_cell.FUNCTION)
    assert table_files(load_results_table(results)) == table_files(load_results_table(alone))


def test_keys_are_unique_and_show_the_cell_name() -> None:
    split = pytest.importorskip("distributed.utils").key_split
    cells = [*GRID.cells(), *(replace(cell, preset="fast") for cell in GRID.cells())]
    jobs = [Job(cell, out) for cell in cells for out in ("/shared/a", "/shared/b")]
    keys = [key_of(job) for job in jobs]
    assert len(set(keys)) == len(jobs), "one key per results folder and preset"
    assert [split(key) for key in keys] == [job.cell.name.replace("-", ".") for job in jobs]
    assert keys == [key_of(job) for job in jobs]


def test_lost_scheduler_does_not_fail_cells(tmp_path: Path, cluster, monkeypatch) -> None:
    address, _, scheduler = cluster
    (tmp_path / "behaviour.json").write_text(json.dumps(dict.fromkeys(NAMES, "slow")))
    record = run_module._record

    def then_kill(results, cell, status):
        record(results, cell, status)
        scheduler.kill()

    monkeypatch.setattr(run_module, "_record", then_kill)
    monkeypatch.setattr("autonerf_lab.benchmark.cluster.CONNECT_SECONDS", 2)
    with pytest.raises(DataError, match=f"the scheduler at {address} was lost; run the same command again"):
        run_grid(GRID, tmp_path / "out", scheduler=address, function=fake_cell.FUNCTION)
    found = statuses(load_results(tmp_path / "out"))
    assert set(found.values()) == {"ok"} and len(found) < len(NAMES)


def test_no_scheduler_at_the_address(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("autonerf_lab.benchmark.cluster.CONNECT_SECONDS", 1)
    with pytest.raises(DataError, match="no scheduler answers at tcp://127"):
        run_grid(GRID, tmp_path / "out", scheduler="tcp://127.0.0.1:9", function=fake_cell.FUNCTION)
