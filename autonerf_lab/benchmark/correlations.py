"""Pearson correlation of summed rewards and scores of the radiance field (appendix of the paper)."""

import numpy as np
from scipy import stats

from autonerf_lab.benchmark.paper import CORRELATED, CORRELATIONS, Key
from autonerf_lab.benchmark.results_table import ResultsTable
from autonerf_lab.benchmark.text_table import NO_VALUE, Entry, Table

REWARDS = ("cov", "sem", "obs", "view")
POLICIES = tuple(f"modular-{reward}" for reward in REWARDS)  # their trajectories are the points
LEVEL = 0.05
MIN_POINTS = 5  # fewer are significant only if they lie on a line


def pearson(x: list[float], y: list[float]) -> tuple[float, float] | None:
    """Return Pearson's r and its p-value; None for fewer than five points or constant values.

    Example:
        >>> pearson([1.0, 2.0, 3.0, 4.0, 5.0], [1.0, 2.0, 3.0, 4.0, 5.0])[0]
        1.0
        >>> pearson([1.0] * 5, [1.0, 2.0, 3.0, 4.0, 5.0]) is None
        True
    """
    if len(x) < MIN_POINTS or np.ptp(x) == 0 or np.ptp(y) == 0:
        return None
    found = stats.pearsonr(x, y)
    return round(float(found.statistic), 12), float(found.pvalue)


def points(found: ResultsTable, scene: str, reward: str, key: Key) -> tuple[list[float], list[float]]:
    """Return the summed rewards and scores of the trajectories in a scene that have both.

    The trajectories are those of the paper's four modular policies or, without any, of all policies; the fields are
    those of the first model.
    """
    rows = [row for row in found.rows if row[1] == found.rows[0][1]]
    rows = [row for row in rows if row[0] in POLICIES] or rows
    cells = [
        found.values[row][episode]
        for row in rows
        for episode in found.episodes[row]
        if episode in found.values[row] and episode[0] == scene
    ]
    pairs = [(cell.get(("reward", reward)), cell.get(key)) for cell in cells]
    both = [(x, y) for x, y in pairs if x is not None and y is not None]
    return [x for x, _ in both], [y for _, y in both]


def correlations(found: ResultsTable) -> Table:
    """Return the table of correlations: one row per score and reward, one column per scene, ours and the paper's."""
    scenes = list(dict.fromkeys(scene for row in found.rows for scene, _ in found.episodes[row]))
    lines, counts, measured = [], set(), False
    for metric in CORRELATED:
        for reward in REWARDS:
            line = [Entry(f"{metric.label}, {reward}")]
            for scene in scenes:
                x, y = points(found, scene, reward, metric.key)
                counts.add(len(x))
                line.append(_entry(pearson(x, y)))
                measured |= line[-1].text != NO_VALUE
            published = CORRELATIONS[reward, metric.key]
            lines.append((*line, *(Entry(NO_VALUE if r == "-" else f"0{r}") for r in published)))
    title = "Correlation of summed rewards and scores: Pearson's r (with p in brackets unless p < 5 %)"
    header = ("", *scenes, *(f"paper {k}" for k in range(5)))
    size = f"{min(counts)} to {max(counts)}" if len(counts) > 1 else f"{max(counts)}"
    policies = "the modular policies" if any(policy in POLICIES for policy, _ in found.rows) else "all policies"
    note = f"{size} points per scene: trajectories of {policies}, fields of {found.rows[0][1]}."
    note += " Columns paper 0 to 4: the paper's scenes."
    note = note if measured else f"Too few points. {note}"
    return Table("correlations", title, header, tuple(lines), note)


def _entry(found: tuple[float, float] | None) -> Entry:
    if found is None:
        return Entry(NO_VALUE)
    r, p = found
    return Entry(f"{r:.2f}") if p < LEVEL else Entry(f"({r:.2f}, p {p:.2f})")
