"""The report of a run: one self-contained HTML page, made from nothing but the run's folder.

Pictures are embedded, there is no script and nothing is fetched; all text goes through autoescape.
"""

import io
import platform
from dataclasses import asdict, dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

from PIL import Image

from autonerf_lab import __version__
from autonerf_lab.data.images import data_url
from autonerf_lab.errors import DataError
from autonerf_lab.evaluators.scores import FINETUNED, PAPER, Scores
from autonerf_lab.pipeline.gallery import Picture, read_gallery
from autonerf_lab.pipeline.run_folder import STAGES, RunFolder
from autonerf_lab.types import Score
from autonerf_lab.utils import storage

BASELINES = ("nearest_view", "tsdf", "oracle")
_NO_VALUE = "–"
_MISSING = "_missing"  # ends the status of a score that wants something which is not installed; the template says how


@dataclass(frozen=True)
class Section:
    """A part of the page."""

    key: str
    title: str
    text: str
    figures: tuple[dict[str, Any], ...] = ()
    files: tuple[str, ...] = ()
    table: tuple[tuple[str, ...], ...] = ()  # header first


SECTIONS: tuple[Section, ...] = (
    Section(
        "walk",
        "The walk",
        "The robot turns by 30°, moves by 25 cm, and knows nothing but what its camera has shown it. Every step leaves "
        "one image with its pose: this is all that the field will ever learn from.",
    ),
    Section(
        "rendering",
        "What the field shows",
        "Poses that the walk never visited, spread evenly over the floor. The field has to show what a camera would "
        "see there: colour, class and distance.",
    ),
    Section(
        "geometry",
        "Where its surfaces are",
        "A field can show a good picture from surfaces that stand in the wrong place. Depth tells, and so does its "
        "density: maps, paths, poses and meshes are only as good as these.",
    ),
    Section(
        "maps",
        "The maps inside it",
        "A map is read from the field's density and classes, at one centimetre a cell. What no training view has seen "
        "counts as unknown, neither free nor occupied.",
    ),
    Section(
        "planning",
        "Paths planned in it",
        "Paths are planned on the map of the field and judged on the true one: a path succeeds when it ends within a "
        "metre of its goal and does not cut through furniture.",
    ),
    Section(
        "pose_refinement",
        "A camera finding itself",
        "A camera is turned by 5° and moved by 5 cm, then follows the gradient of the picture through the frozen field "
        "back to where the target image was taken.",
    ),
    Section("mesh", "The mesh", "The field's surface as triangles, with its colours and its classes."),
    Section(
        "navigation",
        "Walks in the mesh",
        "The mesh as a place to walk in, step by step: the same episodes as in the true scene, with a map that is made "
        "on the way.",
    ),
    Section(
        "finetuning",
        "Practice in the mesh",
        "A policy that goes to a place by depth alone practises in the mesh, and, as a bound, in the true scene. All "
        "are judged in the true scene.",
    ),
)

