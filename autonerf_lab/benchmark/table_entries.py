"""Entries of the paper's tables: means, paired differences after Holm's correction, and their statistical power."""

from collections.abc import Iterable, Mapping, Sequence
from math import nan
from statistics import median

import numpy as np

from autonerf_lab.benchmark.paper import HEADLINES
from autonerf_lab.benchmark.results_table import ResultsTable, Row
from autonerf_lab.benchmark.statistics import POWER, Interval, holm
from autonerf_lab.benchmark.text_table import NO_VALUE, Entry
from autonerf_lab.evaluators.metrics import Key, Metric

SIGNIFICANT = 0.05  # p-value
SHOWN_NULLS = 0.05  # a larger share of cells without a value is printed in the table
OURS = "modular-obs"  # policy of the paper in experiments that do not compare policies
CORRECTED = "bold: p < 5 % after Holm's correction over the differences {family}"
Family = Sequence[tuple[Interval | None, Metric]]  # differences that Holm's correction takes together


def plain_rows(found: ResultsTable) -> list[Row]:
    """Return the rows without noise and with true classes; all rows if there are none."""
    return strictly_plain(found) or found.rows


def strictly_plain(found: ResultsTable) -> list[Row]:
    """Return the rows without noise and with true classes."""
    changed = {*found.noisy, *found.predicted}
    return [row for row in found.rows if row not in changed]


def ours(rows: Sequence[Row]) -> Row | None:
    """Return the row of the policy :data:`OURS`, or else the first one."""
    return next((row for row in rows if row[0] == OURS), next(iter(rows), None))


def measured(found: ResultsTable, metrics: Sequence[Metric]) -> tuple[list[Metric], str]:
    """Return the metrics that are not null in all cells that have them, and a sentence that names the others."""
    absent = {metric: status for metric in metrics if (status := _status_everywhere(found, metric)) is not None}
    notes = [f"{metric.label} is left out: no cell has a value ({status})." for metric, status in absent.items()]
    return [metric for metric in metrics if metric not in absent], " ".join(notes)


def _status_everywhere(found: ResultsTable, metric: Metric) -> str | None:
    """Return the first status of a score that is null in all cells that have it; None for any other score."""
    rows = [row for o in found.outcomes for row in o.scores if (row.task, row.metric) == metric.key]
    return rows[0].status if rows and all(row.value is None for row in rows) else None


def spread(found: Interval, metric: Metric) -> str:
    """Format a mean and its confidence interval; a single scene has no interval.

    Example:
        >>> from autonerf_lab.benchmark.paper import PSNR
        >>> spread(Interval(25.5, 0.25, 5), PSNR), spread(Interval(25.5, float("nan"), 1), PSNR)
        ('25.50 ± 0.25', '25.50')
    """
    mean = metric.format(found.mean)
    return mean if found.scenes == 1 else f"{mean} ± {metric.format(found.half_width)}"


def score_text(found: ResultsTable, row: Row, metric: Metric) -> str:
    """Format the mean of a score, with the share of cells without a value if that is large."""
    mean = found.interval(row, metric.key)
    nulls = found.null_share(row, metric.key)
    if mean is None:
        return "null" if nulls else NO_VALUE
    return spread(mean, metric) + (f" ({100 * nulls:.0f} % null)" if nulls > SHOWN_NULLS else "")


def difference_entry(found: Interval | None, metric: Metric) -> Entry:
    """Format a difference; bold if its interval excludes zero."""
    if found is None:
        return Entry(NO_VALUE)
    sign = "+" if found.mean >= 0 else ""
    return Entry(sign + spread(found, metric), bold=found.excludes_zero)


def difference_rows(family: Family, count: int) -> list[tuple[Entry, ...]]:
    """Format differences with effect sizes, in equal rows; bold after Holm's correction over all of them."""
    adjusted = holm([nan if d is None else d.p_value for d, _ in family])
    entries = []
    for (d, metric), p in zip(family, adjusted, strict=True):
        effect = f", d {d.effect_size:.1f}" if d is not None and np.isfinite(d.effect_size) else ""
        entries.append(Entry(difference_entry(d, metric).text + effect, bold=p < SIGNIFICANT))
    size = len(entries) // count if count else 0
    return [tuple(entries[k * size : (k + 1) * size]) for k in range(count)]


def published_entry(values: Mapping[Key, float], metric: Metric) -> Entry:
    """Format the value of the paper for a metric, if it has one."""
    value = values.get(metric.key)
    return Entry(NO_VALUE if value is None else metric.format(value))


def power(families: Iterable[Family]) -> str:
    """Describe the statistical power: the difference that a test finds with a probability of 80 %, median by metric.

    Args:
        families: differences that Holm's correction takes together. Of those that have main metrics, only these count.

    Returns:
        A sentence; empty if no difference has two scenes.
    """
    plain: dict[Metric, list[float]] = {}
    corrected: dict[Metric, list[float]] = {}
    scenes = 0
    for family in families:
        sure = [(d, metric) for d, metric in family if d is not None and np.isfinite(d.p_value)]
        for d, metric in [(d, metric) for d, metric in sure if metric in HEADLINES] or sure:
            scenes = max(scenes, d.scenes)
            plain.setdefault(metric, []).append(d.detectable())
            corrected.setdefault(metric, []).append(d.detectable(comparisons=len(sure)))
    if not plain:
        return ""
    parts = [
        f"{metric.heading} {metric.format(median(values))} ({metric.format(median(corrected[metric]))})"
        for metric, values in plain.items()
    ]
    return (
        f"Smallest difference that {scenes} scenes show with a probability of {100 * POWER:.0f} % (median, in brackets "
        f"after correction for the number of differences): {', '.join(parts)}."
    )
