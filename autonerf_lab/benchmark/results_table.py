"""Results table: scores of one or several results folders, by policy and model."""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any

import pandas as pd

from autonerf_lab.benchmark.fingerprint import find_conflict
from autonerf_lab.benchmark.grid import CONDITIONS, label
from autonerf_lab.benchmark.results import Outcome, Results
from autonerf_lab.benchmark.statistics import Interval, Runs, difference, interval
from autonerf_lab.errors import RunFolderError
from autonerf_lab.evaluators.metrics import Key, Metric
from autonerf_lab.types import Score

Row = tuple[str, str]  # policy; model, with noise and pose source if they are set
Episode = tuple[str, int]  # scene, start
Values = dict[Row, dict[Episode, dict[Key, float | None]]]


@dataclass(frozen=True)
class ResultsTable:
    """Scores of one grid, or of several grids without common cells."""

    episodes: dict[Row, list[Episode]]  # of the grids, with or without scores
    values: Values  # scores of finished cells
    outcomes: list[Outcome]  # of all cells that were run
    cell_count: int  # of the grids
    preset: str = ""  # name of the preset
    conditions: dict[Row, dict[str, Any]] = field(default_factory=dict)  # noise, pose source, source of classes
    baselines: dict[str, Values] = field(default_factory=dict)  # scores of the baselines of the same cells, by name

    @property
    def rows(self) -> list[Row]:
        """Pairs of policy and model, in the order of the grids."""
        return list(self.episodes)

    @property
    def noisy(self) -> list[Row]:
        """Rows with noise of motion or depth."""
        return [row for row in self.rows if {"noise", "depth_noise"} & self.conditions.get(row, {}).keys()]

    @property
    def predicted(self) -> list[Row]:
        """Rows without noise, whose classes are not those of the simulator."""
        return [row for row in self.rows if "semantics" in self.conditions.get(row, {}) and row not in self.noisy]

    @property
    def unfinished(self) -> list[Outcome]:
        """Outcomes of cells that were run and have no scores."""
        return [outcome for outcome in self.outcomes if not outcome.finished]

    def of_baseline(self, name: str) -> "ResultsTable":
        """Return the table with the scores of a baseline in place of those of the field."""
        return replace(self, values={row: {} for row in self.episodes} | self.baselines[name], baselines={})

    def runs(self, row: Row, key: Key, episodes: Iterable[Episode] | None = None) -> dict[str, list[float]]:
        """Return the values of a score by scene; ``episodes`` limits them to some episodes."""
        found: dict[str, list[float]] = {}
        for episode in self.episodes[row] if episodes is None else episodes:
            value = self.values[row].get(episode, {}).get(key)
            if value is not None:
                found.setdefault(episode[0], []).append(value)
        return found

    def interval(self, row: Row, key: Key) -> Interval | None:
        """Return the mean of a score and its confidence interval; None without values."""
        found = self.runs(row, key)
        return interval(found) if found else None

    def null_share(self, row: Row, key: Key) -> float:
        """Return the share of the run cells of a row without a value of a score; 0 if none of them computes it.

        If no cell of the row has finished, the cells of all rows decide whether they compute it.
        """
        cells = self.values[row].values() or [scores for cells in self.values.values() for scores in cells.values()]
        if not any(key in scores for scores in cells):
            return 0.0
        with_value = sum(map(len, self.runs(row, key).values()))
        run = sum(1 for o in self.outcomes if _row(o) == row)
        return 1 - with_value / run if run else 0.0

    def difference(self, row: Row, other: Row, key: Key) -> Interval | None:
        """Return the paired difference of two rows, see :func:`paired_difference`."""
        return paired_difference(self, row, self, other, key)

    def score_difference(self, row: Row, key: Key, other: Key) -> Interval | None:
        """Return the difference of two scores of the same cells, the first minus the second."""
        swapped = {episode: {key: scores.get(other)} for episode, scores in self.values[row].items()}
        return paired_difference(self, row, replace(self, values={**self.values, row: swapped}), row, key)

    def best(self, metric: Metric, rows: Iterable[Row] | None = None) -> Row | None:
        """Return the row that is significantly better than every other row, or None.

        Args:
            metric: Metric to compare.
            rows: Rows to compare; None: all.
        """
        rows = [row for row in (self.rows if rows is None else rows) if self.runs(row, metric.key)]
        for row in rows if metric.better and len(rows) > 1 else ():
            others = [self.difference(row, other, metric.key) for other in rows if other != row]
            if all(d is not None and d.excludes_zero and d.mean * metric.better > 0 for d in others):
                return row
        return None