# label, unit of display, better when, decimals
METRICS: dict[tuple[str, str], tuple[str, str, str, int]] = {
    ("rendering", "psnr"): ("PSNR", "dB", "↑", 2),
    ("rendering", "ssim"): ("SSIM", "", "↑", 3),
    ("rendering", "lpips"): ("LPIPS", "", "↓", 3),
    ("rendering", "flip"): ("FLIP", "", "↓", 3),
    ("rendering", "per_class_accuracy"): ("Per-class accuracy", "%", "↑", 1),
    ("rendering", "miou"): ("Mean IoU", "%", "↑", 1),
    ("rendering", "miou_objects"): ("Mean IoU, objects only", "%", "↑", 1),
    ("rendering", "depth_median_error_m"): ("Depth error, median", "cm", "↓", 1),
    ("maps", "free_accuracy"): ("Free space: accuracy", "%", "↑", 1),
    ("maps", "free_precision"): ("Free space: precision", "%", "↑", 1),
    ("maps", "free_recall"): ("Free space: recall", "%", "↑", 1),
    ("maps", "occupancy_precision"): ("Occupied within 5 cm: precision", "%", "↑", 1),
    ("maps", "occupancy_recall"): ("Occupied within 5 cm: recall", "%", "↑", 1),
    ("maps", "semantic_accuracy"): ("Objects: accuracy", "%", "↑", 1),
    ("maps", "semantic_precision"): ("Objects: precision", "%", "↑", 1),
    ("maps", "semantic_recall"): ("Objects: recall", "%", "↑", 1),
    ("maps", "semantic_precision_5cm"): ("Objects within 5 cm: precision", "%", "↑", 1),
    ("maps", "semantic_recall_5cm"): ("Objects within 5 cm: recall", "%", "↑", 1),
    ("planning", "pointgoal_success"): ("PointGoal: success", "%", "↑", 1),
    ("planning", "pointgoal_spl"): ("PointGoal: SPL", "%", "↑", 1),
    ("planning", "objectgoal_success"): ("ObjectGoal: success", "%", "↑", 1),
    ("planning", "objectgoal_spl"): ("ObjectGoal: SPL", "%", "↑", 1),
    ("pose_refinement", "convergence_rate"): ("Converged", "%", "↑", 1),
    ("pose_refinement", "rotation_convergence_rate"): ("Converged in rotation (3°)", "%", "↑", 1),
    ("pose_refinement", "translation_convergence_rate"): ("Converged in position (2 cm)", "%", "↑", 1),
    ("pose_refinement", "rotation_error_deg"): ("Rotation error of the converged", "°", "↓", 3),
    ("pose_refinement", "translation_error_m"): ("Position error of the converged", "mm", "↓", 1),
    ("mesh", "accuracy_m"): ("Accuracy", "cm", "↓", 1),
    ("mesh", "completion_m"): ("Completion", "cm", "↓", 1),
    ("mesh", "completion_ratio"): ("Completed within 5 cm", "%", "↑", 1),
    ("mesh", "normal_consistency"): ("Normal consistency", "", "↑", 3),
    ("mesh", "completion_m_all"): ("Completion, unseen parts too", "cm", "↓", 1),
    ("mesh", "completion_ratio_all"): ("Completed within 5 cm, unseen parts too", "%", "↑", 1),
    ("mesh", "normal_consistency_all"): ("Normal consistency, unseen parts too", "", "↑", 3),
    ("navigation", "success"): ("Success in the mesh", "%", "↑", 1),
    ("navigation", "spl"): ("SPL in the mesh", "%", "↑", 1),
    ("navigation", "success_true_mesh"): ("Success in the true scene", "%", "↑", 1),
    ("navigation", "spl_true_mesh"): ("SPL in the true scene", "%", "↑", 1),
    **{
        ("finetuning", f"{metric}_{stage}"): (f"{title}, {label}", "%", "↑", 1)
        for stage, label in FINETUNED.items()
        for metric, title in (("success", "Success"), ("spl", "SPL"))
    },
    ("exploration", "explored_area_m2"): ("Explored area", "m²", "↑", 1),
    ("exploration", "collisions"): ("Collisions", "", "↓", 0),
    ("exploration", "path_length_m"): ("Path length", "m", "", 1),
}
TITLES = {"pose_refinement": "Pose refinement", "navigation": "Navigation in the mesh", "finetuning": "Fine-tuning"}
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
_SCALE = {"cm": 100.0, "mm": 1000.0}  # scores are in metres


def write_report(run: RunFolder) -> Path:
    """Write ``report.html`` into the run folder.

    Returns:
        Its path.

    Raises:
        RunFolderError: the run has not been evaluated yet.
        DataError: a file of the run is missing or damaged; the message names it.
    """
    run.require("evaluate")
    path = run / "report.html"
    storage.write_bytes(path, render(run).encode())
    return path


def render(run: RunFolder) -> str:
    """The page as text."""
    import jinja2

    scores = Scores.load(run / "scores.json")
    others = {name: _baseline(run, name) for name in BASELINES}
    source = (files("autonerf_lab.pipeline") / "report.html.jinja").read_text(encoding="utf-8")
    template = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined).from_string(source)
    config = run.config
    facts = {"Apartment": config.scene, "Policy": config.policy, "Model": config.model, "Preset": config.preset}
    return template.render(
        config=config,
        facts=[*facts.items(), ("Seed", config.seed)],
        sections=_sections(run, scores),
        tiles=_tiles(scores),
        table=score_table(scores, others),
        statuses={row.status for rows in (scores, *others.values()) for row in rows},
        cost=_cost(run),
        total_seconds=f"{sum(row['seconds'] for row in run.stages.values()):.0f}",
        version=__version__,
        machine=f"{platform.system()} {platform.machine()}, Python {platform.python_version()}",
    )


