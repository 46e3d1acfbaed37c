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
from autonerf_lab.data.pose_sources import POSE_SOURCES
from autonerf_lab.errors import UnknownNameError
from autonerf_lab.evaluators.metrics import BASELINES, Key, Metric, metrics_of

SIGNIFICANT = 0.05  # p-value
SHOWN_NULLS = 0.05  # a larger share of cells without a value is printed in the table
OURS = "modular-obs"  # policy of the paper in experiments that do not compare policies
_CORRECTED = "bold: p < 5 % after Holm's correction over the differences {family}"
REFERENCES = ("frontier-classic", "frontier", "random")
BOUNDS = "oracle-"  # policies that know the scene: not compared with the others
_IMITATION = "-imitation"  # ends the name of the policy that another one started from


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
    """Table with one row per policy and model, without noise and with true classes.

    Rows of the first model have no name of a model; the best row is one of them. ``pairs`` are scores whose difference
    within a cell is a further column. ``oracle`` adds the scores of the true geometry, an upper bound, if a grid has
    this baseline.
    """

    name: str
    title: str
    metrics: tuple[Metric, ...]
    hint: str = ""
    pairs: tuple[tuple[Metric, Metric], ...] = ()
    oracle: bool = False

    def __call__(self, found: ResultsTable) -> Table:
        plain = _plain_rows(found)
        # An optional task may be that of a few policies: the others have no line.
        scored = [row for row in plain if any(_text(found, row, m) != NO_VALUE for m in self.metrics)] or plain
        rows = [(row, row[0] if row[1] == plain[0][1] else f"{row[0]}, {row[1]}") for row in scored]
        first = [row for row in scored if row[1] == plain[0][1]]
        made = _means(found, self.name, self.title, self.metrics, rows, paper_values, self.hint, first)
        if self.oracle and (line := self._oracle(found, made)):
            made = replace(made, rows=(*made.rows, line))
        if self.pairs and made.filled:
            made = self._with_differences(found, made, [row for row, _ in rows])
        return made

    def _oracle(self, found: ResultsTable, made: Table) -> tuple[Entry, ...]:
        """Return the line of the true geometry; empty if no cell has it."""
        row = next(iter(found.baselines.get("oracle", {})), None)
        if row is None:
            return ()
        measured = found.of_baseline("oracle")
        texts = {metric.heading: _text(measured, row, metric) for metric in self.metrics}
        return Entry("true geometry (oracle)"), *(Entry(texts.get(title, NO_VALUE)) for title in made.header[1:])

    def _with_differences(self, found: ResultsTable, made: Table, rows: Sequence[Row]) -> Table:
        columns = [[found.score_difference(row, a.key, b.key) for row in rows] for a, b in self.pairs]
        lines = [
            (*line, *(difference_entry(column[k], a) for column, (a, _) in zip(columns, self.pairs, strict=True)))
            for k, line in enumerate(made.rows)
        ]
        header = (*made.header, *(f"{a.label} − {b.label}" for a, b in self.pairs))
        note = f"{made.note} Bold differences: the 95 % interval excludes zero.".strip()
        return replace(made, header=header, rows=tuple(lines), note=note)


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
    compared: Sequence[Row] | None = None,  # rows of which one may be the best; None: all
) -> Table:
    absent = {metric: status for metric in metrics if (status := _status_everywhere(found, metric)) is not None}
    metrics = [metric for metric in metrics if metric not in absent]
    published = {metric for metric in metrics if any(metric.key in paper_values(row) for row, _ in rows)}
    header = [""]
    for metric in metrics:
        header += [metric.heading, "paper"] if metric in published else [metric.heading]
    candidates = [row for row, _ in rows if not row[0].startswith(BOUNDS) and (compared is None or row in compared)]
    best = {metric: found.best(metric, candidates) for metric in metrics}
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
    plain = _plain_rows(found)
    policy = OURS if any(row[0] == OURS for row in plain) else plain[0][0]
    first, *others = [row for row in plain if row[0] == policy]
    rows = [(row, f"{row[1]}, {policy}") for row in (first, *others)]
    corrected = _CORRECTED.format(family="of the table")
    title = f"NeRF models on the same trajectories; differences are paired by scene and start, {corrected}"
    metrics = (*paper.RENDERING, *(metric for metric in paper.HEADLINES if metric not in paper.RENDERING))
    if not others:
        return Table("variants", title, ("",), (), "One model only; add others with --models.")
    made = _means(found, "variants", title, metrics, rows, lambda row: paper.BY_MODEL.get(row[1], {}))
    shown = [metric for metric in metrics if metric.heading in made.header]
    pairs = [(row, first, f"{row[1]} − {first[1]}, {policy}") for row in others]
    lines = []
    for text, *differences in _difference_lines(found, pairs, shown):
        # the column "paper" has no values here: the paper has no paired differences
        entries = iter(differences)
        lines.append((text, *(Entry(NO_VALUE) if title == "paper" else next(entries) for title in made.header[1:])))
    return replace(made, rows=(*made.rows, *lines))


