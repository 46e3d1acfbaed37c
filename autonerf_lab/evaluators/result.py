"""What an evaluator hands back: values by metric, and the raw material of its picture."""

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class TaskResult:
    """Values of one task. A value that cannot be computed is None, and ``status`` says why."""

    values: dict[str, float | None]
    n: dict[str, int]  # how many samples each value is a mean of
    status: dict[str, str] = field(default_factory=dict)  # of the values that are not ok
    artifact: dict[str, Any] = field(default_factory=dict)
