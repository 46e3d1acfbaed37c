"""Tables and saved results of benchmarks."""

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np

from autonerf_lab.nerf.checkpoint import settings_to_json
from autonerf_lab.nerf.models import model_spec
from autonerf_lab.utils.storage import read_json


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


def saved_result(path: Path, identity: dict[str, Any]) -> dict[str, Any] | None:
    """Return the content of a JSON file if its ``identity`` is this one, else None; tuples and lists are equal."""
    found = read_json(path, dict[str, Any]) if path.exists() else {}
    return found if found.get("identity") == json.loads(json.dumps(identity)) else None


def model_settings(model: str, preset: str) -> dict[str, Any]:
    """Return the settings of a model in a preset, as a part of an identity."""
    return settings_to_json(model_spec(model).settings_for(preset))


def slug(name: str) -> str:
    """Return a file name: ``"2^16 entries per level"`` becomes ``"2-16-entries-per-level"``."""
    words = "".join(letter if letter.isalnum() or letter == "." else " " for letter in name).split()
    return "-".join(words)
