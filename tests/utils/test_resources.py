"""Resource limits of a process (affinity, control groups, OMP_NUM_THREADS) and its peak memory."""

import mmap
import os

import pytest

from autonerf_lab.benchmark.local_workers import Limits, limits_per_worker
from autonerf_lab.utils import resources


@pytest.fixture
def groups(tmp_path, monkeypatch):
    """Fake machine with eight cores, with this process in the control group ``/outer/inner``."""
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
        ("50000 100000", None, 1),  # at least one core
        ("1600000 100000", None, 8),  # more than the machine has
    ],
)
def test_cores_follow_the_smallest_limit(groups, inner, outer, cores):
    for folder, words in (("outer/inner", inner), ("outer", outer)):
        if words is not None:
            (groups / folder / "cpu.max").write_text(f"{words}\n")
    assert resources.cores() == resources.threads() == cores


@pytest.mark.parametrize(("asked", "threads"), [("1", 1), ("3,2", 3), ("64", 8), ("0", 8), ("many", 8), ("", 8)])
def test_threads_follow_omp_num_threads(groups, monkeypatch, asked, threads):
    monkeypatch.setenv("OMP_NUM_THREADS", asked)
    assert (resources.threads(), resources.cores()) == (threads, 8)


def test_memory_follows_the_smallest_limit(groups):
    assert resources.memory_gb() == pytest.approx(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 1e9)
    (groups / "outer/inner/memory.max").write_text("max\n")
    (groups / "outer/memory.max").write_text("500000000\n")
    assert resources.memory_gb() == 0.5


def test_limits_per_worker_follow_the_groups(groups):
    (groups / "outer/cpu.max").write_text("400000 100000\n")
    (groups / "outer/memory.max").write_text("1000000000\n")
    assert limits_per_worker(2) == Limits(threads=2, memory_gb=0.45, seconds=3600.0)


def test_system_without_control_groups_and_proc(groups, tmp_path, monkeypatch):
    monkeypatch.setattr(resources, "PROC", tmp_path / "nowhere")
    assert resources.cores() == 8
    resources.reset_peak()
    assert resources.peak_gb() > 0


def test_peak_is_reset():
    if not (resources.PROC / "clear_refs").exists():
        pytest.skip("the peak memory cannot be reset on this system")
    resources.reset_peak()
    before = resources.peak_gb()
    # A new mapping: a bytearray may reuse memory that the process already holds.
    with mmap.mmap(-1, 200 << 20) as block:
        block[:: mmap.PAGESIZE] = b"x" * len(block[:: mmap.PAGESIZE])
        assert resources.peak_gb() > before + 0.15
    resources.reset_peak()
    assert resources.peak_gb() < before + 0.1
    assert resources.resident_gb(os.getpid()) == pytest.approx(resources.peak_gb(), abs=0.05)
