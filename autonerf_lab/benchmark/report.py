"""One self-contained HTML page about one or several results folders. No script; nothing is fetched."""

import io
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from autonerf_lab import __version__
from autonerf_lab.benchmark.cell import PICTURES
from autonerf_lab.benchmark.export import headline
from autonerf_lab.benchmark.figures import coverage_curves, scores_over_policies
from autonerf_lab.benchmark.paper import PSNR
from autonerf_lab.benchmark.paper_tables import all_tables, number
from autonerf_lab.benchmark.results import Outcome, Results
from autonerf_lab.benchmark.results_table import collect
from autonerf_lab.data.images import data_url
from autonerf_lab.utils import storage

SHOWN = 3  # cells at either end


def write_report(folders: Sequence[Results], path: str | Path) -> Path:
    """Write the page.

    Args:
        folders: whose rows stand in one table; they share no cell.
        path: of the page.

    Returns:
        The path.

    Raises:
        RunFolderError: two folders hold the same cell.
        DataError: a file is damaged, or cannot be written.
    """
    storage.write_bytes(path, render(folders).encode())
    return Path(path)


def render(folders: Sequence[Results]) -> str:
    """The page as text."""
    import jinja2

    found = collect(*folders)
    ranked = _ranked(found.outcomes)
    best, worst = ranked[:SHOWN], ranked[SHOWN:][-SHOWN:]
    source = (files("autonerf_lab.benchmark") / "report.html.jinja").read_text(encoding="utf-8")
    template = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined).from_string(source)
    grid = folders[0].grid
    facts = {
        "Policies": len({policy for policy, _ in found.rows}),
        "Scenes": len({scene for places in found.places.values() for scene, _ in places}),
        "Starts": grid.starts,
        "Models": ", ".join(dict.fromkeys(model for _, model in found.rows)),
        "Preset": grid.preset,
    }
    return template.render(
        facts=facts,
        headline=headline(found),
        missing=[(outcome.cell.name, outcome.status) for outcome in found.missing],
        figures=[
            (_png(scores_over_policies(found)), "Scores over policies", "A dot is the mean over scenes with its 95 % "
             "interval, the pale dots are scenes. Grey diamonds are the paper's, in other apartments."),
            (_png(coverage_curves(found)), "What the walks saw", "Lines are means over scenes, bands reach from the "
             "worst to the best scene."),
        ],
        tables=[table.html() for table in all_tables(found)],
        extremes=[("Best", [_shown(o, folders) for o in best]), ("Worst", [_shown(o, folders) for o in worst])],
        version=__version__,
    )  # fmt: skip


def _value(outcome: Outcome) -> float | None:
    return next((row.value for row in outcome.scores if (row.task, row.metric) == PSNR.key), None)


def _ranked(outcomes: Sequence[Outcome]) -> list[Outcome]:
    """Those with a PSNR, from the best to the worst."""
    scored = [(value, outcome) for outcome in outcomes if (value := _value(outcome)) is not None]
    return [outcome for _, outcome in sorted(scored, key=lambda pair: (-pair[0], pair[1].cell.name))]


def _shown(outcome: Outcome, folders: Sequence[Results]) -> dict[str, Any]:
    cell = outcome.cell
    places = [results.path / "pictures" / f"{cell.name}_{kind}.webp" for kind in PICTURES for results in folders]
    value = _value(outcome)
    assert value is not None
    return {
        "name": cell.name.replace("_", ", "),
        "score": f"{number(value, PSNR)} dB",
        "pictures": [data_url(place.read_bytes(), "webp") for place in places if place.exists()],
    }


def _png(figure: Figure) -> str:
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=100)
    return data_url(data.getvalue(), "png")
