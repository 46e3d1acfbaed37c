"""What an evaluator hands back: values by metric, what is kept beside them, and the raw material of its picture."""

from dataclasses import dataclass, field
from typing import Any

from autonerf_lab.utils.storage import out_of_space


@dataclass(frozen=True)
class TaskResult:
    """Values of one task. A value that cannot be computed is None, and ``status`` says why."""

    values: dict[str, float | None]
    n: dict[str, int]  # how many samples each value is a mean of
    status: dict[str, str] = field(default_factory=dict)  # of the values that are not ok
    artifact: dict[str, Any] = field(default_factory=dict)
    details: dict[str, Any] = field(default_factory=dict)  # JSON values, saved with the scores


def failure(error: Exception) -> str:
    """The status of what an error has stopped, which then fails alone.

    Raises:
        Exception: the error itself where nothing after it would fare better: no memory, or no space on the disk.

    Example:
        >>> failure(ValueError("no light"))
        'failed: ValueError: no light'
    """
    if isinstance(error, MemoryError) or out_of_space(error):
        raise error
    return f"failed: {type(error).__name__}: {error}"
