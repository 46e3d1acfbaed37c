"""A grid runs every cell once, whatever happens to the others, and refuses what it cannot do before it begins."""

import copy
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import fake_cell
import pytest

from autonerf_lab.benchmark import Grid, load_results, paper_grid, run_grid
from autonerf_lab.benchmark.grid import load_grid
from autonerf_lab.benchmark.publish import publish
from autonerf_lab.errors import AutoNerfError, DataError, RunFolderError, UnknownNameError

TESTS = Path(__file__).parent
GRID = Grid(("random", "frontier"), ("val-0", "val-1"), 2, preset="smoke")


@pytest.fixture(autouse=True)
def workers_find_the_fake(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(TESTS), os.environ.get("PYTHONPATH", "")]))


def run(tmp_path, told=None, grid=GRID, **arguments):
    (tmp_path / "told.json").write_text(json.dumps(told or {}))
    return run_grid(grid, tmp_path / "out", function=fake_cell.FUNCTION, **arguments)


def statuses(results):
    return {outcome.cell.name: outcome.status.split(":")[0] for outcome in results.outcomes()}


def log(tmp_path):
    return [line.split()[0] for line in (tmp_path / "log").read_text().splitlines()]


NAMES = [cell.name for cell in GRID.cells()]


@pytest.mark.parametrize("workers", [0, 2])
def test_every_cell_runs_once_and_twice_changes_nothing(tmp_path, workers):
    results = run(tmp_path, workers=workers)
    assert sorted(log(tmp_path)) == sorted(NAMES)
    assert statuses(results) == dict.fromkeys(NAMES, "ok")
    before = [path.read_bytes() for path in publish(results)]
    assert [path.read_bytes() for path in publish(run(tmp_path, workers=workers))] == before
    assert len(log(tmp_path)) == len(NAMES)


def test_threads_are_divided(tmp_path):
    run(tmp_path, workers=2)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    assert {line.split()[1] for line in (tmp_path / "log").read_text().splitlines()} == {str(max(1, cores // 2))}


def test_a_cell_that_goes_wrong_does_so_alone_and_is_retried_on_request(tmp_path):
    told = {NAMES[1]: "kill", NAMES[4]: "failed: odd"}
    results = run(tmp_path, told)
    wrong = {NAMES[1]: "died", NAMES[4]: "failed"}
    assert statuses(results) == dict.fromkeys(NAMES, "ok") | wrong
    assert statuses(run(tmp_path)) == statuses(results), "nothing is tried again without being asked"
    assert statuses(run(tmp_path, retry=["died"])) == dict.fromkeys(NAMES, "ok") | {NAMES[4]: "failed"}
    assert statuses(run(tmp_path, retry=["failed"])) == dict.fromkeys(NAMES, "ok")
    assert sorted(log(tmp_path)) == sorted([*NAMES, NAMES[1], NAMES[4]])


def test_a_cell_that_hangs_is_ended(tmp_path):
    results = run(tmp_path, {NAMES[0]: "hang"}, timeout=20)
    assert statuses(results) == dict.fromkeys(NAMES, "ok") | {NAMES[0]: "timeout"}


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="the system does not say what a process holds")
def test_a_cell_that_grows_is_ended(tmp_path):
    results = run(tmp_path, {NAMES[0]: "grow"}, memory_gb=0.9)
    assert statuses(results) == dict.fromkeys(NAMES, "ok") | {NAMES[0]: "oom"}


@pytest.mark.parametrize("workers", [0, 1])
def test_a_full_disk_stops_the_run_and_loses_nothing(tmp_path, workers):
    with pytest.raises(DataError, match="No space left"):
        run(tmp_path, {NAMES[3]: "full"}, workers=workers)
    assert statuses(load_results(tmp_path / "out")) == dict.fromkeys(NAMES[:3], "ok")
    assert statuses(run(tmp_path, workers=workers)) == dict.fromkeys(NAMES, "ok")
    assert sorted(log(tmp_path)) == sorted([*NAMES, NAMES[3]])


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs POSIX signals")
def test_killed_and_resumed_is_the_same_table(tmp_path):
    code = f"import sys; sys.path.insert(0, {str(TESTS)!r}); import test_benchmark_run as t; from pathlib import Path\n"
    code += "t.run(Path(sys.argv[1]), dict.fromkeys(t.NAMES, 'slow'))"
    process = subprocess.Popen([sys.executable, "-c", code, str(tmp_path)], stdout=subprocess.DEVNULL)
    deadline = time.monotonic() + 100
    while len(list(tmp_path.glob("out/cells/*.json"))) < 2:
        assert time.monotonic() < deadline
        time.sleep(0.05)
    process.kill()
    process.wait()
    (tmp_path / "out/cells/.half.json.abc").write_text("{")
    time.sleep(0.5)
    begun = log(tmp_path)
    done = set(statuses(load_results(tmp_path / "out")))
    assert 2 <= len(done) < len(NAMES)
    resumed = run(tmp_path)
    assert statuses(resumed) == dict.fromkeys(NAMES, "ok")
    assert not [name for name in log(tmp_path)[len(begun) :] if name in done], "done twice"
    assert not list(tmp_path.rglob(".half*"))
    other = tmp_path / "other"
    other.mkdir()
    tables = [path.read_bytes() for path in publish(run(other))]
    assert [path.read_bytes() for path in publish(resumed)] == tables


def test_a_second_process_is_kept_out(tmp_path):
    from autonerf_lab.run_folder import locked

    run(tmp_path)
    with locked(tmp_path / "out"), pytest.raises(RunFolderError, match="another process"):
        run(tmp_path)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"policies": ("random", "frontire")}, "unknown policy 'frontire'; valid names: all, "),
        ({"scenes": ("val-9",)}, "unknown scene 'val-9'; valid names: all, dev, "),
        ({"scenes": ("nowhere.glb",)}, "nowhere.glb"),
        ({"models": ("gauss",)}, "unknown model 'gauss'; valid names: all, instant-ngp"),
        ({"preset": "fats"}, "unknown preset 'fats'"),
        ({"starts": 0}, "starts must be at least 1"),
        ({"scenes": ()}, "no cell"),
    ],
)
def test_bad_names_fail_before_anything_is_made(tmp_path, change, words):
    with pytest.raises(AutoNerfError, match=words):
        run(tmp_path, grid=Grid(**{**GRID.__dict__, **change}))
    assert not (tmp_path / "out").exists() and not (tmp_path / "log").exists()


