"""Predicted labels: single frames, fields and fused labels, in scenes without training frames.

``python benchmarks/segmentation.py [--quick]`` scores the frames in the development scenes and measures their time.
``--runs PREDICTED`` also compares the fields of a results folder with the frames and with the labels of the frames
fused in a point cloud (about two minutes a run on one core), ``--true-runs TRUE`` with the fields of true labels. These
commands write the folders::

    GRID="--policies modular-obs --scenes dev --starts 1 --save-runs --models semantic-nerfacto-rgbd"
    autonerf-lab bench run $GRID --semantics predicted --out PREDICTED
    autonerf-lab bench run $GRID --out TRUE

``--out DIR`` keeps the figures and the IoU of each class in each run.
"""

import argparse
import json
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from common.output import write_csv

import autonerf_lab as lab
from autonerf_lab.benchmark.statistics import Interval, Runs, difference, interval
from autonerf_lab.classes import CLASS_NAMES, NUM_CLASSES
from autonerf_lab.errors import DataError
from autonerf_lab.evaluators import Scores
from autonerf_lab.evaluators.rendering import sample_test_poses
from autonerf_lab.evaluators.segmentation import SegmentationErrors
from autonerf_lab.pipeline import StageContext
from autonerf_lab.pipeline.run_folder import load_run
from autonerf_lab.presets import preset
from autonerf_lab.scenes import scene_names
from autonerf_lab.segmentation import make_segmenter
from autonerf_lab.segmentation.metrics import class_scores, object_precision_recall
from autonerf_lab.viz import figures

SIZE = preset("fast")
SHOWN = (
    ("rendering", "psnr"),
    ("rendering", "per_class_accuracy"),
    ("rendering", "miou"),
    ("planning", "objectgoal_success"),
)
COLUMNS = ("frames", "field", "fused", "true")  # of a run: single frames, field, fused labels, field of true labels


def text(found: Interval) -> str:
    """Format a mean and its interval; a single scene has none."""
    return str(found) if found.scenes > 1 else f"{found.mean:.1f}"


def class_iou(confusion: np.ndarray) -> np.ndarray:
    """Return the IoU of each class in percent, NaN for classes that are not in the targets."""
    hits, target, predicted = np.diag(confusion), confusion.sum(axis=1), confusion.sum(axis=0)
    return np.where(target > 0, 100 * hits / np.maximum(target + predicted - hits, 1), np.nan)


def score_frames(name: str, segmenter: str, poses: int, total: SegmentationErrors) -> tuple[np.ndarray, float, float]:
    """Segment the test views of a scene; return the confusion matrix and the ms of a frame, alone and in a batch."""
    sim = lab.Simulator.from_preset(lab.load_scene(name), SIZE)
    made, errors, seconds = make_segmenter(segmenter), SegmentationErrors(), []
    made.reset(np.random.default_rng(0))
    # All views first: a network runs slower on cores that waited for the renderer, which uses one of them.
    frames = [sim.render(c2w) for c2w in sample_test_poses(sim, poses)]
    found = []
    for frame in frames:
        start = time.perf_counter()
        found.append(made(frame.rgb, frame.depth, frame.semantics))
        seconds.append(time.perf_counter() - start)
    batch = [np.stack([getattr(frame, kind) for frame in frames]) for kind in ("rgb", "depth", "semantics")]
    start = time.perf_counter()
    made(*batch)
    in_batch = (time.perf_counter() - start) / len(frames)
    for labels, frame in zip(found, frames, strict=True):
        for counts in (errors, total):
            counts.add(labels, frame)
    return errors.confusion, 1000 * float(np.median(seconds)), 1000 * in_batch


@dataclass(frozen=True)
class FieldScores:
    """Scores of a run with predicted labels, beside those of the same run with true labels."""

    scene: str
    start: int
    scores: dict[str, Scores]  # by column; ``field`` and ``true`` are those of the results folders
    classes: dict[str, np.ndarray]  # (16,) IoU of each class, percent, by column; nan if it is not in the test views


