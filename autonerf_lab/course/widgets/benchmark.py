"""Comparison of two policies, score by score."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from autonerf_lab.benchmark.results_table import ResultsTable, Row
from autonerf_lab.benchmark.statistics import Interval
from autonerf_lab.course.widgets.live import LiveFigure, escape_dollars
from autonerf_lab.evaluators.metrics import Metric
from autonerf_lab.viz.figures.style import BLUE, ORANGE, SKY


class PolicyComparison(LiveFigure):
    """Paired comparison of two policies: one score of both in every scene, and the paired differences.

    Args:
        results: scores of a benchmark grid.
        metrics: scores to choose from.
        first: index of the row of ``results`` that is selected as the first policy.
        second: index of the row that is selected as the second policy.

    Example:
        >>> values = {("a", 0): {("t", "m"): 1.0}, ("b", 0): {("t", "m"): 5.0}}
        >>> better = {run: {key: v + 1 for key, v in scores.items()} for run, scores in values.items()}
        >>> rows = {("old", "x"): values, ("new", "x"): better}
        >>> results = ResultsTable({row: list(cells) for row, cells in rows.items()}, rows, [], 4)
        >>> print(PolicyComparison(results, [Metric("t", "m", "", "Score", 1)]).difference)
        1.0 ± 0.0
    """

    def __init__(self, results: ResultsTable, metrics: list[Metric], first: int = 0, second: int = 1) -> None:
        super().__init__()
        self._results = results
        rows = [(f"{policy}, {model}", (policy, model)) for policy, model in results.rows]
        choices: dict[str, tuple[list[tuple[str, Any]], Any]] = {
            "first": (rows, rows[first][1]),
            "second": (rows, rows[second][1]),
            "score": ([(metric.heading, metric) for metric in metrics], metrics[0]),
        }
        self.selected = {
            name: self.widgets.Dropdown(options=options, value=value, description=name)
            for name, (options, value) in choices.items()
        }
        for menu in self.selected.values():
            menu.observe(self.refresh, "value")
        self.refresh()

    @property
    def difference(self) -> Interval | None:
        """Mean and interval of second minus first, paired; None if no run has both."""
        first, second, metric = self._selection()
        return self._results.difference(second, first, metric.key)

    def controls(self) -> list[Any]:
        """Return three menus: two policies and a score."""
        return list(self.selected.values())

    def figure(self) -> Figure:
        """Draw both policies in every scene (left), and the differences with two intervals (right)."""
        first, second, metric = self._selection()
        a_runs, b_runs = (
            {run: value * metric.scale for run, cells in self._results.values[row].items()
             if (value := cells.get(metric.key)) is not None}
            for row in (first, second)
        )  # fmt: skip
        pairs = {run: (a_runs[run], b) for run, b in b_runs.items() if run in a_runs}
        scenes = list(dict.fromkeys(scene for scene, _ in pairs))
        figure = Figure(figsize=(11, 3.6), layout="constrained")
        both, differences = figure.subplots(1, 2, width_ratios=(1.2, 1))
        for (scene, _), (a, b) in pairs.items():
            x = scenes.index(scene)
            both.plot([x - 0.15, x + 0.15], [a, b], color="0.7", linewidth=1)
            both.plot(x - 0.15, a, "o", color=ORANGE)
            both.plot(x + 0.15, b, "o", color=BLUE)
            differences.plot(b - a, 1 + 0.5 * (x + 1) / (len(scenes) + 1), ".", color=SKY)
        for row, color in ((first, ORANGE), (second, BLUE)):
            both.plot([], [], "o", color=color, label=escape_dollars(row[0]))
        both.set(
            xticks=range(len(scenes)), xticklabels=[escape_dollars(scene) for scene in scenes], ylabel=metric.heading
        )
        figure.legend(*both.get_legend_handles_labels(), loc="outside upper left", ncols=2, frameon=False)
        self._draw_intervals(differences, metric)
        return figure

    def _draw_intervals(self, ax: Any, metric: Metric) -> None:
        first, second, _ = self._selection()
        paired = self.difference
        single = [self._results.interval(row, metric.key) for row in (first, second)]
        ax.axvline(0, color="0.5", linewidth=1)
        if paired is not None and single[0] is not None and single[1] is not None:
            mean, half = metric.scale * paired.mean, metric.scale * paired.half_width
            unpaired = metric.scale * float(np.hypot(single[0].half_width, single[1].half_width))
            for y, width, color in ((0.6, half, BLUE), (0.2, unpaired, "0.6")):
                ax.errorbar(mean, y, xerr=np.nan_to_num(width), fmt="o", color=color, capsize=4)
            ax.set_title(f"{mean:+.2f} ± {half:.2f}", fontsize=11)
        ax.set(
            ylim=(0, 1.6),
            yticks=(0.2, 0.6, 1.25),
            yticklabels=("interval, unpaired", "interval, paired", "single runs"),
        )
        ax.set_xlabel(escape_dollars(f"{metric.heading}: {second[0]} − {first[0]}"))

    def _selection(self) -> tuple[Row, Row, Metric]:
        return self.selected["first"].value, self.selected["second"].value, self.selected["score"].value
