"""Interface of a task of the benchmark protocol, and the records that it returns."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from autonerf_lab.evaluators.metrics import Metric
from autonerf_lab.utils.storage import is_disk_full

if TYPE_CHECKING:
    from autonerf_lab.evaluators.context import EvaluationContext
    from autonerf_lab.presets import Preset


@dataclass(frozen=True)
class TaskResult:
    """Values of one task. A value that cannot be computed is None, and ``status`` gives the reason."""

    values: dict[str, float | None]  # by metric name
    n: dict[str, int]  # number of samples behind each value
    status: dict[str, str] = field(default_factory=dict)  # reason, for the values that are None
    artifact: dict[str, Any] = field(default_factory=dict)  # data for the figures, not saved
    details: dict[str, Any] = field(default_factory=dict)  # JSON values, saved with the scores


@dataclass(frozen=True)
class TaskFigure:
    """One figure of a task, for the report."""

    name: str  # of the file
    draw: str | Callable[..., Any]  # a function of ``autonerf_lab.viz.figures`` by name, or a function
    title: str
    caption: str
    alt: str  # alternative text
    inputs: tuple[str, ...] = ("artifact",)  # arguments of ``draw``: "artifact", "field" and "scene" exist


class Task(ABC):
    """One task of the protocol: it scores a radiance field in its scene.

    A subclass sets the class attributes and implements :meth:`run`. It keeps no state: everything that tasks share
    is in the context. A package registers an instance::

        [project.entry-points."autonerf_lab.evaluators"]
        my-task = "my_package:MY_TASK"
    """

    name: str  # as in ``evaluate(..., tasks=[name])``
    metrics: tuple[Metric, ...]  # in the order of the rows
    title: str  # heading of the section in the report
    text: str  # first paragraph of the section, plain text
    figures: tuple[TaskFigure, ...] = ()
    optional: bool = False  # run only when asked for by name

    @abstractmethod
    def run(self, context: "EvaluationContext") -> TaskResult:
        """Score ``context.field``. The result holds a value, or None and a status, for each metric."""

    def ticks(self, preset: "Preset") -> int:
        """Return how often :meth:`run` calls ``context.tick``; 0 for a task that does not report progress."""
        return 0


def failure(error: Exception) -> str:
    """Return the status of a computation that an error has stopped; the other computations continue.

    Raises:
        Exception: the error itself, if nothing else can succeed either: no memory, or no space on the disk.

    Example:
        >>> failure(ValueError("no light"))
        'failed: ValueError: no light'
    """
    if isinstance(error, MemoryError) or is_disk_full(error):
        raise error
    return f"failed: {type(error).__name__}: {error}"