def saved_runs(results: Path) -> dict[tuple[str, int], StageContext]:
    """Return the finished runs of a results folder by scene and start.

    Raises:
        DataError: there are none.
    """
    found = {}
    for path in sorted((results / "runs").glob("*/run.json")):
        run = load_run(path.parent)
        if run.finished("evaluate"):
            found[run.config.scene, run.config.seed] = StageContext(run)
    if not found:
        raise DataError(f"{results} has no finished runs; `autonerf-lab bench run --save-runs` keeps them")
    return found


def score_run(predicted: StageContext, true: StageContext | None, out: Path | None) -> FieldScores:
    """Score the frames, the field and the fused labels of a run at the same test views."""
    config = predicted.run.config
    found = lab.evaluate(
        predicted.nerf, predicted.scene, predicted.preset, config.seed, tasks=["rendering", "segmentation"],
        trajectory=predicted.trajectory, progress=False,
    )  # fmt: skip
    fused = found.baselines["fused_labels"]
    both = ("field", predicted), ("true", true)
    stored = {column: Scores([]) if c is None else Scores.load(c.run / "scores.json") for column, c in both}
    frames = Scores([row for row in stored["field"] if row.task == "segmentation"])
    artifacts = {
        "frames": found.artifacts["segmentation"],
        "field": found.artifacts["rendering"],
        "fused": fused.artifacts["rendering"],
    }
    if out is not None:
        figure = figures.segmentation_views(artifacts["frames"])
        figure.savefig(out / f"{config.scene}-{config.seed}-segmentation_views.png", dpi=110)
    return FieldScores(
        config.scene,
        config.seed,
        {"frames": frames, "fused": fused, **stored},
        {column: class_iou(artifact["confusion"]) for column, artifact in artifacts.items()},
    )


def by_scene(runs: list[FieldScores], value: Callable[[FieldScores], float | None]) -> Runs:
    """Return the values of all runs by scene, without those that are unknown."""
    found: dict[str, list[float]] = defaultdict(list)
    for run in runs:
        number = value(run)
        if number is not None and np.isfinite(number):
            found[run.scene].append(number)
    return found


def score_of(task: str, metric: str, column: str) -> Callable[[FieldScores], float | None]:
    """Return a function that looks up a score of a run; single frames have their own task."""
    key = ("segmentation" if column == "frames" else task), metric
    return lambda run: next((row.value for row in run.scores[column] if (row.task, row.metric) == key), None)


def iou_of(k: int, column: str) -> Callable[[FieldScores], float]:
    """Return a function that looks up the IoU of a class in a run."""
    return lambda run: float(run.classes[column][k])


def print_row(title: str, columns: dict[str, Runs], pairs: tuple[tuple[str, str], ...]) -> None:
    """Print means with intervals, and paired differences."""
    cells = [text(interval(values)) if values else "" for values in columns.values()]
    for a, b in pairs:
        both = columns[a] and columns[b]
        cells.append(text(difference(columns[a], columns[b])) if both else "")
    print(f"{title:<32}" + "".join(f"{cell:>16}" for cell in cells))


def compare_fields(runs: list[FieldScores]) -> dict[str, float]:
    """Print the scores of the fields, and the IoU of each class in frames, field and fused labels."""
    pairs: tuple[tuple[str, str], ...] = (("field", "frames"), ("field", "fused"), ("field", "true"))
    titles = ["frames", "field", "fused labels", "true labels", *(f"{a} - {b}" for a, b in pairs)]
    print(f"\n{'mean over scenes, 95 % interval':<32}" + "".join(f"{title:>16}" for title in titles))
    found: dict[str, float] = {}
    for task, metric in SHOWN:
        columns = {column: by_scene(runs, score_of(task, metric, column)) for column in COLUMNS}
        print_row(f"{task}: {metric}", columns, pairs)
        found |= {f"{metric}_{name}": round(interval(values).mean, 2) for name, values in columns.items() if values}
    pairs = (("field", "frames"), ("field", "fused"))
    titles = ["frames", "field", "fused labels", *(f"{a} - {b}" for a, b in pairs)]
    print(f"\n{'IoU of the class, %':<32}" + "".join(f"{title:>16}" for title in titles))
    for k in range(NUM_CLASSES):
        columns = {column: by_scene(runs, iou_of(k, column)) for column in ("frames", "field", "fused")}
        if columns["frames"]:
            print_row(CLASS_NAMES[k], columns, pairs)
    return found


