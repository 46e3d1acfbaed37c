"""Predicted labels: single frames, fields and fused labels, in scenes without training frames.

``python benchmarks/segmentation.py [--quick]`` scores the frames in the development scenes and measures their time.
``--fields`` also explores each scene with ``modular-obs``, with true and with predicted labels, and scores both fields
(about eight minutes a scene on two cores). ``--out DIR`` keeps the figures and the scores of every field.
"""

import argparse
import json
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np

import autonerf_lab as lab
from autonerf_lab.benchmark.statistics import Interval, difference, interval
from autonerf_lab.classes import CLASS_NAMES, NUM_CLASSES
from autonerf_lab.config import preset
from autonerf_lab.evaluators import Scores
from autonerf_lab.evaluators.rendering import sample_test_poses
from autonerf_lab.evaluators.segmentation import SegmentationErrors
from autonerf_lab.scenes import scene_names
from autonerf_lab.segmentation import make_segmenter
from autonerf_lab.segmentation.metrics import class_scores, object_precision_recall
from autonerf_lab.viz import figures

POLICY, MODEL, SIZE = "modular-obs", "semantic-nerfacto", preset("fast")
SHOWN = (
    ("rendering", "psnr"),
    ("rendering", "per_class_accuracy"),
    ("rendering", "miou"),
    ("planning", "objectgoal_success"),
)


def text(found: Interval) -> str:
    """Format a mean and its interval; a single scene has none."""
    return str(found) if found.scenes > 1 else f"{found.mean:.1f}"


def class_iou(confusion: np.ndarray) -> np.ndarray:
    """Return the IoU of each class in percent, NaN for classes that are not in the targets."""
    hits, target, predicted = np.diag(confusion), confusion.sum(axis=1), confusion.sum(axis=0)
    return np.where(target > 0, 100 * hits / np.maximum(target + predicted - hits, 1), np.nan)


def score_frames(name: str, segmenter: str, poses: int, total: SegmentationErrors) -> tuple[np.ndarray, float]:
    """Segment the test views of a scene; return the confusion matrix and the seconds per frame."""
    sim = lab.Simulator.from_preset(lab.load_scene(name), SIZE)
    made, errors, seconds = make_segmenter(segmenter), SegmentationErrors(), []
    made.reset(np.random.default_rng(0))
    for c2w in sample_test_poses(sim, poses):
        frame = sim.render(c2w)
        start = time.perf_counter()
        found = made(frame.rgb, frame.depth, frame.semantics)
        seconds.append(time.perf_counter() - start)
        for counts in (errors, total):
            counts.add(found, frame)
    return errors.confusion, float(np.median(seconds))


def score_field(name: str, source: str, steps: int | None, out: Path | None) -> Scores:
    """Explore a scene with labels of a source, fit a field and score it."""
    scene = lab.load_scene(name)
    sim = lab.Simulator.from_preset(scene, SIZE, semantics=source)
    trajectory = lab.explore(sim, POLICY, steps=steps or SIZE.episode_steps, progress=False)
    nerf = lab.fit(trajectory, MODEL, SIZE, steps=steps, progress=False)
    tasks = ["rendering", "planning", *([] if source == "true" else ["segmentation"])]
    scores = lab.evaluate(nerf, scene, SIZE, tasks=tasks, trajectory=trajectory, progress=False)
    if out is not None:
        scores.save(out / f"{name}-{source}.json")
        for figure in ("segmentation_views",) if source != "true" else ():
            getattr(figures, figure)(scores.artifacts["segmentation"]).savefig(out / f"{name}-{figure}.png", dpi=110)
    return scores


