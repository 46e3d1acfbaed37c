"""Card of a row of a results table: what was run, by which weights and settings, and its scores, to be handed in."""

from collections.abc import Sequence
from typing import Any

from autonerf_lab.benchmark import paper
from autonerf_lab.benchmark.cell import reward_of
from autonerf_lab.benchmark.grid import is_path, label
from autonerf_lab.benchmark.paper_tables import REFERENCES
from autonerf_lab.benchmark.results import Results
from autonerf_lab.benchmark.results_table import ResultsTable, Row
from autonerf_lab.benchmark.table_entries import difference_entry, published_entry, spread
from autonerf_lab.benchmark.text_table import NO_VALUE, Entry, Table
from autonerf_lab.errors import DataError
from autonerf_lab.version import __version__

_TRAINING = ("command", "frames", "hours", "seed", "network")  # of the file beside the weights


def card(found: ResultsTable, row: Row, folders: Sequence[Results]) -> str:
    """Return the card of a policy and model as Markdown.

    It states the reward, the conditions (scenes, starts, preset, version, digests of weights and settings), the
    training of a learned policy, the headline scores with intervals, and the paired differences to a reference policy.

    Args:
        found: table of ``folders``.
        row: policy and model.
        folders: results.
    """
    results, cell = next((r, c) for r in folders for c in r.grid.cells() if (label(c.policy), c.variant) == row)
    fingerprint, episodes = results.fingerprint, found.episodes[row]
    facts: dict[str, Any] = {
        "policy": row[0],
        "reward": reward_of(row[0]) or NO_VALUE,
        "model": row[1],
        "preset": found.preset,
        "scenes": ", ".join(dict.fromkeys(scene for scene, _ in episodes)),
        "starts": len({start for _, start in episodes}),
        "cells with scores": f"{len(found.values[row])} of {len(episodes)}",
        "table made by": f"autonerf-lab {__version__}",
        "SHA-256 of the weights": (fingerprint.get("weights") or {}).get(row[0], NO_VALUE),
        "SHA-256 of the model's settings": (fingerprint.get("settings") or {}).get(cell.model, NO_VALUE),
        **_training(cell.policy),
    }
    lines = [f"- {name}: {value}" for name, value in facts.items()]
    reference = next(
        (other for name in REFERENCES if (other := (name, row[1])) in found.episodes and other != row), None
    )
    header = ("", "score", f"minus {reference[0]}" if reference else "difference", "paper")
    rows = []
    published = paper.published_scores(row, found.rows)
    for metric in paper.HEADLINES:
        mean = found.interval(row, metric.key)
        apart = found.difference(row, reference, metric.key) if reference else None
        rows.append(
            (
                Entry(metric.full_heading),
                Entry(NO_VALUE if mean is None else spread(mean, metric)),
                difference_entry(apart, metric),
                published_entry(published, metric),
            )
        )
    title = (
        "Means over scenes with 95 % intervals; differences are paired by scene and start, bold: interval without zero"
    )
    return "\n".join(
        [
            f"# {row[0]}, {row[1]}", "", *lines, "", Table("card", title, header, tuple(rows)).markdown(), "",
            "To hand it in, send this file with the results folder (`grid.json`, `cells/`, `scores.csv`), from which "
            "`autonerf-lab bench report` makes the same tables.", "",
        ]
    )  # fmt: skip


def _training(policy: str) -> dict[str, Any]:
    """Return how a learned policy was trained, from the file beside its weights; nothing for any other."""
    from autonerf_lab.policies import weights_path
    from autonerf_lab.policies.weights import read_meta

    if ":" in policy or (is_path(policy) and not policy.endswith(".safetensors")):
        return {}
    try:
        meta = read_meta(weights_path(policy)) if weights_path(policy).exists() else {}
    except DataError:  # results from elsewhere, without the weights
        return {}
    return {f"training: {key}": meta[key] for key in _TRAINING if key in meta}
