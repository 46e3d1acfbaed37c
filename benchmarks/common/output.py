"""Tables of benchmark results."""

import csv
from pathlib import Path
from typing import Any

import numpy as np


def write_csv(path: Path, rows: list[dict[str, Any]]) -> None:
    """Write rows as CSV: columns of the first row, floats rounded to 4 decimals, None as an empty cell."""
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        for row in rows:
            writer.writerow({key: round(v, 4) if isinstance(v, float) else v for key, v in row.items()})


def mean_of(rows: list[dict[str, Any]], key: str) -> float | None:
    """Return the mean of a column without its missing values; None if all are missing."""
    values = [row[key] for row in rows if row[key] is not None]
    return float(np.mean(values)) if values else None
