"""What this process may use of its machine, and what it has used: cores, threads, memory.

A container or a batch job may hold less than the machine has. Linux says so in the affinity of the process and in its
control groups (cgroup v2), of which the tightest counts. Where a system says nothing, it is what the machine has.
"""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

PROC = Path("/proc/self")
CGROUPS = Path("/sys/fs/cgroup")


def cores() -> int:
    """Cores that this process may use, at least one.

    Example:
        >>> 1 <= cores() <= os.cpu_count()
        True
    """
    found = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    for quota, period in _said("cpu.max"):  # microseconds in each period, of all cores together
        if quota != "max":
            found = min(found, int(quota) // int(period))
    return max(1, found)


def threads() -> int:
    """Threads for work that this process spreads over its cores: fewer where ``OMP_NUM_THREADS`` says so.

    Example:
        >>> 1 <= threads() <= cores()
        True
    """
    asked = os.environ.get("OMP_NUM_THREADS", "").split(",")[0].strip()
    return min(cores(), int(asked)) if asked.isdecimal() and int(asked) else cores()


def memory_gb() -> float | None:
    """Memory that this process may use, GB; None where the system does not say."""
    found = [float(limit) for (limit,) in _said("memory.max") if limit != "max"]
    if hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        found.append(float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")))
    return min(found) / 1e9 if found else None


def resident_gb(pid: int) -> float:
    """Memory that a process holds now, GB; 0 where the system does not say."""
    try:
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    except (OSError, IndexError, ValueError):
        return 0.0
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e9


def peak_gb() -> float | None:
    """The most memory that this process has held since it began or :func:`forget_peak`, GB; None if nobody knows."""
    with contextlib.suppress(OSError, ValueError, StopIteration):
        lines = (PROC / "status").read_text().splitlines()
        return int(next(line for line in lines if line.startswith("VmHWM:")).split()[1]) * 1024 / 1e9
    try:
        import resource
    except ImportError:
        return None
    import sys

    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e9


def forget_peak() -> None:
    """Let :func:`peak_gb` begin again, from what is held now; without effect where the system cannot."""
    with contextlib.suppress(OSError):
        (PROC / "clear_refs").write_text("5")


def _said(name: str) -> Iterator[list[str]]:
    """The words of a limit, of the control group of this process and of those around it."""
    try:
        lines = (PROC / "cgroup").read_text().splitlines()
    except OSError:
        return
    for group in (line[4:] for line in lines if line.startswith("0::/")):
        own = CGROUPS / group
        for folder in (own, *own.parents):
            if folder.is_relative_to(CGROUPS):
                with contextlib.suppress(OSError):
                    yield (folder / name).read_text().split()
