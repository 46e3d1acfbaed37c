"""Tables of the paper for a grid: means with 95 % confidence intervals, beside the values of the paper."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

from autonerf_lab.benchmark import paper
from autonerf_lab.benchmark.condition_tables import baselines, noise, semantics
from autonerf_lab.benchmark.correlations import correlations
from autonerf_lab.benchmark.results_table import ResultsTable, Row
from autonerf_lab.benchmark.table_entries import (
    CORRECTED,
    OURS,
    Family,
    difference_rows,
    measured,
    plain_rows,
    power,
    published_entry,
    score_text,
)
from autonerf_lab.benchmark.text_table import NO_VALUE, Entry, Table
from autonerf_lab.errors import UnknownNameError
from autonerf_lab.evaluators.metrics import Key, Metric

REFERENCES = ("frontier-classic", "frontier", "random")
BOUNDS = "oracle-"  # policies that know the scene: not compared with the others
_IMITATION = "-imitation"  # ends the name of the policy that another one started from
_SCRATCH = "-scratch"  # ends the name of the same policy without imitation


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
        plain = plain_rows(found)
        # An optional task may be that of a few policies: the others have no line.
        scored = [row for row in plain if any(score_text(found, row, m) != NO_VALUE for m in self.metrics)] or plain
        rows = [(row, row[0] if row[1] == plain[0][1] else f"{row[0]}, {row[1]}") for row in scored]
        first = [row for row in scored if row[1] == plain[0][1]]
        published = {row: paper.published_scores(row, plain) for row, _ in rows}
        made = _means(found, self.name, self.title, self.metrics, rows, published, self.hint, first)
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
        scores = found.of_baseline("oracle")
        texts = {metric.heading: score_text(scores, row, metric) for metric in self.metrics}
        return Entry("true geometry (oracle)"), *(Entry(texts.get(title, NO_VALUE)) for title in made.header[1:])

    def _with_differences(self, found: ResultsTable, made: Table, rows: Sequence[Row]) -> Table:
        family = [(found.score_difference(row, a.key, b.key), a) for row in rows for a, b in self.pairs]
        added = difference_rows(family, len(rows))
        lines = [(*line, *differences) for line, differences in zip(made.rows, added, strict=True)]
        header = (*made.header, *(f"{a.label} − {b.label}" for a, b in self.pairs))
        note = f"Differences are those within a cell; d: effect size; {CORRECTED.format(family='of the table')}."
        note = " ".join(filter(None, (made.note, note, power([family]))))
        return replace(made, header=header, rows=tuple(lines), note=note)


def _means(
    found: ResultsTable,
    name: str,
    title: str,
    metrics: Sequence[Metric],
    rows: Sequence[tuple[Row, str]],
    published: Mapping[Row, dict[Key, float]],  # scores of the paper
    hint: str = "",
    compared: Sequence[Row] | None = None,  # rows of which one may be the best; None: all
) -> Table:
    metrics, absent = measured(found, metrics)
    beside = {metric for metric in metrics if any(metric.key in values for values in published.values())}
    header = [""]
    for metric in metrics:
        header += [metric.heading, "paper"] if metric in beside else [metric.heading]
    candidates = [row for row, _ in rows if not row[0].startswith(BOUNDS) and (compared is None or row in compared)]
    best = {metric: found.best(metric, candidates) for metric in metrics}
    lines = []
    for row, text in rows:
        line = [Entry(text)]
        for metric in metrics:
            line.append(Entry(score_text(found, row, metric), bold=best[metric] == row))
            if metric in beside:
                line.append(published_entry(published[row], metric))
        lines.append(tuple(line))
    filled = any(found.runs(row, metric.key) for row, _ in rows for metric in metrics)
    note = absent if filled or absent else f"Not measured in these cells. {hint}".strip()
    return Table(name, title, tuple(header), tuple(lines), note)


def _variants(found: ResultsTable) -> Table:
    plain = plain_rows(found)
    policy = OURS if any(row[0] == OURS for row in plain) else plain[0][0]
    first, *others = [row for row in plain if row[0] == policy]
    rows = [(row, f"{row[1]}, {policy}") for row in (first, *others)]
    corrected = CORRECTED.format(family="of the table")
    title = f"NeRF models on the same trajectories; differences are paired by scene and start, {corrected}"
    metrics = (*paper.RENDERING, *(metric for metric in paper.HEADLINES if metric not in paper.RENDERING))
    if not others:
        return Table("variants", title, ("",), (), "One model only; add others with --models.")
    made = _means(found, "variants", title, metrics, rows, {row: paper.BY_MODEL.get(row[1], {}) for row, _ in rows})
    shown = [metric for metric in metrics if metric.heading in made.header]
    family = [(found.difference(row, first, metric.key), metric) for row in others for metric in shown]
    lines = []
    for row, differences in zip(others, difference_rows(family, len(others)), strict=True):
        # the column "paper" has no values here: the paper has no paired differences
        entries, text = iter(differences), Entry(f"{row[1]} − {first[1]}, {policy}")
        lines.append((text, *(Entry(NO_VALUE) if title == "paper" else next(entries) for title in made.header[1:])))
    return replace(made, rows=(*made.rows, *lines), note=f"{made.note} {power([family])}".strip())


def _differences(found: ResultsTable) -> Table:
    plain = plain_rows(found)
    several = len({model for _, model in plain}) > 1
    rows = [row for row in plain if row[0] != "random" and not row[0].startswith(BOUNDS)]
    trained = [row for row in rows if not row[0].endswith((_IMITATION, _SCRATCH))]
    references = (*REFERENCES, *dict.fromkeys(policy for policy, _ in plain if policy.startswith("e2e-")))
    groups = [
        [
            (row, (reference, row[1]))
            for row in trained
            if row[0] != reference and (reference in REFERENCES or row[0].startswith("modular-"))
        ]
        for reference in references
    ]
    groups.append([(row, (f"{row[0]}{_IMITATION}", row[1])) for row in rows])  # what PPO adds to the demonstrations
    scratch = [(row, (f"{row[0]}{_SCRATCH}", row[1])) for row in trained]  # what imitation adds to PPO
    rivals = [(row, (name, row[1])) for _, row in scratch for name in REFERENCES[:2] if row in found.episodes]
    groups.append(scratch + rivals)
    modular = [row for row in trained if row[0].startswith("modular-")]
    groups.append([(row, other) for row, other in combinations(modular, 2) if row[1] == other[1]])  # rewards
    done: set[tuple[Row, Row]] = set()
    lines: list[tuple[Entry, ...]] = []
    families: list[Family] = []
    for group in groups:
        # Of a difference with both signs, the first one: Holm's correction must count it once.
        pairs = [(row, other) for row, other in group if other in found.episodes and (other, row) not in done]
        done.update(pairs)
        families.append([(found.difference(*pair, metric.key), metric) for pair in pairs for metric in paper.HEADLINES])
        for (row, other), entries in zip(pairs, difference_rows(families[-1], len(pairs)), strict=True):
            lines.append((Entry(f"{row[0]} − {other[0]}" + several * f", {row[1]}"), *entries))
    note = power(families) if lines else "No frontier, random, end-to-end or second modular policy to compare with."
    header = ("", *(metric.heading for metric in paper.HEADLINES))
    family = "from the same policy, from all imitations, of policies from scratch, or among modular policies"
    corrected = CORRECTED.format(family=family)
    title = f"Differences paired by scene and start; d: effect size; {corrected}"
    return Table("differences", title, header, tuple(lines), note)


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
        # success and SPL after fine-tuning in the mesh and in the true scene, without that of the pre-trained policy
        pairs=tuple((paper.FINETUNING[k], paper.FINETUNING[k % 2]) for k in (2, 3, 4, 5)),
    ),
    "baselines": baselines,
    "correlations": correlations,
    "semantics": semantics,
    "noise": noise,
}
