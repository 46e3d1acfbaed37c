"""Report of a run: one self-contained HTML page, made from the files of the run folder.

Images are embedded. The page has no script and loads nothing; all text is escaped by the template engine.
"""

import io
import platform
from dataclasses import asdict, dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

from PIL import Image

from autonerf_lab.data.images import data_url
from autonerf_lab.errors import DataError
from autonerf_lab.evaluators.metrics import BASELINES, METRICS, Metric
from autonerf_lab.evaluators.scores import Scores
from autonerf_lab.evaluators.tasks import TASKS, available, metric_of
from autonerf_lab.pipeline.context import SCAN_SUFFIXES
from autonerf_lab.pipeline.gallery import StoredFigure, read_gallery
from autonerf_lab.pipeline.run_folder import STAGES, RunConfig, RunFolder
from autonerf_lab.utils import storage
from autonerf_lab.version import __version__

HEADLINES = (
    ("rendering", "psnr"),
    ("rendering", "per_class_accuracy"),
    ("rendering", "depth_median_error_m"),
    ("maps", "free_precision"),
    ("maps", "free_recall"),
    ("planning", "pointgoal_success"),
    ("planning", "objectgoal_success"),
    ("pose_refinement", "convergence_rate"),
)
_NO_VALUE = "–"
_MISSING = "_missing"  # suffix of the status of a score that needs something that is not installed
_ARROWS = {1: "↑", 0: "", -1: "↓"}


@dataclass(frozen=True)
class Section:
    """One section of the page."""

    key: str
    title: str
    text: str
    figures: tuple[dict[str, Any], ...] = ()
    files: tuple[str, ...] = ()
    table: tuple[tuple[str, ...], ...] = ()  # header first


TRAJECTORY = Section(
    "trajectory",
    "Trajectory",
    "The robot explores the apartment with steps of 25 cm and rotations of 30°. It knows only what its camera has "
    "seen. Each step records one image with its pose; these images are the training data of the radiance field.",
)


def write_report(run: RunFolder) -> Path:
    """Write ``report.html`` into the run folder.

    Returns:
        Path of the report.

    Raises:
        RunFolderError: the run has not been evaluated yet.
        DataError: a file of the run is missing or damaged; the message names it.
    """
    run.require("evaluate")
    path = run / "report.html"
    storage.write_bytes(path, render(run).encode())
    return path


def render(run: RunFolder) -> str:
    """Render the page as text."""
    import jinja2

    scores = Scores.load(run / "scores.json")
    paths = {name: run / f"baselines/{name}.json" for name in BASELINES}
    baselines = {name: Scores.load(path) for name, path in paths.items() if path.exists()}
    source = (files("autonerf_lab.pipeline") / "report.html.jinja").read_text(encoding="utf-8")
    template = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined).from_string(source)
    config = run.config
    facts = {"Apartment": config.scene, "Policy": config.policy, "Model": config.model, "Preset": config.preset}
    return template.render(
        config=config,
        facts=[*facts.items(), ("Random seed", config.seed), *_noise(config)],
        sections=_sections(run, scores),
        tiles=_tiles(scores),
        table=score_table(scores, baselines),
        baselines={name.replace("_", " "): BASELINES[name] for name in baselines},
        statuses={row.status for rows in (scores, *baselines.values()) for row in rows},
        cost=_cost(run),
        total_seconds=f"{sum(row['seconds'] for row in run.stages.values()):.0f}",
        version=__version__,
        machine=f"{platform.system()} {platform.machine()}, Python {platform.python_version()}",
    )


def _noise(config: RunConfig) -> list[tuple[str, Any]]:
    """Return noise and pose source of a run, as far as they are set."""
    values = {
        "Noise": config.noise,
        "Noise scale": config.noise_scale,
        "Depth noise": config.depth_noise,
        "Poses of the exploration": config.poses,
        "Classes of the exploration": config.semantics,
        "Poses of the training": config.fit_poses,
    }
    return [(name, value) for name, value in values.items() if value is not None]


def _formatted(metric: Metric, value: float | None, status: str = "ok") -> str:
    if value is not None:
        return metric.format(value)
    if status.endswith(_MISSING):
        return f"no {status.removesuffix(_MISSING)}"
    return status if status != "ok" else _NO_VALUE


