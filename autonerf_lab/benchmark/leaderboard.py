"""Leaderboard of any number of results folders, over the scenes and starts that all of them have."""

from collections.abc import Mapping

import numpy as np
from scipy import stats

from autonerf_lab.benchmark import paper
from autonerf_lab.benchmark.paper_tables import BOUNDS
from autonerf_lab.benchmark.results_table import ResultsTable, Row
from autonerf_lab.benchmark.statistics import interval
from autonerf_lab.benchmark.table_entries import spread
from autonerf_lab.benchmark.text_table import NO_VALUE, Entry, Table
from autonerf_lab.errors import RunFolderError


def leaderboard(tables: Mapping[str, ResultsTable]) -> Table:
    """Return the leaderboard: one row per policy and model, by mean rank over the headline scores.

    Policies that know the scene (``oracle-*``) have no rank.

    Args:
        tables: results by name; the name is shown if there are several.

    Raises:
        RunFolderError: the presets differ, or the results have no scene and start in common.
    """
    if len(presets := {found.preset for found in tables.values()}) > 1:
        raise RunFolderError(f"results of several presets ({', '.join(sorted(presets))}) have no common leaderboard")
    rows = [
        (name, row)
        for name, found in tables.items()
        for row in found.rows
        if found.values[row] and not row[0].startswith(BOUNDS)
    ]
    common = set.intersection(*({*tables[name].values[row]} for name, row in rows)) if rows else set()
    if not common:
        raise RunFolderError("the results have no scene and start in common; run the missing ones, or leave a row out")
    ordered = sorted(common)
    means = {
        metric: [
            interval(runs) if (runs := tables[name].runs(row, metric.key, ordered)) else None for name, row in rows
        ]
        for metric in paper.HEADLINES
    }
    ranks = [
        stats.rankdata([np.nan if m is None else -metric.better * m.mean for m in line], nan_policy="omit")
        for metric, line in means.items()
    ]
    with np.errstate(invalid="ignore"):
        mean_ranks = np.array(
            [np.nanmean(column) if np.isfinite(column).any() else np.inf for column in np.array(ranks).T]
        )
    lines = []
    for k in np.argsort(mean_ranks, kind="stable"):
        name, row = rows[k]
        rank = f"{mean_ranks[k]:.1f}" if np.isfinite(mean_ranks[k]) else NO_VALUE
        found = [line[k] for line in means.values()]
        entries = [NO_VALUE if m is None else spread(m, metric) for m, metric in zip(found, means, strict=True)]
        lines.append(tuple(map(Entry, (title(name if len(tables) > 1 else "", row), rank, *entries))))
    scenes = len({scene for scene, _ in common})
    note = (
        f"Means over the {len(common)} episodes in {scenes} scenes that all rows have, with 95 % intervals. The rank "
        "is the mean over the scores. It does not show whether a difference is significant: see the paired differences."
    )
    header = ("", "Mean rank", *(metric.heading for metric in paper.HEADLINES))
    return Table("leaderboard", "Leaderboard", header, tuple(lines), note)


def title(name: str, row: Row) -> str:
    """Return the title of a row, with the name of its results folder if there are several.

    Example:
        >>> title("mine", ("modular-obs", "instant-ngp"))
        'modular-obs, instant-ngp (mine)'
    """
    return f"{row[0]}, {row[1]}" + (f" ({name})" if name else "")
