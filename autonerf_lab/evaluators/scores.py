"""``Scores``: a list of :class:`~autonerf_lab.types.Score` that prints as a table beside the values of the paper."""

import html
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from autonerf_lab.errors import DataError
from autonerf_lab.evaluators.metrics import FINETUNING_STAGES, METRICS
from autonerf_lab.types import Score
from autonerf_lab.utils import storage
from autonerf_lab.utils.extras import optional

if TYPE_CHECKING:
    import pandas as pd

_COLUMNS, _PAPER_COLUMNS = ("task", "metric", "unit", "value"), ("paper best", "paper frontier")


def _text(value: float | None, status: str = "ok") -> str:
    if value is None:
        return status.split(":", 1)[0] if status != "ok" else "–"  # the full reason is in the row
    return f"{round(value, 9):.3g}"  # rounding errors, such as 1e-15 m, are zero


@dataclass(frozen=True)
class _ScoresFile:
    """Content of ``scores.json``."""

    scores: list[Score]
    weights: dict[str, str] = field(default_factory=dict)
    details: dict[str, dict[str, Any]] = field(default_factory=dict)


class Scores(list[Score]):
    """Rows of one evaluation, in the order of the protocol.

    Attributes:
        artifacts: data for the figures, by task; not saved.
        baselines: scores that are printed beside these (``oracle``, ``nearest_view``, ``tsdf``); not saved with them.
        weights: SHA-256 of the weights of a metric: ``lpips`` for the file, ``lpips_backbone`` and ``lpips_heads`` for
            its tensors.
        details: by task: test poses (x, y in metres, heading in radians) of ``rendering``, numbers of outcomes of
            ``planning`` and ``navigation``, and frames, hours and learning rates of ``finetuning``.

    Example:
        >>> scores = Scores([Score("rendering", "psnr", 22.5, "dB", n=8)])
        >>> scores["rendering", "psnr"]
        22.5
        >>> print(scores.table())
        task      | metric | unit | value | paper best | paper frontier
        rendering | psnr   | dB   | 22.5  | 25.6       | 19.8
    """

    def __init__(self, rows: Iterable[Score] = (), artifacts: Mapping[str, Any] | None = None) -> None:
        super().__init__(rows)
        self.artifacts: dict[str, Any] = dict(artifacts or {})
        self.baselines: dict[str, Scores] = {}
        self.weights: dict[str, str] = {}
        self.details: dict[str, dict[str, Any]] = {}

    def __getitem__(self, key: Any) -> Any:
        """Return a row by position, or a value by ``scores[task, metric]`` (KeyError if there is no such row)."""
        if not isinstance(key, tuple):
            return super().__getitem__(key)
        for row in self:
            if (row.task, row.metric) == key:
                return row.value
        raise KeyError(key)

    def _rows(self, baselines: Mapping[str, Iterable[Score]]) -> list[tuple[str, ...]]:
        columns = self.baselines | dict(baselines)
        values = {name: {(r.task, r.metric): r for r in rows} for name, rows in columns.items()}
        paper = {metric.key: metric.paper for metric in METRICS.values() if metric.paper}
        compared = any((row.task, row.metric) in paper for row in self)
        lines = [(*_COLUMNS, *(_PAPER_COLUMNS if compared else ()), *values)]
        for row in self:
            key = (row.task, row.metric)
            published = tuple(_text(v) for v in paper.get(key, (None, None))) if compared else ()
            others = tuple(_text(by[key].value, by[key].status) if key in by else "–" for by in values.values())
            lines.append((row.task, row.metric, row.unit, _text(row.value, row.status), *published, *others))
        return lines

    def table(self, **baselines: Iterable[Score]) -> str:
        """Format the scores as plain text, one line per score, beside the paper's best and frontier values.

        Args:
            baselines: further columns beside ``self.baselines``, such as ``oracle=Scores(...)``.
        """
        return "\n\n".join(map(_aligned, filter(None, (self._rows(baselines), self.details_table("finetuning")))))

    def html(self, **baselines: Iterable[Score]) -> str:
        """Format the scores as :meth:`table` does, as HTML; all text is escaped."""
        return "\n".join(map(_html, filter(None, (self._rows(baselines), self.details_table("finetuning")))))

    def details_table(self, task: str) -> list[tuple[str, ...]]:
        """Format the details of a task as a table, header first; empty if there are none.

        For ``finetuning``, one line per policy: scores, frames and hours. For ``trajectory``, the motion that aligned
        the poses. For other tasks, the numbers of outcomes of
        their episodes.

        Example:
            >>> scores = Scores([Score("finetuning", "success_finetuned", 92.9, "%")])
            >>> scores.details["finetuning"] = {"finetuned": {"frames": 10_000_000, "hours": 3.25}}
            >>> scores.details_table("finetuning")[2]
            ('fine-tuned in the mesh', '92.9', '–', '10,000,000', '3.25')
            >>> scores.details["planning"] = {"reasons": {"PointGoal": {"no path": 2, "success": 98}}}
            >>> scores.details_table("planning")
            [('episodes', 'success', 'no path'), ('PointGoal', '98', '2')]
        """
        details = self.details.get(task, {})
        if task == "finetuning":
            return self._finetuning_table(details)
        if task == "trajectory" and details:
            moved = details["alignment"]
            numbers = (f"{moved['x_m']:.3f}", f"{moved['y_m']:.3f}", f"{math.degrees(moved['heading_rad']):.3f}")
            return [
                ("poses moved onto the true ones", "x [m]", "y [m]", "rotation [°]"),
                (details["pose_source"], *numbers),
            ]
        reasons = details.get("reasons", {})
        found = {name for counts in reasons.values() for name in counts}
        names = sorted(found, key=lambda name: (name != "success", name))
        rows = [(label, *(str(counts.get(name, 0)) for name in names)) for label, counts in reasons.items()]
        return [("episodes", *names), *rows] if rows else []

    def details_tables(self) -> dict[str, list[tuple[str, ...]]]:
        """Return the tables of :meth:`details_table` by task, without empty ones.

        Raises:
            DataError: the details are damaged.
        """
        try:
            tables = {task: self.details_table(task) for task in self.details}
            " ".join(text for table in tables.values() for line in table for text in line)
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise DataError(f"'details' is damaged ({error!r})") from error
        return {task: table for task, table in tables.items() if table}

    def _finetuning_table(self, details: Mapping[str, Any]) -> list[tuple[str, ...]]:
        rows = {row.metric: row for row in self if row.task == "finetuning"}
        if not rows:
            return []
        lines: list[tuple[str, ...]] = [("fine-tuning", "success %", "SPL %", "frames", "hours")]
        for stage, label in FINETUNING_STAGES.items():
            found = [rows.get(f"{metric}_{stage}") for metric in ("success", "spl")]
            values = ["–" if row is None else _text(row.value, row.status) for row in found]
            spent = [f"{details[stage][key]:,}" if stage in details else "–" for key in ("frames", "hours")]
            lines.append((label, *values, *spent))
        return lines

    def _repr_html_(self) -> str:
        return self.html()

    def to_frame(self) -> "pd.DataFrame":
        """Return a data frame: one row per score, one column per field of :class:`~autonerf_lab.types.Score`."""
        import pandas as pd

        return pd.DataFrame([asdict(row) for row in self], columns=[f.name for f in fields(Score)])

    def save(self, path: str | Path) -> None:
        """Write the rows, ``weights`` and ``details`` as JSON, without the artifacts.

        Raises:
            DataError: the file cannot be written.
        """
        rows = [asdict(row) for row in self]
        extra = {"weights": self.weights, "details": {task: found for task, found in self.details.items() if found}}
        content = {"version": 1, "scores": rows} | {key: value for key, value in extra.items() if value}
        storage.write_json(path, content)

    def to_tensorboard(self, folder: str | Path, step: int = 0) -> None:
        """Write the values as TensorBoard scalars ``task/metric``; show them with ``tensorboard --logdir folder``.

        Args:
            folder: created if it does not exist.
            step: position on the horizontal axis, such as the number of training steps.

        Raises:
            MissingPackageError: the extra ``training`` is not installed.
        """
        optional("tensorboard", "training")
        from torch.utils.tensorboard import SummaryWriter

        with SummaryWriter(str(folder)) as writer:
            for row in self:
                if row.value is not None:
                    writer.add_scalar(f"{row.task}/{row.metric}", row.value, step)

    @classmethod
    def load(cls, path: str | Path) -> "Scores":
        """Read a file that :meth:`save` has written.

        Raises:
            DataError: the file is missing or damaged.
        """
        try:
            content = storage.read_json(path, _ScoresFile)
        except DataError as error:
            raise DataError(f"{error}; run the evaluation again") from error
        scores = cls(content.scores)
        scores.weights.update(content.weights)
        scores.details.update(content.details)
        try:
            scores.details_tables()
        except DataError as error:
            raise DataError(f"{path}: {error}; run the evaluation again") from error
        return scores


def _aligned(lines: Sequence[Sequence[str]]) -> str:
    widths = [max(len(line[i]) for line in lines) for i in range(len(lines[0]))]
    return "\n".join(" | ".join(c.ljust(w) for c, w in zip(line, widths, strict=True)).rstrip() for line in lines)


def _html(lines: Sequence[Sequence[str]]) -> str:
    def row(line: Sequence[str], tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}>{html.escape(c)}</{tag}>" for c in line) + "</tr>"

    head, body = row(lines[0], "th"), "".join(row(line, "td") for line in lines[1:])
    return f"<table class='scores'><thead>{head}</thead><tbody>{body}</tbody></table>"
