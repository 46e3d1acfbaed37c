"""What is made from the cells of a results folder, whenever somebody asks: CSV, Parquet, tables."""

import io
from importlib.util import find_spec
from pathlib import Path

import pandas as pd

from autonerf_lab.benchmark.paper_tables import all_tables
from autonerf_lab.benchmark.results import Results
from autonerf_lab.benchmark.results_table import Collected, collect, frame
from autonerf_lab.benchmark.text_table import escaped
from autonerf_lab.utils import storage

TIMES = "seconds"  # the only column of scores.csv that differs when a grid is run again


def publish(results: Results) -> list[Path]:
    """Write ``scores.csv``, ``scores.parquet`` (with pyarrow), ``tables.md``, ``tables.tex`` and ``tables.html``.

    Returns:
        Their paths.

    Raises:
        DataError: a cell is damaged, or no space is left.
    """
    found = collect(results)
    rows = frame(found.outcomes)
    tables = all_tables(found)
    words = escaped(summary(found))
    files = {
        "scores.csv": rows.to_csv(index=False, lineterminator="\n").encode(),
        "tables.md": ("\n\n".join([words, *(table.markdown() for table in tables)]) + "\n").encode(),
        "tables.tex": ("\n\n".join(table.latex() for table in tables) + "\n").encode(),
        "tables.html": "\n".join(table.html() for table in tables).encode(),
    }
    if find_spec("pyarrow") is not None:
        files["scores.parquet"] = _parquet(rows)
    for name, data in files.items():
        storage.write_bytes(results.path / name, data)
    return [results.path / name for name in files]


def headline(found: Collected) -> str:
    """How much of the grid there is."""
    finished = sum(outcome.finished for outcome in found.outcomes)
    return f"{finished} of {found.asked} cells; intervals are 95 % (Student's t on the means of scenes)."


def summary(found: Collected) -> str:
    """How much of the grid there is, and what became of the rest: a line a cell."""
    return "\n".join([headline(found), *(f"- {o.cell.name}: {o.status}" for o in found.missing)])


def _parquet(rows: pd.DataFrame) -> bytes:
    data = io.BytesIO()
    rows.to_parquet(data, engine="pyarrow", index=False)
    return data.getvalue()
