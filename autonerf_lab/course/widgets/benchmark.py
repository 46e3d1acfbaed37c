"""Set two policies against each other, score by score."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from autonerf_lab.benchmark.paper import Column
from autonerf_lab.benchmark.results_table import Collected, Row
from autonerf_lab.benchmark.statistics import Interval
from autonerf_lab.course.widgets.live import Live, plain
from autonerf_lab.viz.figures.style import BLUE, ORANGE, SKY


class Pairs(Live):
    """Choose two policies and a score: both in every scene, and the differences, pair by pair.

    Args:
        found: scores of a grid.
        columns: the scores to choose from.
        first: index of a row of ``found``, chosen at first.
        second: of another one.

    Example:
        >>> values = {("a", 0): {("t", "m"): 1.0}, ("b", 0): {("t", "m"): 5.0}}
        >>> more = {place: {key: v + 1 for key, v in scores.items()} for place, scores in values.items()}
        >>> rows = {("old", "x"): values, ("new", "x"): more}
        >>> found = Collected({row: list(cells) for row, cells in rows.items()}, rows, [], 4)
        >>> print(Pairs(found, [Column("t", "m", "Score", 1)]).difference)
        1.0 ± 0.0
    """

    def __init__(self, found: Collected, columns: list[Column], first: int = 0, second: int = 1) -> None:
        super().__init__()
        self._found = found
        rows = [(f"{policy}, {model}", (policy, model)) for policy, model in found.rows]
        choices: dict[str, tuple[list[tuple[str, Any]], Any]] = {
            "first": (rows, rows[first][1]),
            "second": (rows, rows[second][1]),
            "score": ([(column.title, column) for column in columns], columns[0]),
        }
        self.chosen = {
            name: self.widgets.Dropdown(options=options, value=value, description=name)
            for name, (options, value) in choices.items()
        }
        for menu in self.chosen.values():
            menu.observe(self.refresh, "value")
        self.refresh()

    @property
    def difference(self) -> Interval | None:
        """The second minus the first, paired; None where no scene and start has both."""
        first, second, column = self._now()
        return self._found.difference(second, first, column.key)

    def controls(self) -> list[Any]:
        """Menus: two policies and a score."""
        return list(self.chosen.values())

    def figure(self) -> Figure:
        """Left, both in every scene, a line a pair. Right, the differences with two intervals."""
        first, second, column = self._now()
        a_runs, b_runs = (
            {place: value * column.scale for place, cells in self._found.values[row].items()
             if (value := cells.get(column.key)) is not None}
            for row in (first, second)
        )  # fmt: skip
        pairs = {place: (a_runs[place], b) for place, b in b_runs.items() if place in a_runs}
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
            both.plot([], [], "o", color=color, label=plain(row[0]))
        both.set(xticks=range(len(scenes)), xticklabels=[plain(scene) for scene in scenes], ylabel=column.title)
        figure.legend(*both.get_legend_handles_labels(), loc="outside upper left", ncols=2, frameon=False)
        self._draw_intervals(differences, column)
        return figure

    def _draw_intervals(self, ax: Any, column: Column) -> None:
        first, second, _ = self._now()
        paired = self.difference
        alone = [self._found.interval(row, column.key) for row in (first, second)]
        ax.axvline(0, color="0.5", linewidth=1)
        if paired is not None and alone[0] is not None and alone[1] is not None:
            mean, half = column.scale * paired.mean, column.scale * paired.half
            apart = column.scale * float(np.hypot(alone[0].half, alone[1].half))
            for y, width, color in ((0.6, half, BLUE), (0.2, apart, "0.6")):
                ax.errorbar(mean, y, xerr=np.nan_to_num(width), fmt="o", color=color, capsize=4)
            ax.set_title(f"{mean:+.2f} ± {half:.2f}", fontsize=11)
        ax.set(ylim=(0, 1.6), yticks=(0.2, 0.6, 1.25), yticklabels=("not paired", "paired", "each pair"))
        ax.set_xlabel(plain(f"{column.title}: {second[0]} − {first[0]}"))

    def _now(self) -> tuple[Row, Row, Column]:
        return self.chosen["first"].value, self.chosen["second"].value, self.chosen["score"].value
