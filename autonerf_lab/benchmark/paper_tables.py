"""Tables of the paper for a grid: means with 95 % confidence intervals, beside the values of the paper."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from math import nan
from statistics import median

import numpy as np

from autonerf_lab.benchmark import paper
from autonerf_lab.benchmark.correlations import correlations
from autonerf_lab.benchmark.results_table import ResultsTable, Row
from autonerf_lab.benchmark.statistics import Interval, holm
from autonerf_lab.benchmark.text_table import NO_VALUE, Entry, Table
from autonerf_lab.errors import UnknownNameError
from autonerf_lab.evaluators.metrics import BASELINES, Key, Metric, metrics_of

SIGNIFICANT = 0.05  # p-value
SHOWN_NULLS = 0.05  # a larger share of cells without a value is printed in the table
OURS = "modular-obs"  # policy of the paper in experiments that do not compare policies
_CORRECTED = "bold: p < 5 % after Holm's correction over the differences of the table"
REFERENCES = ("frontier-classic", "frontier", "random")
_BOUNDS = "oracle-"  # policies that know the scene: not compared with the others


def table(name: str, found: ResultsTable) -> Table:
    """Return a table by its name.

    Raises:
        UnknownNameError: lists the valid names.
    """
    if name not in TABLES:
        raise UnknownNameError("table", name, TABLES)
    return TABLES[name](found)


def all_tables(found: ResultsTable) -> list[Table]:
    """Return all tables, in the order of the paper."""
    return [make(found) for make in TABLES.values()]


@dataclass(frozen=True)
class _Policies:
    """Table with one row per policy (and model, if there are several)."""

    name: str
    title: str
    metrics: tuple[Metric, ...]
    hint: str = ""

    def __call__(self, found: ResultsTable) -> Table:
        several = len({model for _, model in found.rows}) > 1
        rows = [(row, f"{row[0]}, {row[1]}" if several else row[0]) for row in found.rows]
        return _means(found, self.name, self.title, self.metrics, rows, paper_values, self.hint)


def paper_values(row: Row) -> dict[Key, float]:
    """Return the scores of the paper for a row: those of its Semantic Nerfacto without noise."""
    return paper.BY_POLICY.get(row[0], {}) if row[1] == "semantic-nerfacto" else {}


def _means(
    found: ResultsTable,
    name: str,
    title: str,
    metrics: Sequence[Metric],
    rows: Sequence[tuple[Row, str]],
    paper_values: Callable[[Row], dict[Key, float]],
    hint: str = "",
) -> Table:
    absent = {metric: status for metric in metrics if (status := _status_everywhere(found, metric)) is not None}
    metrics = [metric for metric in metrics if metric not in absent]
    published = {metric for metric in metrics if any(metric.key in paper_values(row) for row, _ in rows)}
    header = [""]
    for metric in metrics:
        header += [metric.heading, "paper"] if metric in published else [metric.heading]
    compared = [row for row, _ in rows if not row[0].startswith(_BOUNDS)]
    best = {metric: found.best(metric, compared) for metric in metrics}
    lines = []
    for row, text in rows:
        line = [Entry(text)]
        for metric in metrics:
            line.append(Entry(_text(found, row, metric), bold=best[metric] == row))
            if metric in published:
                value = paper_values(row).get(metric.key)
                line.append(Entry(NO_VALUE if value is None else metric.format(value)))
        lines.append(tuple(line))
    measured = any(found.runs(row, metric.key) for row, _ in rows for metric in metrics)
    notes = [f"{metric.label} is left out: no cell has a value ({status})." for metric, status in absent.items()]
    note = " ".join(notes) if measured or notes else f"Not measured yet. {hint}".strip()
    return Table(name, title, tuple(header), tuple(lines), note)


def _status_everywhere(found: ResultsTable, metric: Metric) -> str | None:
    """Return the first status of a score that is null in all cells that have it; None for any other score."""
    rows = [row for o in found.outcomes for row in o.scores if (row.task, row.metric) == metric.key]
    return rows[0].status if rows and all(row.value is None for row in rows) else None


def spread(found: Interval, metric: Metric) -> str:
    """Format a mean and its confidence interval; a single scene has no interval.

    Example:
        >>> spread(Interval(25.5, 0.25, 5), paper.PSNR), spread(Interval(25.5, float("nan"), 1), paper.PSNR)
        ('25.50 ± 0.25', '25.50')
    """
    mean = metric.format(found.mean)
    return mean if found.scenes == 1 else f"{mean} ± {metric.format(found.half_width)}"


def _text(found: ResultsTable, row: Row, metric: Metric) -> str:
    mean = found.interval(row, metric.key)
    nulls = found.null_share(row, metric.key)
    if mean is None:
        return "null" if nulls else NO_VALUE
    return spread(mean, metric) + (f" ({100 * nulls:.0f} % null)" if nulls > SHOWN_NULLS else "")


def _variants(found: ResultsTable) -> Table:
    policies = [policy for policy, _ in found.rows]
    policy = OURS if OURS in policies else policies[0]
    same = [row for row in found.rows if row[0] == policy]
    first, *others = [row for row in same if row not in found.noisy] or same[:1]
    rows = [(row, f"{row[1]}, {policy}") for row in (first, *others)]
    title = f"NeRF models on the same trajectories; differences are paired by scene and start, {_CORRECTED}"
    made = _means(found, "variants", title, paper.RENDERING, rows, lambda row: paper.BY_MODEL.get(row[1], {}))
    if not others:
        return made if made.note else replace(made, note="One model only; add others with --models.")
    shown = [metric for metric in paper.RENDERING if metric.heading in made.header]
    pairs = [(row, first, f"{row[1]} − {first[1]}, {policy}") for row in others]
    lines = []
    for text, *differences in _difference_lines(found, pairs, shown):
        # the column "paper" has no values here: the paper has no paired differences
        entries = iter(differences)
        lines.append((text, *(Entry(NO_VALUE) if title == "paper" else next(entries) for title in made.header[1:])))
    return replace(made, rows=(*made.rows, *lines))


def _differences(found: ResultsTable) -> Table:
    several = len({model for _, model in found.rows}) > 1
    rows = [row for row in found.rows if row[0] != "random" and not row[0].startswith(_BOUNDS)]
    pairs = [
        (row, (reference, row[1]))
        for reference in (*REFERENCES, *dict.fromkeys(policy for policy, _ in found.rows if policy.startswith("e2e-")))
        for row in rows
        if row[0] != reference and (reference in REFERENCES or row[0].startswith("modular-"))
    ]
    pairs += [(row, (f"{row[0]}-imitation", row[1])) for row in rows]  # what PPO adds to the demonstrations
    # Of a difference with both signs, the first one: Holm's correction must count it once.
    pairs = [
        (row, other)
        for k, (row, other) in enumerate(pairs)
        if other in found.episodes and (other, row) not in pairs[:k]
    ]
    texts = [(row, other, f"{row[0]} − {other[0]}" + several * f", {row[1]}") for row, other in pairs]
    lines = _difference_lines(found, texts, paper.HEADLINES)
    note = power(found, pairs) if lines else "No frontier, random or end-to-end policy to compare with."
    header = ("", *(metric.heading for metric in paper.HEADLINES))
    title = f"Differences paired by scene and start; d: effect size; {_CORRECTED}"
    return Table("differences", title, header, tuple(lines), note)


def power(found: ResultsTable, pairs: Sequence[tuple[Row, Row]]) -> str:
    """Describe the statistical power: the difference that a test finds with a probability of 80 %, median by metric.

    Args:
        found: results of a grid.
        pairs: rows whose differences are taken.

    Returns:
        A sentence; empty if no pair has two scenes.
    """
    parts, scenes = [], 0
    for metric in paper.HEADLINES:
        made = [found.difference(row, other, metric.key) for row, other in pairs]
        sure = [d for d in made if d is not None and d.scenes > 1]
        if sure:
            scenes = max(scenes, *(d.scenes for d in sure))
            parts.append(f"{metric.heading} {metric.format(median(d.detectable for d in sure))}")
    what = f"Smallest difference that {scenes} scenes show with a probability of 80 % (median, without correction)"
    return f"{what}: {', '.join(parts)}." if parts else ""


def _difference_lines(
    found: ResultsTable, pairs: Iterable[tuple[Row, Row, str]], metrics: Sequence[Metric]
) -> list[tuple[Entry, ...]]:
    """Return one line per pair, first minus second row, with effect sizes; all differences are one family for Holm."""
    made = [(text, [found.difference(row, other, metric.key) for metric in metrics]) for row, other, text in pairs]
    adjusted = iter(holm([nan if d is None else d.p_value for _, line in made for d in line]))
    lines = []
    for text, line in made:
        entries = [Entry(text)]
        for d, metric, p in zip(line, metrics, adjusted, strict=False):
            effect = f", d {d.effect_size:.1f}" if d is not None and np.isfinite(d.effect_size) else ""
            entries.append(Entry(difference_entry(d, metric).text + effect, bold=p < SIGNIFICANT))
        lines.append(tuple(entries))
    return lines


def difference_entry(found: Interval | None, metric: Metric) -> Entry:
    """Format a difference; bold if its interval excludes zero."""
    if found is None:
        return Entry(NO_VALUE)
    sign = "+" if found.mean >= 0 else ""
    return Entry(sign + spread(found, metric), bold=found.excludes_zero)


def _plain_rows(found: ResultsTable) -> list[Row]:
    """Return the rows without noise and with true classes."""
    return [row for row in found.rows if row not in found.noisy | found.predicted]


def _ours(rows: Sequence[Row]) -> Row | None:
    """Return the row of the policy ``OURS``, or else the first one."""
    return next((row for row in rows if row[0] == OURS), next(iter(rows), None))


def _conditions(
    found: ResultsTable,
    name: str,
    title: str,
    metrics: Sequence[Metric],
    changed: dict[Key, float],
    conditions: tuple[str, str],
    note: str,
    other: Row | None = None,
) -> Table:
    """Return a table with one row per metric, and two conditions side by side; ``other``: row of the second."""
    plain_rows = _plain_rows(found)
    row = _ours(plain_rows)
    lines = []
    for metric in metrics:
        plain = paper.BY_POLICY[OURS].get(metric.key)
        lines.append(
            (
                Entry(metric.full_heading),
                Entry(NO_VALUE if row is None else _text(found, row, metric)),
                Entry(NO_VALUE if plain is None else metric.format(plain)),
                Entry(NO_VALUE if other is None else _text(found, other, metric)),
                Entry(metric.format(changed[metric.key]) if metric.key in changed else NO_VALUE),
            )
        )
    shown = row or other
    header = (shown[0] if shown else OURS, conditions[0], "paper", conditions[1], "paper")
    return Table(name, title, header, tuple(lines), note)


def _baselines(found: ResultsTable) -> Table:
    plain = _plain_rows(found)
    row = _ours([row for row in plain if any(row in values for values in found.baselines.values())] or plain)
    row = row or found.rows[0]
    columns = {"field": found} | {name: found.of_baseline(name) for name in BASELINES if name in found.baselines}
    lines = []
    for metric in (*paper.RENDERING, *paper.MAPS, *paper.PLANNING, *paper.POSE, *paper.MESH):
        if _status_everywhere(found, metric) is not None:  # LPIPS without its weights
            continue
        published = paper.BY_POLICY[OURS].get(metric.key)
        texts = [_text(table, row, metric) for table in columns.values()]
        texts.append(NO_VALUE if published is None else metric.format(published))
        lines.append((Entry(metric.full_heading), *map(Entry, texts)))
    names = [f"{name.replace('_', ' ')}: {text}" for name, text in BASELINES.items() if name in columns]
    note = "; ".join(names) or "Baselines: not measured yet; add them with --baselines"
    header = (f"{row[0]}, {row[1]}", *(name.replace("_", " ") for name in columns), "paper")
    return Table("baselines", "Other definitions and baselines in the same cells", header, tuple(lines), f"{note}.")


def _semantics(found: ResultsTable) -> Table:
    title = "Semantics of the simulator and predicted semantics"
    other = _ours([row for row in found.rows if row in found.predicted])
    note = "Predicted semantics: not measured; cells use the semantics of the simulator."
    note = note if other is None else f"Predicted semantics: {other[0]}, {other[1]}."
    conditions = ("simulator", "predicted")
    return _conditions(found, "semantics", title, paper.PREDICTED_METRICS, paper.PREDICTED, conditions, note, other)


def _noise(found: ResultsTable) -> Table:
    noisy = [row for row in found.rows if row in found.noisy]
    noisy = [row for row in noisy if row[0] == OURS] or noisy
    note = "With noise: not measured; cells run without noise."
    other = next((row for source in ("refined", "estimated", "") for row in noisy if row[1].endswith(source)), None)
    metrics = paper.NOISE_METRICS
    if other is not None:
        note = f"With noise: {other[0]}, {other[1]}. Fields are aligned with the scene before they are scored."
        metrics = (*metrics, *metrics_of("trajectory"))
    conditions = ("without", "with")
    return _conditions(found, "noise", "Sensor and actuation noise", metrics, paper.NOISE, conditions, note, other)


TABLES: dict[str, Callable[[ResultsTable], Table]] = {
    "rendering": _Policies("rendering", "Rendering from test poses in the whole apartment", paper.RENDERING),
    "maps": _Policies("maps", "Maps: free space, obstacles, object classes", paper.MAPS),
    "planning": _Policies("planning", "Planning on the maps of the field", paper.PLANNING),
    "pose_refinement": _Policies("pose_refinement", "Pose refinement", paper.POSE),
    "mesh": _Policies("mesh", "Mesh, compared with the whole scene and with its seen parts", paper.MESH),
    "exploration": _Policies("exploration", "Exploration: mean coverage over the steps", paper.EXPLORATION),
    "differences": _differences,
    "variants": _variants,
    "navigation": _Policies(
        "navigation",
        "Navigation in the mesh and in the true scene",
        paper.NAVIGATION,
        "Add it with --optional navigation.",
    ),
    "finetuning": _Policies(
        "finetuning",
        "Fine-tuning a PointGoal policy in the mesh",
        paper.FINETUNING,
        "Add it with --optional finetuning.",
    ),
    "baselines": _baselines,
    "correlations": correlations,
    "semantics": _semantics,
    "noise": _noise,
}
