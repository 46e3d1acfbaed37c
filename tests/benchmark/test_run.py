"""Run of a grid: each cell runs once, failures stay in their cell, and an interrupted run continues."""

import errno
import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from fake_grid import GRID, NAMES, SUPPORT, log, run, statuses

from autonerf_lab.benchmark import Grid, load_results, local_workers, paper_grid, run_grid
from autonerf_lab.benchmark import run as run_module
from autonerf_lab.benchmark.export import export_results
from autonerf_lab.benchmark.local_workers import Limits, run_in_processes
from autonerf_lab.benchmark.results import Results, open_results
from autonerf_lab.benchmark.results_table import load_results_table
from autonerf_lab.benchmark.worker import Job
from autonerf_lab.errors import DataError, RunFolderError
from autonerf_lab.utils.resources import cores


def tables(results: Results) -> list[bytes]:
    """Export the tables and return their contents."""
    return [path.read_bytes() for path in export_results(load_results_table(results), results.path)]


@pytest.mark.parametrize("workers", [0, 2])
def test_every_cell_runs_once_and_a_second_run_changes_nothing(tmp_path, workers):
    results = run(tmp_path, workers=workers)
    assert sorted(log(tmp_path)) == sorted(NAMES)
    assert statuses(results) == dict.fromkeys(NAMES, "ok")
    before = tables(results)
    assert tables(run(tmp_path, workers=workers)) == before
    assert len(log(tmp_path)) == len(NAMES)