def test_bad_status_to_retry(tmp_path):
    with pytest.raises(UnknownNameError, match="valid names: died, failed, oom, timeout") as raised:
        run(tmp_path, retry=["slow"])
    assert str(copy.copy(raised.value)) == str(raised.value), "a worker process can send it"


def test_results_of_another_grid_or_version_are_refused(tmp_path):
    run(tmp_path)
    with pytest.raises(RunFolderError, match=r"another grid \(starts: 2, not 3\)"):
        run(tmp_path, grid=Grid(**{**GRID.__dict__, "starts": 3}))
    header = tmp_path / "out/grid.json"
    header.write_text(header.read_text().replace('"package": "', '"package": "9.'))
    with pytest.raises(RunFolderError, match="was made by autonerf-lab 9"):
        run(tmp_path)
    header.write_text("{")
    with pytest.raises(DataError, match=r"grid\.json"):
        run(tmp_path)
    (tmp_path / "foreign").mkdir()
    (tmp_path / "foreign/thesis.txt").touch()
    with pytest.raises(RunFolderError, match="not a results folder"):
        run_grid(GRID, tmp_path / "foreign", function=fake_cell.FUNCTION)
    assert len(log(tmp_path)) == len(NAMES)


def test_a_damaged_cell_is_named(tmp_path):
    results = run(tmp_path)
    path = tmp_path / "out/cells" / f"{NAMES[0]}.json"
    path.write_text(path.read_text()[:100])
    with pytest.raises(DataError, match=NAMES[0]):
        results.outcomes()


def test_names_of_groups():
    from autonerf_lab.policies import POLICIES

    grid = Grid(("all",), ("val", "dev-1"), models=("all",)).checked()
    assert grid.policies == tuple(POLICIES)
    assert grid.scenes == ("val-0", "val-1", "val-2", "val-3", "val-4", "dev-1")
    assert len(paper_grid().policies) == 10 and paper_grid().starts == 5


def test_a_grid_is_a_python_file(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text('from autonerf_lab.benchmark import Grid\nGRID = Grid(("random",), ("dev-0",), 1)\n')
    assert load_grid(str(path)) == Grid(("random",), ("dev-0",), 1)
    path.write_text("GRID = 3")
    with pytest.raises(DataError, match="must set GRID"):
        load_grid(str(path))
    path.write_text("import nowhere_to_be_found")
    with pytest.raises(DataError, match="nowhere_to_be_found"):
        load_grid(str(path))
    with pytest.raises(UnknownNameError, match=r"FILE\.py, paper"):
        load_grid("papers")


def test_a_cell_that_failed_begins_anew_and_one_that_was_ended_goes_on(tmp_path):
    results = run(tmp_path, {NAMES[0]: "failed: a damaged file", NAMES[1]: "timeout: 9 s"})
    cells = results.grid.cells()
    for cell in cells[:2]:
        (results.work(cell) / "run").mkdir(parents=True)
    results.discard(results.outcomes()[:2])
    assert [results.work(cell).exists() for cell in cells[:2]] == [False, True]


def test_what_goes_wrong_inside_a_real_cell_is_its_status(tmp_path, monkeypatch):
    from autonerf_lab import pipeline

    errors = iter([MemoryError("nothing left"), ValueError("odd"), OSError(28, "No space left on device")])

    def fail(*arguments, **options):
        raise next(errors)

    monkeypatch.setattr(pipeline, "begin", fail)
    with pytest.raises(DataError, match=r"No space left on device.*what is finished stays"):
        run_grid(GRID, tmp_path / "out", workers=0)
    found = [outcome.status for outcome in load_results(tmp_path / "out").outcomes()]
    assert found == ["oom: nothing left", "failed: ValueError: odd"]
