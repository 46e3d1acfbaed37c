"""``Scores``: a list of :class:`~autonerf_lab.types.Score` that prints itself beside the paper's figures."""

import html
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import pandas as pd

from autonerf_lab.errors import DataError
from autonerf_lab.types import Score
from autonerf_lab.utils import storage

# Best value of each column on Gibson and the frontier row (tables 1 to 4 of the paper); of navigation and fine-tuning
# there is one policy (obs.). The paper's semantic map scores are exact, so they stand beside the exact ones here.
PAPER: dict[tuple[str, str], tuple[float, float | None]] = {
    ("rendering", "psnr"): (25.56, 19.75),
    ("rendering", "ssim"): (0.846, 0.743),
    ("rendering", "lpips"): (0.203, 0.343),
    ("rendering", "per_class_accuracy"): (91.9, 81.4),
    ("rendering", "miou"): (83.2, 65.7),
    ("maps", "free_accuracy"): (88.1, 81.2),
    ("maps", "free_precision"): (90.9, 86.9),
    ("maps", "free_recall"): (77.0, 49.9),
    ("maps", "semantic_accuracy"): (99.8, 99.7),
    ("maps", "semantic_precision"): (37.4, 26.6),
    ("maps", "semantic_recall"): (30.2, 21.0),
    ("planning", "pointgoal_success"): (39.5, 22.4),
    ("planning", "pointgoal_spl"): (39.0, 21.4),
    ("planning", "objectgoal_success"): (16.0, 9.6),
    ("planning", "objectgoal_spl"): (15.4, 9.1),
    ("pose_refinement", "convergence_rate"): (23.0, 7.2),
    ("pose_refinement", "rotation_error_deg"): (0.283, 0.383),
    ("pose_refinement", "translation_error_m"): (0.00734, 0.00955),
    ("navigation", "success"): (78.4, None),
    ("navigation", "spl"): (67.7, None),
    ("navigation", "success_true_mesh"): (88.1, None),
    ("navigation", "spl_true_mesh"): (73.3, None),
    ("finetuning", "success_pretrained"): (90.2, None),
    ("finetuning", "spl_pretrained"): (82.9, None),
    ("finetuning", "success_finetuned"): (92.9, None),
    ("finetuning", "spl_finetuned"): (86.7, None),
    ("finetuning", "success_finetuned_true_mesh"): (99.7, None),
    ("finetuning", "spl_finetuned_true_mesh"): (97.9, None),
}
FINETUNED = {
    "pretrained": "pre-trained",
    "finetuned": "fine-tuned in the mesh",
    "finetuned_true_mesh": "fine-tuned in the true scene",
}

_COLUMNS, _PAPER_COLUMNS = ("task", "metric", "unit", "value"), ("paper best", "paper frontier")


def _text(value: float | None, status: str = "ok") -> str:
    if value is None:
        return status.split(":", 1)[0] if status != "ok" else "–"  # the reason stands in the row
    return f"{value:.3g}"


