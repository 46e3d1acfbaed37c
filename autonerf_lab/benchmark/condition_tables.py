"""Tables with one column per condition: other definitions, predicted semantics, noise and sources of poses."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from autonerf_lab.benchmark import paper
from autonerf_lab.benchmark.results_table import ResultsTable, Row
from autonerf_lab.benchmark.table_entries import (
    CORRECTED,
    OURS,
    difference_rows,
    measured,
    ours,
    plain_rows,
    power,
    published_entry,
    score_text,
    strictly_plain,
)
from autonerf_lab.benchmark.text_table import NO_VALUE, Entry, Table
from autonerf_lab.data.pose_sources import POSE_SOURCES
from autonerf_lab.evaluators.metrics import BASELINES, Key, Metric, metrics_of


@dataclass(frozen=True)
class _Condition:
    """Column of a table of conditions."""

    heading: str
    row: Row | None  # None: not measured
    published: dict[Key, float] | None = None  # values of the paper; None: the paper has not measured it


def _conditions(
    found: ResultsTable, name: str, title: str, metrics: Sequence[Metric], columns: Sequence[_Condition], note: str
) -> Table:
    """Return a table with one line per score: the values of each condition, and their differences from the first."""
    first, *others = columns
    metrics, absent = measured(found, metrics)
    compared = [(column.heading, column.row) for column in others if column.row] if first.row else []
    made = [
        (found.difference(row, first.row, metric.key), metric) for metric in metrics for _, row in compared if first.row
    ]
    lines = []
    for metric, differences in zip(metrics, difference_rows(made, len(metrics)), strict=True):
        line = [Entry(metric.full_heading)]
        for column in columns:
            line.append(Entry(NO_VALUE if column.row is None else score_text(found, column.row, metric)))
            if column.published is not None:
                line.append(published_entry(column.published, metric))
        lines.append((*line, *differences))
    shown = next((column.row[0] for column in columns if column.row), OURS)
    header = [shown]
    for column in columns:
        header += [column.heading] if column.published is None else [column.heading, "paper"]
    header += [f"{heading} − {first.heading}" for heading, _ in compared]
    if made:
        note += f" Differences are paired by scene and start; {CORRECTED.format(family='of the table')}."
        note = " ".join(filter(None, (note, power([made]), absent)))
    return Table(name, title, tuple(header), tuple(lines), note)


def baselines(found: ResultsTable) -> Table:
    """Return the scores of the baselines beside those of the field."""
    plain = plain_rows(found)
    row = ours([row for row in plain if any(row in values for values in found.baselines.values())] or plain)
    row = row or found.rows[0]
    columns = {name: found.of_baseline(name) for name in BASELINES if name in found.baselines}
    columns = {"field": found, **columns} if columns else {}
    lines = []
    metrics, absent = measured(found, (*paper.RENDERING, *paper.MAPS, *paper.PLANNING, *paper.POSE, *paper.MESH))
    for metric in metrics:
        scores = [Entry(score_text(table, row, metric)) for table in columns.values()]
        lines.append((Entry(metric.full_heading), *scores, published_entry(paper.BY_POLICY[OURS], metric)))
    names = [f"{name.replace('_', ' ')}: {text}" for name, text in BASELINES.items() if name in columns]
    note = "Not measured in these cells. Add them with --baselines."
    if names:
        note = f"{'; '.join(names)}. {absent}".strip()
    header = (f"{row[0]}, {row[1]}", *(name.replace("_", " ") for name in columns), "paper")
    title = "Other definitions and baselines in the same cells"
    return Table("baselines", title, header, tuple(lines), note)


def semantics(found: ResultsTable) -> Table:
    """Return the scores with true and with predicted classes."""
    plain, other = ours(strictly_plain(found)), ours(found.predicted)
    note = "Not measured: the cells have the semantics of the simulator. Add cells with --semantics predicted."
    if other is not None:
        note = (
            f"Predicted semantics: {other[0]}, {other[1]}. The robot acts on them, too, so its trajectory may differ."
        )
    columns = (
        _Condition("simulator", plain if other else None, paper.BY_POLICY[OURS]),
        _Condition("predicted", other, paper.PREDICTED),
    )
    metrics = (*paper.PREDICTED_METRICS, *metrics_of("segmentation"))
    title = "Semantics of the simulator and predicted semantics"
    return _conditions(found, "semantics", title, metrics, columns, note)


def noise(found: ResultsTable) -> Table:
    """Return the scores without noise and with it, by the source of the poses."""
    noisy = [row for row in found.noisy if row[0] == OURS] or found.noisy
    plain = next((row for row in strictly_plain(found) if row[0] == noisy[0][0]), None) if noisy else None
    by_source = {found.conditions[row].get("poses", "odometry"): row for row in reversed(noisy)}
    columns = [_Condition("without noise", plain, paper.BY_POLICY[OURS])]
    columns += [_Condition(f"{source} poses", by_source[source]) for source in POSE_SOURCES if source in by_source]
    columns = columns if noisy else [*columns, _Condition("with noise", None)]
    columns[-1] = replace(columns[-1], published=paper.NOISE)
    note = "Not measured: the cells are without noise. Add cells with --noise ans --depth-noise redwood."
    if noisy:
        note = "Columns with noise name the pose source. Fields are aligned with the scene before they are scored."
    metrics = (*paper.NOISE_METRICS, *paper.MESH, *metrics_of("trajectory"))
    return _conditions(found, "noise", "Sensor and actuation noise", metrics, columns, note)
