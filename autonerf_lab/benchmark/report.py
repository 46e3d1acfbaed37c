"""Report of one or several results folders: a folder of static pages that needs no server and no other file."""

import io
import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from autonerf_lab.benchmark.card import card
from autonerf_lab.benchmark.cell import FIGURES
from autonerf_lab.benchmark.export import export_results, headline, left_out
from autonerf_lab.benchmark.figures import cell_curves, coverage_curves, scores_over_policies
from autonerf_lab.benchmark.leaderboard import leaderboard, title
from autonerf_lab.benchmark.paper import HEADLINES, PSNR
from autonerf_lab.benchmark.paper_tables import all_tables
from autonerf_lab.benchmark.results import Outcome, Results
from autonerf_lab.benchmark.results_table import ResultsTable, load_results_table
from autonerf_lab.benchmark.text_table import NO_VALUE, Entry, Table
from autonerf_lab.data.images import data_url
from autonerf_lab.errors import DataError, RunFolderError
from autonerf_lab.evaluators import Scores
from autonerf_lab.evaluators.tasks import metric_of
from autonerf_lab.types import Score
from autonerf_lab.utils import storage
from autonerf_lab.version import __version__

SHOWN = 3  # number of best and of worst cells
_CAPTIONS = {
    "trajectory": "Trajectory in top view",
    "rendering": "True and rendered views",
    "maps": "True and predicted maps",
    "paths": "Planned paths",
    "drift": "Errors of the poses over the steps",
}


def write_report(folders: Sequence[Results], out: str | Path) -> Path:
    """Write the report.

    Args:
        folders: Results without common cells, shown in the same tables.
        out: Output folder: ``index.html`` (leaderboard, tables, figures), ``cells/`` (a page per cell), ``cards/`` (a
            card per policy and model), and the files of :func:`.export_results`.

    Returns:
        Path of ``index.html``.

    Raises:
        RunFolderError: The folders cannot share one table, see :func:`.load_results_table`.
        DataError: A file is damaged or cannot be written.
    """
    out, found = Path(out), load_results_table(*folders)
    for outcome in found.outcomes:
        storage.write_bytes(out / _page(outcome), _cell(outcome, folders).encode())
    for row in found.rows:
        storage.write_bytes(out / _card(title("", row)), card(found, row, folders).encode())
    export_results(found, out)
    storage.write_bytes(out / "index.html", _index(found, folders).encode())
    return out / "index.html"


def _index(found: ResultsTable, folders: Sequence[Results]) -> str:
    """Return the first page as HTML."""
    ranked = _ranked(found.outcomes)
    tables = all_tables(found)
    best, worst = ranked[:SHOWN], ranked[SHOWN:][-SHOWN:]
    grid = folders[0].grid
    facts = {
        "Policies": len({policy for policy, _ in found.rows}),
        "Scenes": len({scene for episodes in found.episodes.values() for scene, _ in episodes}),
        "Starts": grid.starts,
        "Models": ", ".join(dict.fromkeys(model for _, model in found.rows)),
        "Preset": grid.preset,
    }
    return _template("report.html.jinja").render(
        facts=facts,
        headline=headline(found),
        unfinished=[(outcome.cell.name, outcome.status) for outcome in found.unfinished],
        figures=[
            (_png(scores_over_policies(found)), "Scores over policies", "Dots are means over scenes with 95 % "
             "intervals, pale dots are scene means. Grey diamonds are the values of the paper, in other scenes."),
            (_png(coverage_curves(found)), "Coverage over the episode", "Lines are means over scenes, bands range from "
             "the worst to the best scene."),
        ],
        leaderboard=_leaderboard(found),
        cards=[(name, _card(name)) for name in (title("", row) for row in found.rows)],
        tables=[table.html() for table in tables if table.filled],
        left_out=left_out(tables),
        extremes=[("Best", [_shown(o, folders) for o in best]), ("Worst", [_shown(o, folders) for o in worst])],
        cells=_cells(found.outcomes),
        version=__version__,
    )  # fmt: skip


def _leaderboard(found: ResultsTable) -> str:
    try:
        return leaderboard({"": found}).html()
    except RunFolderError as error:  # an unfinished grid
        return f"<p>{error}</p>"