def compare_fields(by_scene: Mapping[str, dict[str, Scores]], source: str) -> dict[str, float]:
    """Print the scores of the fields, and the IoU of each class in frames, field and fused labels."""
    columns = {"true labels": lambda s: s["true"], f"{source} labels": lambda s: s[source],
               "fused labels": lambda s: s[source].baselines["fused_labels"]}  # fmt: skip
    print(f"\n{'mean over scenes, 95 % interval':<34}" + "".join(f"{title:>20}" for title in columns))
    found: dict[str, float] = {}
    for task, metric in SHOWN:
        cells = []
        for title, of in columns.items():
            scores = {scene: of(s) for scene, s in by_scene.items()}
            known = [s for s in scores if (task, metric) in {(row.task, row.metric) for row in scores[s]}]
            runs = {scene: [scores[scene][task, metric]] for scene in known}
            cells.append(f"{text(interval(runs)) if runs else '':>20}")
            if runs:
                found[f"{metric}_{title.split()[0]}"] = round(interval(runs).mean, 2)
        print(f"{task + ': ' + metric:<34}" + "".join(cells))
    parts = {
        "frames": [class_iou(s[source].artifacts["segmentation"]["confusion"]) for s in by_scene.values()],
        "field": [class_iou(s[source].artifacts["rendering"]["confusion"]) for s in by_scene.values()],
        "fused": [
            class_iou(s[source].baselines["fused_labels"].artifacts["rendering"]["confusion"])
            for s in by_scene.values()
        ],
    }
    print(f"\n{'IoU of the class, %':<20}{'frames':>10}{'field':>10}{'fused':>10}{'field - frames':>20}")
    for k in range(NUM_CLASSES):
        runs = {
            part: {str(i): [iou[k]] for i, iou in enumerate(ious) if np.isfinite(iou[k])}
            for part, ious in parts.items()
        }
        if runs["frames"]:
            means = "".join(f"{interval(values).mean:>10.1f}" for values in runs.values())
            print(f"{CLASS_NAMES[k]:<20}{means}{text(difference(runs['field'], runs['frames'])):>20}")
    return found


def main() -> None:
    """Run the benchmark and print tables, then one JSON object as the last line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="One scene, 20 views.")
    parser.add_argument("--scenes", default=",".join(scene_names("dev")), help="Names, separated by commas.")
    parser.add_argument("--semantics", default="predicted", help="Segmenter.")
    parser.add_argument("--fields", action="store_true", help="Also explore, fit and score fields.")
    parser.add_argument("--steps", type=int, default=None, help="Steps of episode and fit, for a look.")
    parser.add_argument("--out", type=Path, default=None, help="Folder of figures and scores.")
    options = parser.parse_args()
    names = options.scenes.split(",")[: 1 if options.quick else None]
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
    total, times, runs = SegmentationErrors(), [], {}
    print(f"{'scene':<12}{'mIoU':>10}{'per-class':>12}{'precision':>12}{'recall':>10}{'ms/frame':>12}")
    for name in names:
        confusion, seconds = score_frames(name, options.semantics, 20 if options.quick else SIZE.test_poses, total)
        scores, (precision, recall) = class_scores(confusion), object_precision_recall(confusion)
        values = scores["miou"], scores["per_class_accuracy"], precision, recall
        runs[name], times = values, [*times, 1000 * seconds]
        print(f"{name:<12}{values[0]:>10.1f}{values[1]:>12.1f}{values[2]:>12.1f}{values[3]:>10.1f}{times[-1]:>12.1f}")
    columns = [interval({name: [values[k]] for name, values in runs.items()}) for k in range(4)]
    print(f"{'mean':<12}" + "".join(f"{text(found):>14}" for found in columns))
    result = {"frame_ms": round(float(np.median(times)), 2), "calibration_error": round(total.calibration_error, 4)}
    result |= dict(
        zip(("miou", "per_class_accuracy", "precision", "recall"), (round(c.mean, 2) for c in columns), strict=True)
    )
    if options.out is not None:
        for figure in ("segmentation_failures", "reliability_diagram"):
            getattr(figures, figure)({"errors": total}).savefig(options.out / f"{figure}.png", dpi=110)
    if options.fields:
        by_scene = {
            name: {
                source: score_field(name, source, options.steps, options.out) for source in ("true", options.semantics)
            }
            for name in names
        }
        result |= compare_fields(by_scene, options.semantics)
    print(json.dumps(result))


if __name__ == "__main__":
    main()
