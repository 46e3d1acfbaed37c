"""The tables of the paper for a grid: means with 95 % intervals, and the paper's figures beside them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from statistics import median

from autonerf_lab.benchmark import paper
from autonerf_lab.benchmark.correlations import correlations
from autonerf_lab.benchmark.paper import Column, Key
from autonerf_lab.benchmark.results_table import Collected, Row
from autonerf_lab.benchmark.statistics import Interval
from autonerf_lab.benchmark.text_table import NO_VALUE, Entry, Table
from autonerf_lab.errors import UnknownNameError

SHOWN_NULLS = 0.05  # a larger share of cells without a value is printed
OURS = "modular-obs"  # whose walks the paper takes for what is not about policies
REFERENCES = ("frontier", "random")


def table(name: str, found: Collected) -> Table:
    """A table by its name.

    Raises:
        UnknownNameError: lists the names.
    """
    if name not in TABLES:
        raise UnknownNameError("table", name, TABLES)
    return TABLES[name](found)


def all_tables(found: Collected) -> list[Table]:
    """Every table of the paper, in its order, and what stands beside them here."""
    return [make(found) for make in TABLES.values()]


@dataclass(frozen=True)
class _Policies:
    """A table with a row a policy (and model, where there are several)."""

    name: str
    title: str
    columns: tuple[Column, ...]
    hint: str = ""

    def __call__(self, found: Collected) -> Table:
        several = len({model for _, model in found.rows}) > 1
        rows = [(row, f"{row[0]}, {row[1]}" if several else row[0]) for row in found.rows]
        return _means(found, self.name, self.title, self.columns, rows, _beside_policy, self.hint)


def _beside_policy(row: Row) -> dict[Key, float]:
    return paper.BY_POLICY.get(row[0], {}) if row[1] == "semantic-nerfacto" else {}


def _means(
    found: Collected,
    name: str,
    title: str,
    columns: Sequence[Column],
    rows: Sequence[tuple[Row, str]],
    beside: Callable[[Row], dict[Key, float]],
    hint: str = "",
) -> Table:
    published = {column for column in columns if any(column.key in beside(row) for row, _ in rows)}
    header = [""]
    for column in columns:
        header += [column.title, "paper"] if column in published else [column.title]
    best = {column: found.best(column, [row for row, _ in rows]) for column in columns}
    lines = []
    for row, text in rows:
        line = [Entry(text)]
        for column in columns:
            line.append(Entry(_text(found, row, column), bold=best[column] == row))
            if column in published:
                value = beside(row).get(column.key)
                line.append(Entry(NO_VALUE if value is None else number(value, column)))
        lines.append(tuple(line))
    measured = any(found.runs(row, column.key) for row, _ in rows for column in columns)
    return Table(name, title, tuple(header), tuple(lines), "" if measured else f"Not measured yet. {hint}".strip())


def number(value: float, column: Column) -> str:
    """A score as its column prints it.

    Example:
        >>> number(0.00765, paper.POSE[2])
        '7.65'
    """
    return f"{value * column.scale:.{column.decimals}f}"


def spread(found: Interval, column: Column) -> str:
    """A mean and its interval as a column prints them; a single scene has none.

    Example:
        >>> spread(Interval(25.5, 0.25, 5), paper.PSNR), spread(Interval(25.5, float("nan"), 1), paper.PSNR)
        ('25.50 ± 0.25', '25.50')
    """
    mean = number(found.mean, column)
    return mean if found.scenes == 1 else f"{mean} ± {number(found.half, column)}"


def _text(found: Collected, row: Row, column: Column) -> str:
    mean = found.interval(row, column.key)
    nulls = found.nulls(row, column.key)
    if mean is None:
        return "null" if nulls else NO_VALUE
    return spread(mean, column) + (f" ({100 * nulls:.0f} % null)" if nulls > SHOWN_NULLS else "")


def _variants(found: Collected) -> Table:
    policies = [policy for policy, _ in found.rows]
    policy = OURS if OURS in policies else policies[0]
    first, *others = (row for row in found.rows if row[0] == policy)
    rows = [(row, f"{row[1]}, {policy}") for row in (first, *others)]
    title = "NeRF variants on the same walks; differences are paired by scene and start, in bold where clear of zero"
    made = _means(found, "variants", title, paper.RENDERING, rows, lambda row: paper.BY_MODEL.get(row[1], {}))
    if not others:
        return made if made.note else made.noted("One model only: add others with --models.")
    lines = []
    for row in others:
        differences = (difference_entry(found.difference(row, first, c.key), c) for c in paper.RENDERING)
        # a column that the paper has beside it is followed by one without a value: the paper has no paired differences
        beside = (Entry(NO_VALUE) if title == "paper" else next(differences) for title in made.header[1:])
        lines.append((Entry(f"{row[1]} − {first[1]}, {policy}"), *beside))
    return replace(made, rows=(*made.rows, *lines))


def _differences(found: Collected) -> Table:
    several = len({model for _, model in found.rows}) > 1
    pairs = [
        (row, (reference, row[1]))
        for reference in (*REFERENCES, *dict.fromkeys(policy for policy, _ in found.rows if policy.startswith("e2e-")))
        for row in found.rows
        if row[0] not in ("random", reference) and (reference in REFERENCES or row[0].startswith("modular-"))
    ]
    pairs = [(row, other) for row, other in pairs if other in found.places]
    lines = [
        difference_line(found, row, other, f"{row[0]} − {other[0]}" + several * f", {row[1]}") for row, other in pairs
    ]
    note = power(found, pairs) if lines else "Nothing to compare with: no frontier, random or end-to-end policy."
    header = ("", *(column.title for column in paper.HEADLINES))
    title = "Paired differences by scene and start; in bold where the interval does not hold zero"
    return Table("differences", title, header, tuple(lines), note)


def power(found: Collected, pairs: Sequence[tuple[Row, Row]]) -> str:
    """What the intervals of some differences could have told: half their width, the median over the pairs.

    Returns:
        A sentence; empty where no pair has two scenes.
    """
    words, scenes = [], 0
    for column in paper.HEADLINES:
        made = [found.difference(row, other, column.key) for row, other in pairs]
        sure = [d for d in made if d is not None and d.scenes > 1]
        if sure:
            scenes = max(scenes, *(d.scenes for d in sure))
            words.append(f"{column.title} {number(median(d.half for d in sure), column)}")
    return f"Smallest difference that {scenes} scenes could tell (median): {', '.join(words)}." if words else ""


def difference_line(found: Collected, row: Row, other: Row, text: str) -> tuple[Entry, ...]:
    """How much more, score by score."""
    made = [found.difference(row, other, column.key) for column in paper.HEADLINES]
    return (Entry(text), *(difference_entry(d, c) for d, c in zip(made, paper.HEADLINES, strict=True)))


def difference_entry(found: Interval | None, column: Column) -> Entry:
    """Bold where the interval does not hold zero."""
    if found is None:
        return Entry(NO_VALUE)
    sign = "+" if found.mean >= 0 else ""
    return Entry(sign + spread(found, column), bold=found.clear)


def _conditions(
    found: Collected,
    name: str,
    title: str,
    columns: Sequence[Column],
    changed: dict[Key, float],
    words: tuple[str, str],
    why: str,
) -> Table:
    """A table with a row a score, and the two conditions beside each other."""
    row = next((row for row in found.rows if row[0] == OURS), found.rows[0])
    lines = []
    for column in columns:
        plain = paper.BY_POLICY[OURS].get(column.key)
        lines.append(
            (
                Entry(f"{column.task.replace('_', ' ')}: {column.title}"),
                Entry(_text(found, row, column)),
                Entry(NO_VALUE if plain is None else number(plain, column)),
                Entry(NO_VALUE),
                Entry(number(changed[column.key], column)),
            )
        )
    header = (row[0], words[0], "paper", words[1], "paper")
    return Table(name, title, header, tuple(lines), why)


def _semantics(found: Collected) -> Table:
    title = "Semantics of the simulator and predicted semantics"
    why = "Predicted semantics: not measured; cells take their classes from the simulator."
    words = ("simulator", "predicted")
    return _conditions(found, "semantics", title, paper.PREDICTED_COLUMNS, paper.PREDICTED, words, why)


def _noise(found: Collected) -> Table:
    why = "With noise: not measured; cells walk without."
    return _conditions(
        found, "noise", "Sensor and actuation noise", paper.NOISE_COLUMNS, paper.NOISE, ("without", "with"), why
    )


TABLES: dict[str, Callable[[Collected], Table]] = {
    "rendering": _Policies("rendering", "Rendering from poses all over the apartment", paper.RENDERING),
    "maps": _Policies("maps", "Maps: free space, obstacles within 5 cm, objects", paper.MAPS),
    "planning": _Policies("planning", "Planning on the maps of the field", paper.PLANNING),
    "pose_refinement": _Policies("pose_refinement", "Pose refinement", paper.POSE),
    "mesh": _Policies("mesh", "The mesh, where the walk saw it", paper.MESH),
    "exploration": _Policies("exploration", "Exploration: areas under the curves of coverage", paper.EXPLORATION),
    "differences": _differences,
    "variants": _variants,
    "navigation": _Policies(
        "navigation",
        "Navigation in the mesh and in the true scene",
        paper.NAVIGATION,
        "--optional navigation asks for it.",
    ),
    "finetuning": _Policies(
        "finetuning",
        "Fine-tuning a PointGoal policy in the mesh",
        paper.FINETUNING,
        "--optional finetuning asks for it.",
    ),
    "correlations": correlations,
    "semantics": _semantics,
    "noise": _noise,
}
