"""Task 9, segmentation: predicted labels against those of the simulator, on test views.

The views are those of the task ``rendering``: what a single frame predicts there can be compared with what the field,
which has fused the predictions of many frames, renders there. The segmenter is that of the trajectory, ``semantics`` in
the metadata of the field. A field of true labels has nothing to score.

* Per-class accuracy and mIoU as in ``rendering``.
* Precision and recall: means over the object classes in the views.
* Reliability: share of right labels among the pixels of each tenth of the confidence (Guo et al. 2017).
"""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from autonerf_lab.classes import NUM_CLASSES
from autonerf_lab.evaluators.metrics import metrics_of
from autonerf_lab.evaluators.rendering import sample_test_poses
from autonerf_lab.evaluators.task import Task, TaskFigure, TaskResult
from autonerf_lab.segmentation import TRUE, Segmentation, make_segmenter
from autonerf_lab.segmentation.metrics import class_scores, confusion_matrix, object_precision_recall

if TYPE_CHECKING:
    from autonerf_lab.evaluators.context import EvaluationContext
    from autonerf_lab.presets import Preset
    from autonerf_lab.simulator import Frame

DISTANCES = (0.0, 1.0, 2.0, 3.0, 4.0, 6.0, np.inf)  # edges of the bins of depth, metres
SIZES = (0.0, 16.0, 64.0, 256.0, 1024.0, np.inf)  # edges of the bins of the visible size of an object, pixels
BINS = 10  # of the confidence
_STORED = 6  # views, for the figure


@dataclass
class SegmentationErrors:
    """Counts of right and wrong labels, by class, confidence, distance and size of the object.

    Example:
        >>> from autonerf_lab.simulator import Frame
        >>> truth, depth = np.array([[1, 1, 0, 0]], np.uint8), np.full((1, 4), 2.5, np.float32)
        >>> frame = Frame(np.zeros((1, 4, 3), np.uint8), depth, truth, np.array([[3, 3, 0, 0]]))
        >>> errors = SegmentationErrors()
        >>> errors.add(Segmentation(np.array([[1, 0, 0, 0]], np.uint8), np.full((1, 4), 0.75)), frame)
        >>> errors.by_distance[1, 2].tolist(), errors.by_size[1, 0].tolist(), errors.reliability[7].tolist()
        ([2.0, 1.0], [2.0, 1.0], [4.0, 3.0, 3.0])
    """

    confusion: np.ndarray = field(default_factory=lambda: np.zeros((NUM_CLASSES, NUM_CLASSES), np.int64))
    by_distance: np.ndarray = field(default_factory=lambda: np.zeros((NUM_CLASSES, len(DISTANCES) - 1, 2)))
    by_size: np.ndarray = field(default_factory=lambda: np.zeros((NUM_CLASSES, len(SIZES) - 1, 2)))
    reliability: np.ndarray = field(default_factory=lambda: np.zeros((BINS, 3)))  # pixels, sum of confidences, hits

    def add(self, found: Segmentation, frame: "Frame") -> None:
        """Count the pixels of one view; the last axis of ``by_distance`` and ``by_size`` holds pixels and hits."""
        truth = frame.semantics
        self.confusion += confusion_matrix(found.labels, truth)
        hit = found.labels == truth
        tenth = np.minimum((found.confidence * BINS).astype(np.int64), BINS - 1)
        for column, weights in enumerate((None, found.confidence.ravel(), hit.ravel())):
            self.reliability[:, column] += np.bincount(tenth.ravel(), weights, minlength=BINS)
        size = np.bincount(frame.instances.ravel())[frame.instances]
        for table, edges, value in ((self.by_distance, DISTANCES, frame.depth), (self.by_size, SIZES, size)):
            index = truth * table.shape[1] + np.clip(np.digitize(value, edges) - 1, 0, table.shape[1] - 1)
            for column, weights in enumerate((None, hit.ravel())):
                counts = np.bincount(index.astype(np.int64).ravel(), weights, minlength=table[..., 0].size)
                table[..., column] += counts.reshape(table.shape[:2])

    @property
    def calibration_error(self) -> float:
        """Mean distance of confidence and accuracy over the pixels, the expected calibration error, 0 to 1."""
        pixels, confidence, hits = self.reliability.T
        return float(np.abs(confidence - hits).sum() / max(pixels.sum(), 1))


class SegmentationTask(Task):
    """Task 9: predicted labels on the test views."""

    name, metrics, title = "segmentation", metrics_of("segmentation"), "Segmentation"
    optional = True
    text = (
        "The segmenter of the robot labels each image of the simulator at the test poses. This section scores these "
        "labels. The field was trained on the predicted labels of all images of the trajectory; its labels at the same "
        "poses are scored in the section on rendering."
    )
    figures = (
        TaskFigure(
            "predictions",
            "segmentation_views",
            title="Predicted and fused labels",
            caption="One row per test pose: image, labels of the segmenter for this image, labels of the field, and "
            "ground truth.",
            alt="Grid of images, one row per test pose: colour, predicted classes, classes of the field, true classes",
        ),
        TaskFigure(
            "failures",
            "segmentation_failures",
            title="Where the predictions fail",
            caption="Share of the pixels of each class with the right label, by distance and by the visible size of "
            "the object. Cells with fewer than 20 pixels are empty.",
            alt="Two heat maps of accuracy per class: by distance from the camera and by size in the image",
        ),
        TaskFigure(
            "reliability",
            "reliability_diagram",
            title="Reliability of the confidences",
            caption="For the pixels of each tenth of the confidence, the share of right labels. On the diagonal, "
            "confidences are probabilities.",
            alt="Reliability diagram: share of right labels over confidence, with the number of pixels",
        ),
    )

    def run(self, context: "EvaluationContext") -> TaskResult:
        """Segment the test views and compare the labels with those of the simulator."""
        name = str(context.field.meta.get("semantics") or TRUE)
        names = [metric.name for metric in self.metrics]
        if name == TRUE:
            return TaskResult(dict.fromkeys(names), {}, dict.fromkeys(names, "true labels: no segmenter"))
        segmenter = make_segmenter(name)
        segmenter.reset(np.random.default_rng([context.seed, 9]))
        errors = SegmentationErrors()
        views: list[dict[str, Any]] = []
        poses = sample_test_poses(context.sim, context.preset.test_poses, context.seed)
        for c2w in poses:
            frame = context.sim.render(c2w)
            found = segmenter(frame.rgb, frame.depth, frame.semantics)
            errors.add(found, frame)
            if len(views) < _STORED:
                views.append(_view(context, c2w, frame, found))
            context.tick()
        precision, recall = object_precision_recall(errors.confusion)
        values = {**class_scores(errors.confusion), "precision": precision, "recall": recall}
        values = {name: values[name] for name in names}
        status = {name: "no object in the test images" for name, value in values.items() if value is None}
        artifact = {"errors": errors, "views": views, "confusion": errors.confusion}
        details = {"segmenter": name, "calibration_error": round(errors.calibration_error, 4)}
        return TaskResult(values, dict.fromkeys(names, len(poses)), status, artifact, details)

    def ticks(self, preset: "Preset") -> int:
        """One tick per test view."""
        return preset.test_poses


def _view(context: "EvaluationContext", c2w: np.ndarray, frame: "Frame", found: Segmentation) -> dict[str, Any]:
    fused = context.field.render(c2w, context.sim.intrinsics).semantics
    return {"rgb": frame.rgb, "predicted": found.labels, "field": fused, "truth": frame.semantics}
