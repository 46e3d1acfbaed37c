"""Does a reward tell what a field will be worth? Pearson's r of summed rewards and scores (the paper's appendix)."""

import numpy as np
from scipy import stats

from autonerf_lab.benchmark.paper import CORRELATED, CORRELATIONS, Key
from autonerf_lab.benchmark.results_table import Collected
from autonerf_lab.benchmark.text_table import NO_VALUE, Entry, Table

REWARDS = ("cov", "sem", "obs", "view")
POLICIES = tuple(f"modular-{reward}" for reward in REWARDS)  # whose walks are the points
LEVEL = 0.05
FEWEST = 3  # points that a correlation is computed from


def pearson(x: list[float], y: list[float]) -> tuple[float, float] | None:
    """Correlation r and its p; None for fewer than three points, or where one side never changes.

    Example:
        >>> pearson([1.0, 2.0, 3.0], [1.0, 2.0, 3.0])[0]
        1.0
        >>> pearson([1.0, 1.0, 1.0], [1.0, 2.0, 3.0]) is None
        True
    """
    if len(x) < FEWEST or np.ptp(x) == 0 or np.ptp(y) == 0:
        return None
    found = stats.pearsonr(x, y)
    return round(float(found.statistic), 12), float(found.pvalue)


def points(found: Collected, scene: str, reward: str, key: Key) -> tuple[list[float], list[float]]:
    """Reward and score of the walks in a scene that have both: of the paper's four policies, or of all without.

    The fields are those of the first model.
    """
    rows = [row for row in found.rows if row[1] == found.rows[0][1]]
    rows = [row for row in rows if row[0] in POLICIES] or rows
    cells = [found.values[row][place] for row in rows for place in found.places[row] if place in found.values[row]
             and place[0] == scene]  # fmt: skip
    pairs = [(cell.get(("reward", reward)), cell.get(key)) for cell in cells]
    both = [(x, y) for x, y in pairs if x is not None and y is not None]
    return [x for x, _ in both], [y for _, y in both]


def correlations(found: Collected) -> Table:
    """A row a score and a reward, a column a scene; the paper's five scenes beside."""
    scenes = list(dict.fromkeys(scene for row in found.rows for scene, _ in found.places[row]))
    lines, counts, measured = [], set(), False
    for column in CORRELATED:
        for reward in REWARDS:
            line = [Entry(f"{column.title.split(' [')[0]}, {reward}")]
            for scene in scenes:
                x, y = points(found, scene, reward, column.key)
                counts.add(len(x))
                line.append(_entry(pearson(x, y)))
                measured |= line[-1].text != NO_VALUE
            published = CORRELATIONS[reward, column.key]
            lines.append((*line, *(Entry(NO_VALUE if r == "-" else f"0{r}") for r in published)))
    title = "Correlation of summed rewards with scores: Pearson's r (p in brackets; r alone where p < 5 %)"
    header = ("", *scenes, *(f"paper {k}" for k in range(5)))
    size = f"{min(counts)} to {max(counts)}" if len(counts) > 1 else f"{max(counts)}"
    whose = "the modular policies" if any(policy in POLICIES for policy, _ in found.rows) else "all policies"
    note = f"{size} points a scene: walks of {whose}, fields of {found.rows[0][1]}."
    note = note if measured else f"Too few points. {note}"
    return Table("correlations", title, header, tuple(lines), note)


def _entry(found: tuple[float, float] | None) -> Entry:
    if found is None:
        return Entry(NO_VALUE)
    r, p = found
    return Entry(f"{r:.2f}") if p < LEVEL else Entry(f"({r:.2f}, p {p:.2f})")
