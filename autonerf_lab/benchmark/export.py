"""Export of results: scores as CSV and Parquet, tables as Markdown, LaTeX and HTML."""

import io
from collections.abc import Iterable
from importlib.util import find_spec
from pathlib import Path

import pandas as pd

from autonerf_lab.benchmark.paper_tables import all_tables
from autonerf_lab.benchmark.results_table import ResultsTable, scores_frame
from autonerf_lab.benchmark.text_table import Table, escaped
from autonerf_lab.utils import storage

TIMES = "seconds"  # the only column of scores.csv that is not reproducible


def export_results(found: ResultsTable, out: Path) -> list[Path]:
    """Write ``scores.csv``, ``scores.parquet`` (needs pyarrow), ``tables.md``, ``tables.tex`` and ``tables.html``.

    Args:
        found: Results of one or several folders.
        out: Output folder.

    Returns:
        Paths of the files.

    Raises:
        DataError: The disk is full, or the folder is not writable.
    """
    rows = scores_frame(found.outcomes)
    files = {"scores.csv": rows.to_csv(index=False, lineterminator="\n").encode(), **table_files(found)}
    if find_spec("pyarrow") is not None:
        files["scores.parquet"] = _parquet(rows)
    for name, data in files.items():
        storage.write_bytes(out / name, data)
    return [out / name for name in files]


def table_files(found: ResultsTable) -> dict[str, bytes]:
    """Return the contents of ``tables.md``, ``tables.tex`` and ``tables.html`` by name."""
    made = all_tables(found)
    tables = [table for table in made if table.filled]
    lines = [summary(found), *(f"- {text}" for text in left_out(made))]
    markdown = [escaped("\n".join(lines)), *(table.markdown() for table in tables)]
    return {
        "tables.md": ("\n\n".join(markdown) + "\n").encode(),
        "tables.tex": ("\n\n".join(table.latex() for table in tables) + "\n").encode(),
        "tables.html": "\n".join(table.html() for table in tables).encode(),
    }


def headline(found: ResultsTable) -> str:
    """Return the number of finished cells and the kind of intervals, in one line."""
    finished = sum(outcome.finished for outcome in found.outcomes)
    return f"{finished} of {found.cell_count} cells; intervals are 95 % (Student's t on the means of scenes)."


def summary(found: ResultsTable) -> str:
    """Return the headline, and one line per cell that was run and has no scores."""
    return "\n".join([headline(found), *(f"- {o.cell.name}: {o.status}" for o in found.unfinished)])


def left_out(tables: Iterable[Table]) -> list[str]:
    """Return the names of the tables without values, each with the reason."""
    return [f"No table {table.name}: {table.note}" for table in tables if not table.filled]


def _parquet(rows: pd.DataFrame) -> bytes:
    data = io.BytesIO()
    rows.to_parquet(data, engine="pyarrow", index=False)
    return data.getvalue()
