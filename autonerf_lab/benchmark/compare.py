"""Two results folders, score by score, paired by scene and start."""

from autonerf_lab.benchmark import paper
from autonerf_lab.benchmark.paper_tables import difference_entry
from autonerf_lab.benchmark.results_table import Collected, Row, paired
from autonerf_lab.benchmark.text_table import Entry, Table
from autonerf_lab.errors import RunFolderError

COLUMNS = (
    *paper.RENDERING, *paper.MAPS, *paper.PLANNING, *paper.POSE, *paper.MESH, *paper.NAVIGATION, *paper.FINETUNING,
    *paper.EXPLORATION,
)  # fmt: skip


def compare(first: Collected, second: Collected) -> Table:
    """How much more the second has than the first: a column a pair, a row a score.

    Rows of the same policy and model are pairs; without any, every row of the second is compared with every one of the
    first that has the same model, or any model where there is none.

    Raises:
        RunFolderError: no scene and start has scores in both, or they are of different presets.
    """
    if first.preset != second.preset:
        raise RunFolderError(
            f"one folder is of preset {first.preset}, the other of {second.preset}: walks, fields and tests differ "
            "in size, so that a difference would say nothing about policies or models"
        )
    pairs = _pairs(first, second)
    lines = []
    for column in COLUMNS:
        found = [paired(second, mine, first, other, column.key) for mine, other in pairs]
        if any(d is not None for d in found):
            entries = [difference_entry(d, column) for d in found]
            lines.append((Entry(f"{column.task.replace('_', ' ')}: {column.title}"), *entries))
    if not lines:
        raise RunFolderError("the two folders have no scene and start in common that both have scores for")
    header = ("", *(_title(mine, other) for mine, other in pairs))
    title = "Second minus first, paired by scene and start; in bold where the 95 % interval does not hold zero"
    return Table("compare", title, header, tuple(lines))


def _pairs(first: Collected, second: Collected) -> list[tuple[Row, Row]]:
    same = [(row, row) for row in second.rows if row in first.places]
    every = [(mine, other) for mine in second.rows for other in first.rows]
    return same or [(mine, other) for mine, other in every if mine[1] == other[1]] or every


def _title(mine: Row, other: Row) -> str:
    if mine == other:
        return f"{mine[0]}, {mine[1]}"
    if mine[1] == other[1]:
        return f"{mine[0]} − {other[0]}"
    return f"{mine[0]}, {mine[1]} − {other[0]}, {other[1]}"