def test_threads_are_divided_among_workers(tmp_path):
    run(tmp_path, workers=2)
    assert {line.split()[1] for line in (tmp_path / "log").read_text().splitlines()} == {str(max(1, cores() // 2))}


def test_failed_cells_do_not_affect_others_and_are_retried_on_request(tmp_path):
    behaviour = {NAMES[1]: "kill", NAMES[4]: "failed: odd"}
    results = run(tmp_path, behaviour)
    failed = {NAMES[1]: "died", NAMES[4]: "failed"}
    assert statuses(results) == dict.fromkeys(NAMES, "ok") | failed
    assert statuses(run(tmp_path)) == statuses(results), "no cell is retried by default"
    assert statuses(run(tmp_path, retry=["died"])) == dict.fromkeys(NAMES, "ok") | {NAMES[4]: "failed"}
    assert statuses(run(tmp_path, retry=["failed"])) == dict.fromkeys(NAMES, "ok")
    assert sorted(log(tmp_path)) == sorted([*NAMES, NAMES[1], NAMES[4]])


def test_hanging_cell_is_killed(tmp_path):
    results = run(tmp_path, {NAMES[0]: "hang"}, timeout=20)
    assert statuses(results) == dict.fromkeys(NAMES, "ok") | {NAMES[0]: "timeout"}


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="the memory of a process is unknown on this system")
def test_cell_over_its_memory_limit_is_killed(tmp_path):
    results = run(tmp_path, {NAMES[0]: "grow"}, memory_gb=0.9)
    assert statuses(results) == dict.fromkeys(NAMES, "ok") | {NAMES[0]: "oom"}


@pytest.mark.parametrize("workers", [0, 1])
def test_full_disk_stops_the_run_and_loses_nothing(tmp_path, workers):
    with pytest.raises(DataError, match="No space left"):
        run(tmp_path, {NAMES[3]: "full"}, workers=workers)
    assert statuses(load_results(tmp_path / "out")) == dict.fromkeys(NAMES[:3], "ok")
    assert statuses(run(tmp_path, workers=workers)) == dict.fromkeys(NAMES, "ok")
    assert sorted(log(tmp_path)) == sorted([*NAMES, NAMES[3]])


LIMITED = """
import resource, sys
sys.path.insert(0, sys.argv[1])
import fake_grid as t, pathlib
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[3]), resource.RLIM_INFINITY))
try:
    t.run(pathlib.Path(sys.argv[2]), workers=int(sys.argv[4]))
except t.DataError as error:
    sys.exit(f"error: {error}")
"""


@pytest.mark.parametrize("workers", [0, 1])
def test_failing_writes_stop_the_run_and_lose_nothing(tmp_path, workers):
    """The limit on the file size is one byte less than the outcome of the first cell."""
    pytest.importorskip("resource")
    run(tmp_path, grid=Grid(GRID.policies, GRID.scenes, 1, preset="smoke"))
    size = (tmp_path / "out/cells" / f"{NAMES[0]}.json").stat().st_size
    other = tmp_path / "other"
    other.mkdir()
    (other / "behaviour.json").write_text("{}")
    words = [sys.executable, "-c", LIMITED, str(SUPPORT), str(other), str(size - 1), str(workers)]
    found = subprocess.run(words, capture_output=True, text=True, check=False)
    assert found.returncode == 1 and f"{NAMES[0]}.json: File too large" in found.stderr, found.stderr
    assert not statuses(load_results(other / "out")) and not list(other.rglob(".*"))
    assert statuses(run(other)) == dict.fromkeys(NAMES, "ok")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_log_on_a_full_disk_does_not_affect_outcomes(tmp_path):
    (tmp_path / "out/work").mkdir(parents=True)
    for name in NAMES[:3]:
        (tmp_path / "out/work" / f"{name}.log").symlink_to("/dev/full")
    open_results(tmp_path / "new", GRID)
    (tmp_path / "new/grid.json").rename(tmp_path / "out/grid.json")
    (tmp_path / "behaviour.json").write_text(json.dumps({NAMES[2]: errno.ENOSPC}))
    with pytest.raises(DataError, match="No space left on device; finished cells are saved"):
        run_grid(GRID, tmp_path / "out", function="fake_cell:run_real")
    found = [outcome.status for outcome in load_results(tmp_path / "out").outcomes()]
    assert found == ["failed: ValueError: odd"] * 2


@pytest.mark.parametrize("workers", [0, 1])
def test_finished_cell_without_a_file_is_an_error(tmp_path, monkeypatch, workers):
    monkeypatch.setattr(run_module, "FILE_TIMEOUT", 0.5)
    with pytest.raises(DataError, match=rf"{NAMES[1]}\.json does not exist: all workers must share the folder .*/out"):
        run(tmp_path, {NAMES[1]: "forget"}, workers=workers)
    assert statuses(load_results(tmp_path / "out")) == {NAMES[0]: "ok"}


def test_late_file_of_a_network_file_system_is_waited_for(tmp_path):
    assert statuses(run(tmp_path, {NAMES[1]: "late"}, workers=0)) == dict.fromkeys(NAMES, "ok")


def test_limits_are_checked_independent_of_the_rate_of_answers(tmp_path, monkeypatch):
    checks = []

    class Quick:
        """Worker that answers immediately."""

        def __init__(self, limits, answers):
            self.answers = answers

        def submit(self, job):
            self.job = job
            self.answers.put((self, "done"))

        def check_limits(self):
            checks.append(self.job)

        def status(self, line):
            time.sleep(0.001)
            return line

        def ended(self, line):
            return False

        def stop(self):
            pass

    monkeypatch.setattr(local_workers, "_Process", Quick)
    monkeypatch.setattr(local_workers, "CHECK_SECONDS", 0.02)
    jobs = [Job(GRID.cells()[0], str(tmp_path)) for _ in range(200)]
    assert [status for _, status in run_in_processes(jobs, 2, Limits())] == ["done"] * 200
    assert len(checks) >= 5


def test_peak_memory_is_measured_per_cell(tmp_path, monkeypatch):
    """The first cell allocates 300 MB, the second cell, in the same process, does not."""
    from autonerf_lab import pipeline
    from autonerf_lab.benchmark import cell as cell_module
    from autonerf_lab.utils import resources

    if not (resources.PROC / "clear_refs").exists():
        pytest.skip("the peak memory cannot be reset on this system")
    peaks, sizes = [], iter([300 << 20, 1])

    def allocate(*arguments, **options):
        block = bytearray(next(sizes))
        block[:: 1 << 10] = b"x" * len(block[:: 1 << 10])
        peaks.append(resources.peak_gb())
        raise ValueError("enough")

    monkeypatch.setattr(pipeline, "run_pipeline", allocate)
    results = open_results(tmp_path / "out", GRID)
    for cell in GRID.cells()[:2]:
        assert cell_module.run_cell(cell, results.path).startswith("failed")
    assert peaks[1] < peaks[0] - 0.2


def test_clean_up_removes_only_temporary_files(tmp_path):
    results = run(tmp_path)
    left = [
        ".grid.json.abcd_123",
        "cells/.a.json.abcd1234",
        "figures/.b.webp.abcd1234",
        "scenes/.c.txt.abcd1234",
    ]
    others = [".notes", ".my.own.file", "cells/.DS_Store", "cells/.nfs00000000012345", "scenes/.keep.md.old"]
    for name in (*left, *others):
        (results.path / name).parent.mkdir(exist_ok=True)
        (results.path / name).touch()
    (results.path / "cells/.d.json.abcd1234").mkdir()
    (results.path / "cells/.e.json.abcd1234").symlink_to(results.path / ".notes")
    results.clean_up()
    others += ["cells/.d.json.abcd1234", "cells/.e.json.abcd1234"]
    assert {str(path.relative_to(results.path)) for path in results.path.rglob(".*")} == set(others)


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs POSIX signals")
def test_killed_and_continued_run_gives_the_same_tables(tmp_path):
    code = f"import sys; sys.path.insert(0, {str(SUPPORT)!r}); import fake_grid as t; from pathlib import Path\n"
    code += "t.run(Path(sys.argv[1]), dict.fromkeys(t.NAMES, 'slow'))"
    process = subprocess.Popen([sys.executable, "-c", code, str(tmp_path)], stdout=subprocess.DEVNULL)
    deadline = time.monotonic() + 100
    while len(list(tmp_path.glob("out/cells/*.json"))) < 2:
        assert time.monotonic() < deadline
        time.sleep(0.05)
    process.kill()
    process.wait()
    (tmp_path / "out/cells/.half.json.abc_1234").write_text("{")
    time.sleep(0.5)
    started = log(tmp_path)
    done = set(statuses(load_results(tmp_path / "out")))
    assert 2 <= len(done) < len(NAMES)
    resumed = run(tmp_path)
    assert statuses(resumed) == dict.fromkeys(NAMES, "ok")
    assert not [name for name in log(tmp_path)[len(started) :] if name in done], "run twice"
    assert not list(tmp_path.rglob(".half*"))
    other = tmp_path / "other"
    other.mkdir()
    assert tables(resumed) == tables(run(other))


def test_second_process_is_refused(tmp_path):
    from autonerf_lab.pipeline.run_folder import locked

    run(tmp_path)
    with locked(tmp_path / "out"), pytest.raises(RunFolderError, match="another process"):
        run(tmp_path)


def test_error_names_the_damaged_cell(tmp_path):
    results = run(tmp_path)
    path = tmp_path / "out/cells" / f"{NAMES[0]}.json"
    path.write_text(path.read_text()[:100])
    with pytest.raises(DataError, match=NAMES[0]):
        results.outcomes()


def test_groups_of_names_are_expanded():
    from autonerf_lab.policies import POLICIES

    grid = Grid(("all",), ("val", "dev-1"), models=("all",)).checked()
    assert grid.policies == tuple(POLICIES)
    assert grid.scenes == ("val-0", "val-1", "val-2", "val-3", "val-4", "dev-1")
    custom = Grid(("autonerf_lab.policies.frontier:Frontier",), ("dev-0",), 1).checked()
    assert [cell.name for cell in custom.cells()] == [
        "dev-0_autonerf_lab.policies.frontier-Frontier_0_semantic-nerfacto"
    ]
    assert len(paper_grid().policies) == 11 and paper_grid().starts == 5


def test_failed_cell_starts_from_scratch_and_killed_cell_continues(tmp_path):
    results = run(tmp_path, {NAMES[0]: "failed: a damaged file", NAMES[1]: "timeout: 9 s"})
    cells = results.grid.cells()
    for cell in cells[:2]:
        (results.work_folder(cell) / "run").mkdir(parents=True)
    results.discard(results.outcomes()[:2])
    assert [results.work_folder(cell).exists() for cell in cells[:2]] == [False, True]


def test_error_inside_a_real_cell_is_its_status(tmp_path, monkeypatch):
    from autonerf_lab import pipeline

    errors = iter([MemoryError("nothing left"), ValueError("odd"), OSError(28, "No space left on device")])

    def fail(*arguments, **options):
        raise next(errors)

    monkeypatch.setattr(pipeline, "run_pipeline", fail)
    with pytest.raises(DataError, match=r"No space left on device.*finished cells are saved"):
        run_grid(GRID, tmp_path / "out", workers=0)
    found = [outcome.status for outcome in load_results(tmp_path / "out").outcomes()]
    assert found == ["oom: MemoryError: nothing left", "failed: ValueError: odd"]