def _differences(found: ResultsTable) -> Table:
    plain = _plain_rows(found)
    several = len({model for _, model in plain}) > 1
    rows = [row for row in plain if row[0] != "random" and not row[0].startswith(BOUNDS)]
    trained = [row for row in rows if not row[0].endswith(_IMITATION)]
    references = (*REFERENCES, *dict.fromkeys(policy for policy, _ in plain if policy.startswith("e2e-")))
    families = [
        [
            (row, (reference, row[1]))
            for row in trained
            if row[0] != reference and (reference in REFERENCES or row[0].startswith("modular-"))
        ]
        for reference in references
    ]
    families.append([(row, (f"{row[0]}{_IMITATION}", row[1])) for row in rows])  # what PPO adds to the demonstrations
    done: set[tuple[Row, Row]] = set()
    lines = []
    for family in families:
        # Of a difference with both signs, the first one: Holm's correction must count it once.
        pairs = [(row, other) for row, other in family if other in found.episodes and (other, row) not in done]
        done.update(pairs)
        texts = [(row, other, f"{row[0]} − {other[0]}" + several * f", {row[1]}") for row, other in pairs]
        lines += _difference_lines(found, texts, paper.HEADLINES)
    note = power(found, [*done]) if lines else "No frontier, random or end-to-end policy to compare with."
    header = ("", *(metric.heading for metric in paper.HEADLINES))
    corrected = _CORRECTED.format(family="from the same policy, or from all imitations")
    title = f"Differences paired by scene and start; d: effect size; {corrected}"
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
    pairs = list(pairs)
    made = [(found.difference(row, other, metric.key), metric) for row, other, _ in pairs for metric in metrics]
    entries = _corrected_entries(made)
    size = len(metrics)
    return [(Entry(text), *entries[k * size : (k + 1) * size]) for k, (_, _, text) in enumerate(pairs)]


def _corrected_entries(family: Sequence[tuple[Interval | None, Metric]]) -> list[Entry]:
    """Format differences with effect sizes; bold after Holm's correction over all of them."""
    adjusted = holm([nan if d is None else d.p_value for d, _ in family])
    entries = []
    for (d, metric), p in zip(family, adjusted, strict=True):
        effect = f", d {d.effect_size:.1f}" if d is not None and np.isfinite(d.effect_size) else ""
        entries.append(Entry(difference_entry(d, metric).text + effect, bold=p < SIGNIFICANT))
    return entries


def difference_entry(found: Interval | None, metric: Metric) -> Entry:
    """Format a difference; bold if its interval excludes zero."""
    if found is None:
        return Entry(NO_VALUE)
    sign = "+" if found.mean >= 0 else ""
    return Entry(sign + spread(found, metric), bold=found.excludes_zero)


def _plain_rows(found: ResultsTable) -> list[Row]:
    """Return the rows without noise and with true classes; all rows if there are none."""
    return _strictly_plain(found) or found.rows


def _strictly_plain(found: ResultsTable) -> list[Row]:
    changed = {*found.noisy, *found.predicted}
    return [row for row in found.rows if row not in changed]


