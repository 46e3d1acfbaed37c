"""What benchmarks write down."""

import csv
from pathlib import Path
from typing import Any

import numpy as np


def write_csv(path: Path, rows: list[dict[str, Any]]) -> None:
    """Columns are those of the first row; numbers rounded, what is missing empty."""
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        for row in rows:
            writer.writerow({key: round(v, 4) if isinstance(v, float) else v for key, v in row.items()})


def mean_of(rows: list[dict[str, Any]], key: str) -> float | None:
    """Of a column; None where there is nothing to average."""
    values = [row[key] for row in rows if row[key] is not None]
    return float(np.mean(values)) if values else None