def class_rows(runs: list[FieldScores]) -> list[dict[str, object]]:
    """Return the IoU of each class in each run as rows of a table; empty if the class is not in the test views."""
    return [
        {"scene": run.scene, "start": run.start, "class": CLASS_NAMES[k]}
        | {column: float(iou[k]) if np.isfinite(iou[k]) else None for column, iou in run.classes.items()}
        for run in runs
        for k in range(NUM_CLASSES)
    ]


def main() -> None:
    """Run the benchmark and print tables, then one JSON object as the last line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="One scene, 20 views.")
    parser.add_argument("--scenes", default=",".join(scene_names("dev")), help="Names, separated by commas.")
    parser.add_argument("--semantics", default="predicted", help="Segmenter.")
    parser.add_argument("--runs", type=Path, default=None, help="Results folder with saved runs of predicted labels.")
    parser.add_argument("--true-runs", type=Path, default=None, help="The same of true labels.")
    parser.add_argument("--out", type=Path, default=None, help="Folder of figures and of the table of classes.")
    options = parser.parse_args()
    names = options.scenes.split(",")[: 1 if options.quick else None]
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
    total = SegmentationErrors()
    times: list[tuple[float, float]] = []  # ms per frame, alone and in a batch
    runs: dict[str, list[float]] = {}
    print(f"{'scene':<12}{'mIoU':>10}{'per-class':>12}{'precision':>12}{'recall':>10}{'ms/frame':>12}{'in batch':>12}")
    for name in names:
        confusion, alone, in_batch = score_frames(
            name, options.semantics, 20 if options.quick else SIZE.test_poses, total
        )
        scores = class_scores(confusion)
        found = scores["miou"], scores["per_class_accuracy"], *object_precision_recall(confusion)
        values = [float("nan") if value is None else value for value in found]
        runs[name] = values
        times.append((alone, in_batch))
        print(f"{name:<12}{values[0]:>10.1f}{values[1]:>12.1f}{values[2]:>12.1f}{values[3]:>10.1f}", end="")
        print(f"{alone:>12.1f}{in_batch:>12.1f}")
    columns = [interval({name: [values[k]] for name, values in runs.items()}) for k in range(4)]
    print(f"{'mean':<12}" + "".join(f"{text(found):>14}" for found in columns))
    alone, in_batch = np.median(times, axis=0)
    result = {"frame_ms": round(float(alone), 2), "batch_frame_ms": round(float(in_batch), 2)}
    result["calibration_error"] = round(total.calibration_error, 4)
    result |= dict(
        zip(("miou", "per_class_accuracy", "precision", "recall"), (round(c.mean, 2) for c in columns), strict=True)
    )
    if options.out is not None:
        for figure in ("segmentation_failures", "reliability_diagram"):
            getattr(figures, figure)({"errors": total}).savefig(options.out / f"{figure}.png", dpi=110)
    if options.runs is not None:
        true = saved_runs(options.true_runs) if options.true_runs else {}
        compared = [
            score_run(run, true.get(key), options.out)
            for key, run in saved_runs(options.runs).items()
            if key[0] in names
        ]
        if not compared:
            raise DataError(f"{options.runs} has no run in {', '.join(names)}")
        result |= compare_fields(compared)
        if options.out is not None:
            write_csv(options.out / "classes.csv", class_rows(compared))
    print(json.dumps(result))


if __name__ == "__main__":
    main()