def _ours(rows: Sequence[Row]) -> Row | None:
    """Return the row of the policy ``OURS``, or else the first one."""
    return next((row for row in rows if row[0] == OURS), next(iter(rows), None))


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
    metrics = [metric for metric in metrics if _status_everywhere(found, metric) is None]
    compared = [(column.heading, column.row) for column in others if column.row] if first.row else []
    made = [
        (found.difference(row, first.row, metric.key), metric) for metric in metrics for _, row in compared if first.row
    ]
    differences = iter(_corrected_entries(made))
    lines = []
    for metric in metrics:
        line = [Entry(metric.full_heading)]
        for column in columns:
            line.append(Entry(NO_VALUE if column.row is None else _text(found, column.row, metric)))
            if column.published is not None:
                value = column.published.get(metric.key)
                line.append(Entry(NO_VALUE if value is None else metric.format(value)))
        lines.append((*line, *(next(differences) for _ in compared)))
    shown = next((column.row[0] for column in columns if column.row), OURS)
    header = [shown]
    for column in columns:
        header += [column.heading] if column.published is None else [column.heading, "paper"]
    header += [f"{heading} − {first.heading}" for heading, _ in compared]
    if made:
        note += f" Differences are paired by scene and start; {_CORRECTED.format(family='of the table')}."
    return Table(name, title, tuple(header), tuple(lines), note)


def _baselines(found: ResultsTable) -> Table:
    plain = _plain_rows(found)
    row = _ours([row for row in plain if any(row in values for values in found.baselines.values())] or plain)
    row = row or found.rows[0]
    columns = {name: found.of_baseline(name) for name in BASELINES if name in found.baselines}
    columns = {"field": found, **columns} if columns else {}
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
    plain, other = _ours(_strictly_plain(found)), _ours(found.predicted)
    note = "Predicted semantics: not measured; cells use the semantics of the simulator."
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


def _noise(found: ResultsTable) -> Table:
    noisy = [row for row in found.noisy if row[0] == OURS] or found.noisy
    plain = next((row for row in _strictly_plain(found) if row[0] == noisy[0][0]), None) if noisy else None
    by_source = {found.conditions[row].get("poses", "odometry"): row for row in reversed(noisy)}
    columns = [_Condition("without noise", plain, paper.BY_POLICY[OURS])]
    columns += [_Condition(f"{source} poses", by_source[source]) for source in POSE_SOURCES if source in by_source]
    columns = columns if noisy else [*columns, _Condition("with noise", None)]
    columns[-1] = replace(columns[-1], published=paper.NOISE)
    note = "With noise: not measured; cells run without noise."
    if noisy:
        note = "Columns with noise name the pose source. Fields are aligned with the scene before they are scored."
    metrics = (*paper.NOISE_METRICS, *paper.MESH, *metrics_of("trajectory"))
    return _conditions(found, "noise", "Sensor and actuation noise", metrics, columns, note)


TABLES: dict[str, Callable[[ResultsTable], Table]] = {
    "rendering": _Policies("rendering", "Rendering from test poses in the whole apartment", paper.RENDERING),
    "maps": _Policies("maps", "Maps: free space, obstacles, object classes", paper.MAPS, oracle=True),
    "planning": _Policies("planning", "Planning on the maps of the field", paper.PLANNING, oracle=True),
    "pose_refinement": _Policies("pose_refinement", "Pose refinement", paper.POSE, oracle=True),
    "mesh": _Policies("mesh", "Mesh, compared with the whole scene and with its seen parts", paper.MESH, oracle=True),
    "exploration": _Policies("exploration", "Exploration: mean coverage over the steps", paper.EXPLORATION),
    "differences": _differences,
    "variants": _variants,
    "navigation": _Policies(
        "navigation",
        "Navigation in the mesh and in the true scene",
        paper.NAVIGATION,
        "Add it with --optional navigation.",
        pairs=((paper.NAVIGATION[0], paper.NAVIGATION[2]), (paper.NAVIGATION[1], paper.NAVIGATION[3])),
    ),
    "finetuning": _Policies(
        "finetuning",
        "Fine-tuning a PointGoal policy in the mesh",
        paper.FINETUNING,
        "Add it with --optional finetuning.",
        pairs=tuple((paper.FINETUNING[1], paper.FINETUNING[k]) for k in (0, 2)),
    ),
    "baselines": _baselines,
    "correlations": correlations,
    "semantics": _semantics,
    "noise": _noise,
}
