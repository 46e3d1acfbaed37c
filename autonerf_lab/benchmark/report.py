"""Self-contained HTML report of one or several results folders, without scripts and external files."""

import io
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from autonerf_lab import __version__
from autonerf_lab.benchmark.cell import FIGURES
from autonerf_lab.benchmark.export import headline
from autonerf_lab.benchmark.figures import coverage_curves, scores_over_policies
from autonerf_lab.benchmark.paper import PSNR
from autonerf_lab.benchmark.paper_tables import all_tables
from autonerf_lab.benchmark.results import Outcome, Results
from autonerf_lab.benchmark.results_table import load_results_table
from autonerf_lab.data.images import data_url
from autonerf_lab.utils import storage

SHOWN = 3  # number of best and of worst cells


def write_report(folders: Sequence[Results], path: str | Path) -> Path:
    """Write the report.

    Args:
        folders: Results without common cells, shown in the same tables.
        path: Output .html file.

    Returns:
        Path of the report.

    Raises:
        RunFolderError: The folders cannot share one table, see :func:`.load_results_table`.
        DataError: A file is damaged or cannot be written.
    """
    storage.write_bytes(path, render(folders).encode())
    return Path(path)


def render(folders: Sequence[Results]) -> str:
    """Return the report as HTML."""
    import jinja2

    found = load_results_table(*folders)
    ranked = _ranked(found.outcomes)
    best, worst = ranked[:SHOWN], ranked[SHOWN:][-SHOWN:]
    source = (files("autonerf_lab.benchmark") / "report.html.jinja").read_text(encoding="utf-8")
    template = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined).from_string(source)
    grid = folders[0].grid
    facts = {
        "Policies": len({policy for policy, _ in found.rows}),
        "Scenes": len({scene for episodes in found.episodes.values() for scene, _ in episodes}),
        "Starts": grid.starts,
        "Models": ", ".join(dict.fromkeys(model for _, model in found.rows)),
        "Preset": grid.preset,
    }
    return template.render(
        facts=facts,
        headline=headline(found),
        unfinished=[(outcome.cell.name, outcome.status) for outcome in found.unfinished],
        figures=[
            (_png(scores_over_policies(found)), "Scores over policies", "Dots are means over scenes with 95 % "
             "intervals, pale dots are scene means. Grey diamonds are the values of the paper, in other scenes."),
            (_png(coverage_curves(found)), "Coverage over the episode", "Lines are means over scenes, bands range from "
             "the worst to the best scene."),
        ],
        tables=[table.html() for table in all_tables(found)],
        extremes=[("Best", [_shown(o, folders) for o in best]), ("Worst", [_shown(o, folders) for o in worst])],
        version=__version__,
    )  # fmt: skip


def _value(outcome: Outcome) -> float | None:
    return next((row.value for row in outcome.scores if (row.task, row.metric) == PSNR.key), None)


def _ranked(outcomes: Sequence[Outcome]) -> list[Outcome]:
    """Return the outcomes with a PSNR, from best to worst."""
    scored = [(value, outcome) for outcome in outcomes if (value := _value(outcome)) is not None]
    return [outcome for _, outcome in sorted(scored, key=lambda pair: (-pair[0], pair[1].cell.name))]


def _shown(outcome: Outcome, folders: Sequence[Results]) -> dict[str, Any]:
    cell = outcome.cell
    paths = [results.path / "figures" / f"{cell.name}_{kind}.webp" for kind in FIGURES for results in folders]
    value = _value(outcome)
    assert value is not None
    return {
        "name": cell.name.replace("_", ", "),
        "score": f"{PSNR.format(value)} dB",
        "figures": [data_url(path.read_bytes(), "webp") for path in paths if path.exists()],
    }


def _png(figure: Figure) -> str:
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=100)
    return data_url(data.getvalue(), "png")