def number(key: tuple[str, str], value: float | None, status: str = "ok") -> str:
    """A score as the report prints it, or why there is none.

    Example:
        >>> number(("rendering", "depth_median_error_m"), 0.0834)
        '8.3'
        >>> number(("rendering", "lpips"), None, "weights_missing")
        'no weights'
    """
    if value is None:
        if status.endswith(_MISSING):
            return f"no {status.removesuffix(_MISSING)}"
        return status if status != "ok" else _NO_VALUE
    _, unit, _, decimals = METRICS.get(key, (key[1], "", "", 3))
    return f"{value * _SCALE.get(unit, 1.0):.{decimals}f}"


def score_table(scores: Scores, others: dict[str, Scores]) -> list[dict[str, Any]]:
    """The rows of the table, by task: this run beside the paper and the baselines.

    Example:
        >>> rows = score_table(Scores([Score("rendering", "psnr", 22.5, "dB", n=8)]), {})[0]["rows"]
        >>> rows[0]["value"], rows[0]["others"]
        ('22.50', ['25.56', '19.75'])
    """
    columns = [{(row.task, row.metric): row for row in rows} for rows in others.values()]
    tasks: dict[str, list[dict[str, Any]]] = {}
    for row in scores:
        key = (row.task, row.metric)
        label, unit, better, _ = METRICS.get(key, (row.metric.replace("_", " "), row.unit, "", 3))
        paper = [number(key, value) for value in PAPER.get(key, (None, None))]
        yard = [number(key, by[key].value, by[key].status) if key in by else _NO_VALUE for by in columns]
        value = number(key, row.value, row.status)
        cells = {
            "label": label,
            "unit": unit,
            "better": better,
            "value": value,
            "others": paper + yard,
            "n": f"{row.n:,}" if row.n else "",
        }
        cells["kind"] = "dim" if row.value is None else "mine"
        tasks.setdefault(row.task, []).append(cells)
    return [{"title": TITLES.get(task, task.capitalize()), "rows": rows} for task, rows in tasks.items()]


def _baseline(run: RunFolder, name: str) -> Scores:
    path = run / f"baselines/{name}.json"
    return Scores.load(path) if path.exists() else Scores()


def _tiles(scores: Scores) -> list[dict[str, str]]:
    by_key: dict[tuple[str, str], Score] = {(row.task, row.metric): row for row in scores}
    tiles = []
    for key in HEADLINES:
        if key not in by_key or by_key[key].value is None:
            continue
        label, unit, _, _ = METRICS[key]
        paper = PAPER.get(key)
        note = f"paper: {number(key, paper[0])} at best, frontier {number(key, paper[1])}" if paper else ""
        label = "Cameras that found themselves" if key[0] == "pose_refinement" else label
        tiles.append({"label": label, "value": number(key, by_key[key].value), "unit": unit, "note": note})
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
    pictures = [picture for stage in STAGES for picture in read_gallery(run / "figures", stage)]
    sections = []
    for section in SECTIONS:
        figures = tuple(_embed(run / "figures", p) for p in pictures if p.section == section.key)
        names = sorted(p.name for p in (run / "mesh").glob("*.[gp]l[by]")) if section.key == "mesh" else []
        table = tuple(scores.practice() if section.key == "finetuning" else scores.endings(section.key))
        if figures:
            files = tuple(f"mesh/{name}" for name in names)
            sections.append(replace(section, figures=figures, files=files, table=table))
    return sections


def _embed(folder: Path, picture: Picture) -> dict[str, Any]:
    source, size = _picture(folder / picture.file)
    still = _picture(folder / picture.still)[0] if picture.still else ""
    return {**asdict(picture), "source": source, "still": still, "width": size[0], "height": size[1]}


def _picture(path: Path) -> tuple[str, tuple[int, int]]:
    try:
        data = path.read_bytes()
        with Image.open(io.BytesIO(data), formats=["PNG", "WEBP"]) as image:
            image.load()  # a file that was cut off has a header that looks well
            size = image.size
    except (OSError, ValueError, SyntaxError) as error:
        raise DataError(f"cannot read the picture {path}: {error}; run the stage that draws it again") from error
    kind = "webp" if path.suffix == ".webp" else "png"
    return data_url(data, kind), size
