"""Resource limits and memory use of this process.

Containers and batch jobs may get less than the whole machine. On Linux, the limits are read from the CPU affinity and
from the control groups (cgroup v2) of the process; the smallest limit counts. Without limits, the resources of the
whole machine are returned.
"""

import contextlib
import errno
import mmap
import os
from collections.abc import Iterator
from functools import partial
from pathlib import Path

PROC = Path("/proc/self")
CGROUPS = Path("/sys/fs/cgroup")

_BLAS_BUFFERS = 96 << 20  # bytes, more than OpenBLAS allocates for a product
_OUT_OF_MEMORY = (
    *("cannot allocate memory", "can't allocate memory", "failed to map segment", "out of memory"),
    "can't start new thread",  # there is no space for its stack
)


def is_out_of_memory(error: BaseException) -> bool:
    """Return True if an error was caused by a limit of the memory: of Python, of a shared library, or of torch.

    Example:
        >>> is_out_of_memory(MemoryError()), is_out_of_memory(OSError(errno.ENOMEM, "")), is_out_of_memory(OSError())
        (True, True, False)
        >>> is_out_of_memory(ImportError("libgfortran.so: failed to map segment from shared object"))
        True
        >>> is_out_of_memory(RuntimeError("can't start new thread"))
        True
    """
    if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno == errno.ENOMEM):
        return True
    if any(words in str(error).lower() for words in _OUT_OF_MEMORY):
        return True
    return error.__context__ is not None and is_out_of_memory(error.__context__)  # a library may name another reason


def claim_blas_buffers() -> None:
    """Let OpenBLAS allocate its buffers if the address space of this process is limited.

    Where they no longer fit, it ends the process without an exception; after this call it has them. NumPy and SciPy
    each have an OpenBLAS of their own.

    Raises:
        OSError: the buffers do not fit.

    Example:
        >>> claim_blas_buffers()
    """
    try:
        import resource
    except ImportError:  # Windows has no such limits
        return
    if resource.getrlimit(resource.RLIMIT_AS)[0] == resource.RLIM_INFINITY:
        return
    import numpy as np
    from scipy.linalg.blas import dgemm

    square = np.ones((128, 128))  # smaller products need no buffer
    for product in (np.matmul, partial(dgemm, 1.0)):
        mmap.mmap(-1, _BLAS_BUFFERS).close()
        product(square, square)


def cores() -> int:
    """Return the number of CPU cores available to this process, at least 1.

    Example:
        >>> 1 <= cores() <= os.cpu_count()
        True
    """
    found = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    for quota, period in _cgroup_limits("cpu.max"):  # microseconds of CPU time per period, summed over cores
        if quota != "max":
            found = min(found, int(quota) // int(period))
    return max(1, found)


def threads() -> int:
    """Return the number of threads for parallel work: :func:`cores`, or ``OMP_NUM_THREADS`` if that is smaller.

    Example:
        >>> 1 <= threads() <= cores()
        True
    """
    asked = os.environ.get("OMP_NUM_THREADS", "").split(",")[0].strip()
    return min(cores(), int(asked)) if asked.isdecimal() and int(asked) else cores()


def memory_gb() -> float | None:
    """Return the memory available to this process, GB, or None if unknown."""
    found = [float(limit) for (limit,) in _cgroup_limits("memory.max") if limit != "max"]
    if hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        found.append(float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")))
    return min(found) / 1e9 if found else None


def resident_gb(pid: int) -> float:
    """Return the resident memory of a process, GB, or 0 if unknown."""
    try:
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    except (OSError, IndexError, ValueError):
        return 0.0
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e9


def peak_gb() -> float | None:
    """Return the peak resident memory since process start or the last :func:`reset_peak`, GB, or None if unknown."""
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


def reset_peak() -> None:
    """Reset :func:`peak_gb` to the current memory use. Has no effect on systems without ``/proc``."""
    with contextlib.suppress(OSError):
        (PROC / "clear_refs").write_text("5")


def _cgroup_limits(name: str) -> Iterator[list[str]]:
    """Yield the fields of a limit file, for the control group of this process and all its parents."""
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