class Scores(list[Score]):
    """Rows of one evaluation, in the order of the protocol.

    ``artifacts`` holds the raw material of the pictures (a dict by task) and ``baselines`` other scores to print
    beside these (``oracle``, ``nearest_view``); neither is saved with the rows. What is:

    * ``weights``: SHA-256 of the weights that a metric was computed with (``lpips``, the file; ``lpips_backbone`` and
      ``lpips_heads``, the tensors in it);
    * ``details``, by task: the test poses (x, y in metres, heading in radians) of ``rendering``, how many episodes of
      ``planning`` and ``navigation`` ended how, frames, hours and learning rates of ``finetuning``.

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
        """A row by position, or a value by ``scores[task, metric]`` (KeyError when there is no such row)."""
        if not isinstance(key, tuple):
            return super().__getitem__(key)
        for row in self:
            if (row.task, row.metric) == key:
                return row.value
        raise KeyError(key)

    def _rows(self, baselines: Mapping[str, Iterable[Score]]) -> list[tuple[str, ...]]:
        beside = self.baselines | dict(baselines)
        values = {name: {(r.task, r.metric): r for r in rows} for name, rows in beside.items()}
        compared = any((row.task, row.metric) in PAPER for row in self)
        lines = [(*_COLUMNS, *(_PAPER_COLUMNS if compared else ()), *values)]
        for row in self:
            key = (row.task, row.metric)
            paper = tuple(_text(v) for v in PAPER.get(key, (None, None))) if compared else ()
            others = tuple(_text(by[key].value, by[key].status) if key in by else "–" for by in values.values())
            lines.append((row.task, row.metric, row.unit, _text(row.value, row.status), *paper, *others))
        return lines

    def table(self, **baselines: Iterable[Score]) -> str:
        """Plain text, one line a score, beside the paper's best and frontier figures where it has any.

        Args:
            baselines: columns beside those of ``self.baselines``, such as ``oracle=Scores``.
        """
        return "\n\n".join(map(_aligned, filter(None, (self._rows(baselines), self.practice()))))

    def html(self, **baselines: Iterable[Score]) -> str:
        """The same as HTML; all text is escaped."""
        return "\n".join(map(_html, filter(None, (self._rows(baselines), self.practice()))))

    def practice(self) -> list[tuple[str, ...]]:
        """Fine-tuning as a table, header first, a line a policy: what it reached, and what that took.

        Example:
            >>> scores = Scores([Score("finetuning", "success_finetuned", 92.9, "%")])
            >>> scores.details["finetuning"] = {"finetuned": {"frames": 10_000_000, "hours": 3.25}}
            >>> scores.practice()[2]
            ('fine-tuned in the mesh', '92.9', '–', '10,000,000', '3.25')
        """
        rows = {row.metric: row for row in self if row.task == "finetuning"}
        if not rows:
            return []
        lines: list[tuple[str, ...]] = [("fine-tuning", "success %", "SPL %", "frames", "hours")]
        took = self.details.get("finetuning", {})
        for stage, label in FINETUNED.items():
            found = [rows.get(f"{metric}_{stage}") for metric in ("success", "spl")]
            values = ["–" if row is None else _text(row.value, row.status) for row in found]
            spent = [f"{took[stage][key]:,}" if stage in took else "–" for key in ("frames", "hours")]
            lines.append((label, *values, *spent))
        return lines

    def endings(self, task: str) -> list[tuple[str, ...]]:
        """How many episodes of ``planning`` or ``navigation`` ended how, as a table, header first.

        Example:
            >>> scores = Scores()
            >>> scores.details["planning"] = {"reasons": {"PointGoal": {"no path": 2, "success": 98}}}
            >>> scores.endings("planning")
            [('episodes', 'success', 'no path'), ('PointGoal', '98', '2')]
        """
        reasons = self.details.get(task, {}).get("reasons", {})
        found = {name for counts in reasons.values() for name in counts}
        names = sorted(found, key=lambda name: (name != "success", name))
        rows = [(label, *(str(counts.get(name, 0)) for name in names)) for label, counts in reasons.items()]
        return [("episodes", *names), *rows] if rows else []

    def _repr_html_(self) -> str:
        return self.html()

    def to_frame(self) -> pd.DataFrame:
        """One row a score, one column a field of :class:`~autonerf_lab.types.Score`."""
        return pd.DataFrame([asdict(row) for row in self], columns=[f.name for f in fields(Score)])

    def save(self, path: str | Path) -> None:
        """Write ``scores.json``: rows, ``weights`` and ``details``, not the artifacts.

        Raises:
            DataError: the file cannot be written.
        """
        rows = [asdict(row) for row in self]
        beside = {"weights": self.weights, "details": {task: found for task, found in self.details.items() if found}}
        content = {"version": 1, "scores": rows} | {key: value for key, value in beside.items() if value}
        storage.write_json(path, content)

    @classmethod
    def load(cls, path: str | Path) -> "Scores":
        """Read what :meth:`save` wrote.

        Raises:
            DataError: names the file, and what is wrong with it.
        """
        content = storage.read_json(path)
        rows, weights = content.get("scores"), content.get("weights", {})
        if not isinstance(rows, list):
            raise DataError(f"{path} holds no list 'scores'; run the evaluation again")
        try:
            loaded = [Score(**row) for row in rows]
        except TypeError as error:
            raise DataError(f"{path} holds a row that is not a score: {error}") from error
        for row in loaded:
            number = row.value is None or (isinstance(row.value, int | float) and not isinstance(row.value, bool))
            if not (number and all(isinstance(t, str) for t in (row.task, row.metric, row.unit, row.status))):
                raise DataError(f"{path} holds a row that is not a score: {row}")
        if not isinstance(weights, dict) or not all(isinstance(text, str) for text in weights.values()):
            raise DataError(f"{path}: 'weights' must name a SHA-256 for each metric; run the evaluation again")
        scores = cls(loaded)
        scores.weights.update(weights)
        try:
            scores.details.update(content.get("details", {}))
            shown = scores.practice() + [row for task in scores.details for row in scores.endings(task)]
            " ".join(map("".join, shown))
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise DataError(f"{path}: 'details' is damaged ({error!r}); run the evaluation again") from error
        return scores


def _aligned(lines: Sequence[Sequence[str]]) -> str:
    widths = [max(len(line[i]) for line in lines) for i in range(len(lines[0]))]
    return "\n".join(" | ".join(c.ljust(w) for c, w in zip(line, widths, strict=True)).rstrip() for line in lines)


def _html(lines: Sequence[Sequence[str]]) -> str:
    def row(line: Sequence[str], tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}>{html.escape(c)}</{tag}>" for c in line) + "</tr>"

    head, body = row(lines[0], "th"), "".join(row(line, "td") for line in lines[1:])
    return f"<table class='scores'><thead>{head}</thead><tbody>{body}</tbody></table>"
