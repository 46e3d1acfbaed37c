"""What a process may use: the tightest of affinity, control groups and OMP_NUM_THREADS; and its peak of memory."""

import mmap
import os

import pytest

from autonerf_lab.benchmark.local_workers import Limits, share
from autonerf_lab.utils import resources


@pytest.fixture
def groups(tmp_path, monkeypatch):
    """A tree of control groups, in whose ``/outer/inner`` this process is; and a machine of eight cores."""
    (tmp_path / "proc").mkdir()
    (tmp_path / "proc/cgroup").write_text("9:name=systemd:/\n0::/outer/inner\n")
    (tmp_path / "groups/outer/inner").mkdir(parents=True)
    monkeypatch.setattr(resources, "PROC", tmp_path / "proc")
    monkeypatch.setattr(resources, "CGROUPS", tmp_path / "groups")
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(8)), raising=False)
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    return tmp_path / "groups"


@pytest.mark.parametrize(
    ("inner", "outer", "cores"),
    [
        (None, None, 8),
        ("max 100000", "max 100000", 8),
        ("300000 100000", None, 3),
        ("350000 100000", "max 100000", 3),
        ("max 100000", "200000 100000", 2),
        ("50000 100000", None, 1),  # half a core is one thread
        ("1600000 100000", None, 8),  # more than there is
    ],
)
def test_cores_are_those_of_the_tightest_group(groups, inner, outer, cores):
    for folder, words in (("outer/inner", inner), ("outer", outer)):
        if words is not None:
            (groups / folder / "cpu.max").write_text(f"{words}\n")
    assert resources.cores() == resources.threads() == cores


@pytest.mark.parametrize(("asked", "threads"), [("1", 1), ("3,2", 3), ("64", 8), ("0", 8), ("many", 8), ("", 8)])
def test_threads_are_no_more_than_was_asked_for(groups, monkeypatch, asked, threads):
    monkeypatch.setenv("OMP_NUM_THREADS", asked)
    assert (resources.threads(), resources.cores()) == (threads, 8)


def test_memory_is_that_of_the_tightest_group(groups):
    assert resources.memory_gb() == pytest.approx(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 1e9)
    (groups / "outer/inner/memory.max").write_text("max\n")
    (groups / "outer/memory.max").write_text("500000000\n")
    assert resources.memory_gb() == 0.5


def test_workers_share_what_the_groups_leave(groups):
    (groups / "outer/cpu.max").write_text("400000 100000\n")
    (groups / "outer/memory.max").write_text("1000000000\n")
    assert share(2) == Limits(threads=2, memory_gb=0.45, seconds=3600.0)


def test_a_system_without_groups_or_proc(groups, tmp_path, monkeypatch):
    monkeypatch.setattr(resources, "PROC", tmp_path / "nowhere")
    assert resources.cores() == 8
    resources.forget_peak()
    assert resources.peak_gb() > 0


def test_the_peak_begins_again():
    if not (resources.PROC / "clear_refs").exists():
        pytest.skip("the system cannot forget a peak")
    resources.forget_peak()
    before = resources.peak_gb()
    # Pages of its own: a bytearray may lie in memory that other tests have freed and the process still holds.
    with mmap.mmap(-1, 200 << 20) as block:
        block[:: mmap.PAGESIZE] = b"x" * len(block[:: mmap.PAGESIZE])
        assert resources.peak_gb() > before + 0.15
    resources.forget_peak()
    assert resources.peak_gb() < before + 0.1
    assert resources.resident_gb(os.getpid()) == pytest.approx(resources.peak_gb(), abs=0.05)