def paired_difference(first: ResultsTable, row: Row, second: ResultsTable, other: Row, key: Key) -> Interval | None:
    """Return the mean difference of a score over the episodes with values in both rows; None if there are none."""
    both = [
        episode
        for episode in first.episodes[row]
        if first.values[row].get(episode, {}).get(key) is not None
        and second.values[other].get(episode, {}).get(key) is not None
    ]
    if not both:
        return None
    runs: Runs = first.runs(row, key, both)
    return difference(runs, second.runs(other, key, both))


def load_results_table(*folders: Results) -> ResultsTable:
    """Load the scores of one or several results folders into one table.

    Raises:
        RunFolderError: Two folders hold the same cell, have different presets, or have different weights, scenes or
            settings of the same name.
        DataError: A file is damaged.
    """
    presets = {results.grid.preset for results in folders}
    if len(presets) > 1:
        raise RunFolderError(f"results of several presets ({', '.join(sorted(presets))}) cannot share one table")
    if different := find_conflict({results.path: results.fingerprint for results in folders}):
        raise RunFolderError(f"{different}; compare the folders with `autonerf-lab bench compare`")
    episodes: dict[Row, list[Episode]] = {}
    values: Values = {}
    baselines: dict[str, Values] = {}
    outcomes: list[Outcome] = []
    conditions: dict[Row, dict[str, Any]] = {}
    for results in folders:
        before = {(row, episode) for row in episodes for episode in episodes[row]}
        for cell in results.grid.cells():
            row, episode = (label(cell.policy), cell.variant), (label(cell.scene), cell.start)
            if (row, episode) in before:
                raise RunFolderError(
                    f"{results.path} and another folder both hold {cell.name}; compare the folders with `autonerf-lab "
                    "bench compare`"
                )
            conditions[row] = cell.conditions
            episodes.setdefault(row, []).append(episode)
            values.setdefault(row, {})
        for outcome in results.outcomes():
            outcomes.append(outcome)
            if outcome.finished:
                row, episode = _row(outcome), (label(outcome.cell.scene), outcome.cell.start)
                values[row][episode] = _by_key(outcome.scores)
                for name, rows in outcome.baselines.items():
                    baselines.setdefault(name, {}).setdefault(row, {})[episode] = _by_key(rows)
    cell_count = sum(len(results.grid.cells()) for results in folders)
    preset = next(iter(presets), "")
    return ResultsTable(episodes, values, outcomes, cell_count, preset, conditions, baselines)


def _by_key(scores: Iterable[Score]) -> dict[Key, float | None]:
    return {(score.task, score.metric): score.value for score in scores}


def scores_frame(outcomes: Sequence[Outcome]) -> pd.DataFrame:
    """Return one row per score in grid order, with the fields of :class:`~autonerf_lab.types.Score` as columns.

    Results with noise or another pose source have columns for them, too.
    """
    found = [key for key in CONDITIONS if any(key in outcome.cell.conditions for outcome in outcomes)]
    rows = [
        asdict(score) | {key: outcome.cell.conditions.get(key) for key in found}
        for outcome in outcomes
        for score in outcome.scores
    ]
    return pd.DataFrame(rows, columns=[*(field.name for field in fields(Score)), *found])


def _row(outcome: Outcome) -> Row:
    return label(outcome.cell.policy), outcome.cell.variant
