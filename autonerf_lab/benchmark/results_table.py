"""All scores of one or several results folders, by who made them."""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields

import pandas as pd

from autonerf_lab.benchmark.fingerprint import mixed
from autonerf_lab.benchmark.grid import label
from autonerf_lab.benchmark.paper import Column, Key
from autonerf_lab.benchmark.results import Outcome, Results
from autonerf_lab.benchmark.statistics import Interval, Runs, difference, interval
from autonerf_lab.errors import RunFolderError
from autonerf_lab.types import Score

Row = tuple[str, str]  # policy, model
Place = tuple[str, int]  # scene, start


@dataclass(frozen=True)
class Collected:
    """The scores of a grid, or of several that share no cell."""

    places: dict[Row, list[Place]]  # that were asked for, whether they have scores or not
    values: dict[Row, dict[Place, dict[Key, float | None]]]  # of finished cells
    outcomes: list[Outcome]
    asked: int  # cells
    preset: str = ""

    @property
    def rows(self) -> list[Row]:
        """Policies and models, in the order of the grids."""
        return list(self.places)

    @property
    def missing(self) -> list[Outcome]:
        """Cells that were run and have no scores."""
        return [outcome for outcome in self.outcomes if not outcome.finished]

    def runs(self, row: Row, key: Key, places: Iterable[Place] | None = None) -> dict[str, list[float]]:
        """The values of a score that there are, by scene."""
        found: dict[str, list[float]] = {}
        for place in self.places[row] if places is None else places:
            value = self.values[row].get(place, {}).get(key)
            if value is not None:
                found.setdefault(place[0], []).append(value)
        return found

    def interval(self, row: Row, key: Key) -> Interval | None:
        """Mean and interval; None when there is no value."""
        found = self.runs(row, key)
        return interval(found) if found else None

    def nulls(self, row: Row, key: Key) -> float:
        """Share of the cells that were run and have no value; 0 for what no cell was asked for."""
        if not any(key in scores for cells in self.values.values() for scores in cells.values()):
            return 0.0
        have = sum(map(len, self.runs(row, key).values()))
        tried = sum(1 for o in self.outcomes if _row(o) == row)
        return 1 - have / tried if tried else 0.0

    def difference(self, row: Row, other: Row, key: Key) -> Interval | None:
        """How much more, over the scenes and starts at which both have a value; None without any."""
        return paired(self, row, self, other, key)

    def best(self, column: Column, rows: Iterable[Row] | None = None) -> Row | None:
        """The one that is better than every other one, as far as paired intervals can say; None when they cannot.

        Args:
            column: of the score.
            rows: that are compared, those that stand in a table; all without.
        """
        rows = [row for row in (self.rows if rows is None else rows) if self.runs(row, column.key)]
        for row in rows if column.better and len(rows) > 1 else ():
            others = [self.difference(row, other, column.key) for other in rows if other != row]
            if all(d is not None and d.clear and d.mean * column.better > 0 for d in others):
                return row
        return None


def paired(mine: Collected, row: Row, theirs: Collected, other: Row, key: Key) -> Interval | None:
    """How much more a row of one collection has than a row of another, where both have a value."""
    both = [
        place
        for place in mine.places[row]
        if mine.values[row].get(place, {}).get(key) is not None
        and theirs.values[other].get(place, {}).get(key) is not None
    ]
    if not both:
        return None
    runs: Runs = mine.runs(row, key, both)
    return difference(runs, theirs.runs(other, key, both))


def collect(*folders: Results) -> Collected:
    """Read everything.

    Raises:
        RunFolderError: two folders hold the same cell, so that a row would mix them; or presets differ, or what is
            behind a name that both have: weights, a scene, settings.
        DataError: a file is damaged.
    """
    presets = {results.grid.preset for results in folders}
    if len(presets) > 1:
        raise RunFolderError(f"results of several presets ({', '.join(sorted(presets))}) do not belong in one table")
    if different := mixed({results.path: results.identity for results in folders}):
        raise RunFolderError(f"{different}; compare them instead")
    places: dict[Row, list[Place]] = {}
    values: dict[Row, dict[Place, dict[Key, float | None]]] = {}
    outcomes: list[Outcome] = []
    for results in folders:
        before = {(row, place) for row in places for place in places[row]}
        for cell in results.grid.cells():
            row, place = (label(cell.policy), cell.model), (label(cell.scene), cell.start)
            if (row, place) in before:
                raise RunFolderError(f"{results.path} and another folder both hold {cell.name}; compare them instead")
            places.setdefault(row, []).append(place)
            values.setdefault(row, {})
        for outcome in results.outcomes():
            outcomes.append(outcome)
            if outcome.finished:
                scores = {(score.task, score.metric): score.value for score in outcome.scores}
                values[_row(outcome)][label(outcome.cell.scene), outcome.cell.start] = scores
    asked = sum(len(results.grid.cells()) for results in folders)
    return Collected(places, values, outcomes, asked, next(iter(presets), ""))


def frame(outcomes: Sequence[Outcome]) -> pd.DataFrame:
    """A line a score, in the order of the grid, with the columns of :class:`~autonerf_lab.types.Score`."""
    rows = [asdict(score) for outcome in outcomes for score in outcome.scores]
    return pd.DataFrame(rows, columns=[field.name for field in fields(Score)])


def _row(outcome: Outcome) -> Row:
    return label(outcome.cell.policy), outcome.cell.model