def score_table(scores: Scores, baselines: dict[str, Scores]) -> list[dict[str, Any]]:
    """Return the rows of the score table, by task, with the values of the paper and of the baselines.

    Example:
        >>> from autonerf_lab.types import Score
        >>> rows = score_table(Scores([Score("rendering", "psnr", 22.5, "dB", n=8)]), {})[0]["rows"]
        >>> rows[0]["value"], rows[0]["others"]
        ('22.50', ['25.56', '19.75'])
    """
    columns = [{(row.task, row.metric): row for row in rows} for rows in baselines.values()]
    tasks: dict[str, list[dict[str, Any]]] = {}
    for row in scores:
        metric, key = metric_of(row), (row.task, row.metric)
        others = [_formatted(metric, value) for value in metric.paper or (None, None)]
        others += [_formatted(metric, by[key].value, by[key].status) if key in by else _NO_VALUE for by in columns]
        cells = {
            "label": metric.label,
            "unit": metric.display_unit,
            "better": _ARROWS[metric.better],
            "value": _formatted(metric, row.value, row.status),
            "others": others,
            "n": f"{row.n:,}" if row.n else "",
        }
        cells["kind"] = "dim" if row.value is None else "mine"
        tasks.setdefault(row.task, []).append(cells)
    return [{"title": _title(task), "rows": rows} for task, rows in tasks.items()]


def _title(name: str) -> str:
    task = TASKS.get(name) or available().get(name)
    return task.title if task else name.replace("_", " ").capitalize()


def _tiles(scores: Scores) -> list[dict[str, str]]:
    values = {(row.task, row.metric): row.value for row in scores}
    tiles = []
    for key in HEADLINES:
        value, metric = values.get(key), METRICS[key]
        if value is None:
            continue
        best, frontier = (_formatted(metric, published) for published in metric.paper or (None, None))
        note = f"paper: best {best}, frontier {frontier}" if metric.paper else ""
        label = f"{_title(metric.task)}: {metric.label}"
        tiles.append({"label": label, "value": metric.format(value), "unit": metric.display_unit, "note": note})
    return tiles


def _cost(run: RunFolder) -> list[dict[str, str]]:
    slowest = max((row["seconds"] for row in run.stages.values()), default=0.0) or 1.0
    return [
        {
            "stage": stage,
            "seconds": f"{run.stages[stage]['seconds']:.1f}",
            "share": f"{100 * run.stages[stage]['seconds'] / slowest:.1f}",
            "peak": _NO_VALUE if run.stages[stage]["peak_gb"] is None else f"{run.stages[stage]['peak_gb']:.2f} GB",
        }
        for stage in STAGES
        if run.finished(stage)
    ]


def _sections(run: RunFolder, scores: Scores) -> list[Section]:
    figures = [figure for stage in STAGES for figure in read_gallery(run / "figures", stage)]
    tasks = available()
    sections = []
    scored = [row.task for row in scores if row.task in tasks]
    for key in dict.fromkeys([*(figure.section for figure in figures), *scored]):
        if key == TRAJECTORY.key:
            text = f"{TRAJECTORY.text} {tasks[key].text}" if key in scored else TRAJECTORY.text
            section = replace(TRAJECTORY, text=text)
        else:
            section = Section(key, _title(key), tasks[key].text if key in tasks else "")
        embedded = tuple(_embed(run / "figures", figure) for figure in figures if figure.section == key)
        meshes = (path for path in (run / "mesh").glob("*") if key == "mesh" and path.suffix in SCAN_SUFFIXES)
        names = sorted(path.name for path in meshes)
        files, table = tuple(f"mesh/{name}" for name in names), tuple(scores.details_table(key))
        sections.append(replace(section, figures=embedded, files=files, table=table))
    return sections


def _embed(folder: Path, figure: StoredFigure) -> dict[str, Any]:
    source, size = _data_url(folder / figure.file)
    still = _data_url(folder / figure.still)[0] if figure.still else ""
    return {**asdict(figure), "source": source, "still": still, "width": size[0], "height": size[1]}


def _data_url(path: Path) -> tuple[str, tuple[int, int]]:
    if path.is_symlink() or path.parent.is_symlink():
        raise DataError(f"{path} is a symbolic link, which a report does not follow; run the stage again")
    try:
        data = storage.read_bytes(path)
        with Image.open(io.BytesIO(data), formats=["PNG", "WEBP"]) as image:
            image.load()  # the header of a truncated file is still valid
            size = image.size
    except (OSError, ValueError, SyntaxError) as error:
        raise DataError(f"cannot read the figure {path}: {error}; run the stage that draws it again") from error
    kind = "webp" if path.suffix == ".webp" else "png"
    return data_url(data, kind), size