def _cell(outcome: Outcome, folders: Sequence[Results]) -> str:
    """Return the page of a cell as HTML."""
    cell = outcome.cell
    facts = {"Status": outcome.status, "Policy": cell.policy, "Scene": cell.scene, "Start": cell.start,
             "Model": cell.variant, "Preset": cell.preset, "Seconds": f"{outcome.seconds:.0f}"}  # fmt: skip
    figures = [(_CAPTIONS[kind], data_url(path.read_bytes(), "webp")) for kind, path in _pictures(outcome, folders)]
    if outcome.curves:
        figures.append(("Coverage over the episode", _png(cell_curves(outcome.curves))))
    rows = tuple(tuple(map(Entry, _score(row))) for row in outcome.scores)
    scores = Table("all-scores", "All scores", ("", "Score", "Paper, best", "Samples"), rows)
    tables = [scores, *_details(outcome)]
    return _template("cell.html.jinja").render(
        name=cell.name, facts=facts, figures=figures, tables=[table.html() for table in tables], version=__version__
    )


def _details(outcome: Outcome) -> list[Table]:
    """Return a table for each task that counts the outcomes of its episodes, or has other details."""
    scores = Scores(outcome.scores)
    scores.details.update(outcome.details)
    try:
        found = scores.details_tables()
    except DataError as error:
        raise DataError(f"{outcome.cell.name}: {error}; remove the file of this cell to run it again") from error
    return [
        Table(f"details-{task}", f"Details of {task}", header, tuple(tuple(map(Entry, row)) for row in rows))
        for task, (header, *rows) in found.items()
    ]


def _score(row: Score) -> tuple[str, str, str, str]:
    metric = metric_of(row)
    value = row.status if row.value is None else metric.format(row.value)
    paper = metric.format(metric.paper[0]) if metric.paper else NO_VALUE
    return metric.full_heading, value, paper, str(row.n)


def _cells(outcomes: Sequence[Outcome]) -> str:
    """Return the table of all cells as HTML, with links to their pages."""
    rows = []
    for outcome in outcomes:
        values = {(row.task, row.metric): row.value for row in outcome.scores}
        shown = [values.get(metric.key) for metric in HEADLINES]
        texts = [NO_VALUE if v is None else m.format(v) for v, m in zip(shown, HEADLINES, strict=True)]
        rows.append((Entry(outcome.cell.name, link=_page(outcome)), *map(Entry, texts)))
    header = ("", *(metric.heading for metric in HEADLINES))
    return Table("all-cells", "", header, tuple(rows)).html()


def _page(outcome: Outcome) -> str:
    return f"cells/{outcome.cell.name}.html"


def _card(name: str) -> str:
    return "cards/" + re.sub(r"[^\w.+-]+", "-", name) + ".md"


@cache
def _template(name: str) -> Any:
    import jinja2

    loader = jinja2.FileSystemLoader(Path(__file__).parent, encoding="utf-8")
    return jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, loader=loader).get_template(name)


def _value(outcome: Outcome) -> float | None:
    return next((row.value for row in outcome.scores if (row.task, row.metric) == PSNR.key), None)


def _ranked(outcomes: Sequence[Outcome]) -> list[Outcome]:
    """Return the outcomes with a PSNR, from best to worst."""
    scored = [(value, outcome) for outcome in outcomes if (value := _value(outcome)) is not None]
    return [outcome for _, outcome in sorted(scored, key=lambda pair: (-pair[0], pair[1].cell.name))]


def _pictures(outcome: Outcome, folders: Sequence[Results]) -> list[tuple[str, Path]]:
    """Return the saved pictures of a cell with their kinds."""
    paths = [(k, r.path / "figures" / f"{outcome.cell.name}_{k}.webp") for k in FIGURES for r in folders]
    return [(kind, path) for kind, path in paths if path.exists()]


def _shown(outcome: Outcome, folders: Sequence[Results]) -> dict[str, Any]:
    value = _value(outcome)
    assert value is not None
    return {
        "name": outcome.cell.name.replace("_", ", "),
        "link": _page(outcome),
        "score": f"{PSNR.format(value)} dB",
        "figures": [data_url(path.read_bytes(), "webp") for _, path in _pictures(outcome, folders)],
    }


def _png(figure: Figure) -> str:
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=100)
    return data_url(data.getvalue(), "png")
