"""Comparison of two results tables, paired by scene and start."""

from autonerf_lab.benchmark import paper
from autonerf_lab.benchmark.results_table import ResultsTable, Row, paired_difference
from autonerf_lab.benchmark.table_entries import difference_entry
from autonerf_lab.benchmark.text_table import Entry, Table
from autonerf_lab.errors import RunFolderError

METRICS = (
    *paper.RENDERING, *paper.MAPS, *paper.PLANNING, *paper.POSE, *paper.MESH, *paper.NAVIGATION, *paper.FINETUNING,
    *paper.EXPLORATION,
)  # fmt: skip


def compare(first: ResultsTable, second: ResultsTable) -> Table:
    """Return the table of score differences, second minus first: one column per pair, one row per score.

    Rows with the same policy and model are compared. If there are none, each row of the second table is compared with
    every row of the first that has the same model; if there are none either, with every row of the first.

    Raises:
        RunFolderError: No scene and start has scores in both tables, or the presets differ.
    """
    if first.preset != second.preset:
        raise RunFolderError(
            f"the first folder has preset {first.preset}, the second {second.preset}: their scores cannot be compared; "
            "run both grids with the same preset"
        )
    pairs = _pairs(first, second)
    lines = []
    for metric in METRICS:
        found = [paired_difference(second, row, first, other, metric.key) for row, other in pairs]
        if any(d is not None for d in found):
            entries = [difference_entry(d, metric) for d in found]
            lines.append((Entry(metric.full_heading), *entries))
    if not lines:
        raise RunFolderError("the two folders have no scores of the same scene and start")
    header = ("", *(_title(row, other) for row, other in pairs))
    title = "Differences, second minus first, paired by scene and start; bold: the 95 % interval excludes zero"
    return Table("compare", title, header, tuple(lines))


def _pairs(first: ResultsTable, second: ResultsTable) -> list[tuple[Row, Row]]:
    same = [(row, row) for row in second.rows if row in first.episodes]
    every = [(row, other) for row in second.rows for other in first.rows]
    return same or [(row, other) for row, other in every if row[1] == other[1]] or every


def _title(row: Row, other: Row) -> str:
    if row == other:
        return f"{row[0]}, {row[1]}"
    if row[1] == other[1]:
        return f"{row[0]} − {other[0]}"
    return f"{row[0]}, {row[1]} − {other[0]}, {other[1]}"
