"""Task 1, rendering (section 4.3): images from poses that the walk never chose.

Test poses are uniform over the navigable floor and over heading, seeded, and independent of every walk. The target is
the simulator's image. Averages are over images; classes are judged on one confusion matrix over all images.

* PSNR = -10 log10 MSE, sRGB values in [0, 1]. The error of an image is taken as at least that of rounding to 8 bits
  (a uniform error of half a level), so that a perfect image scores 58.9 dB and not infinity.
* SSIM = mean over pixels and channels of (2 m_x m_y + C1) (2 s_xy + C2) / ((m_x**2 + m_y**2 + C1) (s_x**2 + s_y**2 +
  C2)), C1 = 0.01**2, C2 = 0.03**2, with means m, variances s**2 and covariance s_xy (of a population, not of a sample)
  under the Gaussian window of Wang et al. (2004), sigma 1.5.
* FLIP (Andersson et al. 2020) = mean over pixels of E_c**(1 - E_f): E_c the distance of the two colours, filtered as
  the eye does, E_f that of edges and points; for a viewer at 67 pixels per degree.
* LPIPS (:mod:`~autonerf_lab.evaluators.lpips`) needs weights that are not shipped: null without, ``weights_missing``.
* Per-class accuracy = mean over classes of hits / target pixels; mIoU = mean over classes of hits / (target +
  predicted - hits). Classes are those present in the target images, background included (``miou_objects``: without it).
* ``depth_median_error_m``: median over all pixels of |rendered - true| depth along the axis.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import flip_evaluator
import numpy as np
from skimage.metrics import structural_similarity

from autonerf_lab.classes import NUM_CLASSES
from autonerf_lab.data.dataset import Dataset
from autonerf_lab.evaluators.lpips import MIN_SIDE, Lpips
from autonerf_lab.evaluators.radiance_field import Field
from autonerf_lab.evaluators.task_result import TaskResult
from autonerf_lab.geometry import Intrinsics

if TYPE_CHECKING:
    from autonerf_lab.simulator import Simulator

_ROUNDING_MSE = (0.5 / 255) ** 2 / 3
_PIXELS_PER_DEGREE = 67.020645  # FLIP's default viewer: 0.7 m from a 0.7 m wide, 3840 pixel monitor
_KEPT_IMAGES = 12


@dataclass(frozen=True)
class View:
    """What a camera should show."""

    c2w: np.ndarray  # (4, 4) camera-to-world
    intrinsics: Intrinsics
    rgb: np.ndarray  # (H, W, 3) uint8
    depth: np.ndarray | None  # (H, W) float32, along the optical axis, 0 = none
    semantics: np.ndarray | None  # (H, W) uint8, class index


def simulated_views(sim: "Simulator", poses: np.ndarray) -> Iterator[View]:
    """The simulator's images from (N, 4, 4) poses, one at a time."""
    for c2w in poses:
        frame = sim.render(c2w)
        yield View(c2w, sim.intrinsics, frame.rgb, frame.depth, frame.semantics)


def photographed_views(data: Dataset) -> Iterator[View]:
    """The photographs, through their own cameras."""
    for t, c2w in enumerate(data.poses):
        depth, semantics = (None if layer is None else layer[t] for layer in (data.depths, data.semantics))
        yield View(c2w, data.cameras[t], data.images[t], depth, semantics)


def sample_test_poses(sim: "Simulator", count: int, seed: int = 0) -> np.ndarray:
    """(count, 4, 4) camera-to-world, uniform over floor and heading; the first n are the same for any count."""
    rng = np.random.default_rng([seed, 1])
    return np.stack([sim.sample_pose(rng) for _ in range(count)])


def psnr(image: np.ndarray, target: np.ndarray) -> float:
    """Peak signal-to-noise ratio in dB of (H, W, 3) images in [0, 1].

    Example:
        >>> round(psnr(np.full((2, 2, 3), 0.6), np.full((2, 2, 3), 0.5)), 6)
        20.0
        >>> round(psnr(np.zeros((2, 2, 3)), np.zeros((2, 2, 3))), 1)
        58.9
    """
    mse = float(np.mean((np.asarray(image, np.float64) - np.asarray(target, np.float64)) ** 2))
    return float(-10 * np.log10(max(mse, _ROUNDING_MSE)))


def ssim(image: np.ndarray, target: np.ndarray) -> float:
    """Structural similarity of (H, W, 3) images in [0, 1], at least 11 pixels a side."""
    return float(
        structural_similarity(
            np.asarray(image, np.float32),
            np.asarray(target, np.float32),
            channel_axis=-1,
            gaussian_weights=True,
            sigma=1.5,
            use_sample_covariance=False,
            data_range=1.0,
        )
    )


def flip(image: np.ndarray, target: np.ndarray) -> tuple[float, np.ndarray]:
    """Mean FLIP error and (H, W) error map of (H, W, 3) sRGB images in [0, 1] (Andersson et al., 2020)."""
    # The parameters are passed anew each time: the library writes into its own default dictionary
    error, mean, _ = flip_evaluator.evaluate(
        np.ascontiguousarray(target, np.float32),
        np.ascontiguousarray(np.clip(image, 0, 1), np.float32),
        "LDR",
        applyMagma=False,
        parameters={"ppd": _PIXELS_PER_DEGREE},
    )
    return float(mean), error[..., 0]


def confusion_matrix(predicted: np.ndarray, target: np.ndarray) -> np.ndarray:
    """(16, 16) int64 pixel counts, row = true class, column = predicted class.

    Example:
        >>> confusion_matrix(np.array([1, 1]), np.array([1, 0]))[:2, :2]
        array([[0, 1],
               [0, 1]])
    """
    pairs = np.asarray(target).astype(np.int64).ravel() * NUM_CLASSES + np.asarray(predicted).ravel()
    return np.bincount(pairs, minlength=NUM_CLASSES**2).reshape(NUM_CLASSES, NUM_CLASSES)


def class_scores(confusion: np.ndarray) -> dict[str, float | None]:
    """Per-class accuracy and mean IoU in percent, over the classes that the targets hold.

    Example:
        >>> c = np.zeros((16, 16), int); c[0, 0] = 6; c[0, 1] = 2; c[1, 1] = 2
        >>> scores = class_scores(c)
        >>> scores["per_class_accuracy"], scores["miou"], scores["miou_objects"]
        (87.5, 62.5, 50.0)
    """
    hits, target, predicted = np.diag(confusion), confusion.sum(axis=1), confusion.sum(axis=0)
    present = target > 0
    accuracy = hits[present] / target[present]
    iou = hits[present] / (target + predicted - hits)[present]
    objects = iou[1:] if present[0] else iou
    return {
        "per_class_accuracy": float(100 * accuracy.mean()) if len(accuracy) else None,
        "miou": float(100 * iou.mean()) if len(iou) else None,
        "miou_objects": float(100 * objects.mean()) if len(objects) else None,
    }


def evaluate_rendering(
    field: Field, views: Iterable[View], tick: Callable[[], None] = lambda: None, lpips: Lpips | None = None
) -> TaskResult:
    """Score what a field shows from each of some cameras against what it should show.

    Args:
        field: only ``render`` is used.
        views: the targets, see :func:`simulated_views` and :func:`photographed_views`.
        tick: called after each image.
        lpips: with its weights.

    Returns:
        Means over the views; those of each view are in the artifact (``psnr``, ``ssim``, ``flip``, and ``lpips`` with
        its weights; NaN: none).
    """
    values: dict[str, list[float]] = {"psnr": [], "ssim": [], "flip": []}
    if lpips:
        values["lpips"] = []
    confusion = np.zeros((NUM_CLASSES, NUM_CLASSES), dtype=np.int64)
    depth_errors: list[np.ndarray] = [np.zeros(0, np.float32)]
    kept: list[dict[str, np.ndarray | None]] = []
    poses = []
    for target in views:
        image = field.render(target.c2w, target.intrinsics)
        true_rgb = target.rgb.astype(np.float32) / 255
        rgb = np.clip(np.nan_to_num(image.rgb), 0, 1).astype(np.float32)
        values["psnr"].append(psnr(rgb, true_rgb))
        values["ssim"].append(ssim(rgb, true_rgb) if min(rgb.shape[:2]) >= 11 else np.nan)
        mean_flip, flip_map = flip(rgb, true_rgb)
        values["flip"].append(mean_flip)
        if lpips:
            values["lpips"].append(lpips(rgb, true_rgb) if min(rgb.shape[:2]) >= MIN_SIDE else np.nan)
        if image.semantics is not None and target.semantics is not None:
            confusion += confusion_matrix(image.semantics, target.semantics)
        if target.depth is not None:
            depth_errors.append(np.abs(image.depth - target.depth)[target.depth > 0].astype(np.float32))
        if len(kept) < _KEPT_IMAGES:
            kept.append(
                {
                    "c2w": target.c2w,
                    "true_rgb": target.rgb,
                    "rgb": np.round(rgb * 255).astype(np.uint8),
                    "true_depth": target.depth,
                    "depth": np.asarray(image.depth, np.float32),
                    "true_semantics": target.semantics,
                    "semantics": None if image.semantics is None else np.asarray(image.semantics, np.uint8),
                    "flip": flip_map,
                }
            )
        poses.append(target.c2w)
        tick()
    errors = np.concatenate(depth_errors)
    per_view = {name: np.array(v) for name, v in values.items()}
    scores: dict[str, float | None] = {
        name: float(np.nanmean(v)) if np.isfinite(v).any() else None for name, v in per_view.items()
    }
    scores = {"lpips": None, **scores, **class_scores(confusion)}
    scores["depth_median_error_m"] = float(np.median(errors)) if len(errors) else None
    status = {}
    if scores["lpips"] is None:
        status["lpips"] = f"images under {MIN_SIDE} pixels" if lpips else "weights_missing"
    if scores["ssim"] is None:
        status["ssim"] = "images under 11 pixels"
    if scores["miou_objects"] is None:
        status["miou_objects"] = "no object in the test images"
    if not confusion.any():
        status |= dict.fromkeys(("per_class_accuracy", "miou", "miou_objects"), "no labels")
    if scores["depth_median_error_m"] is None:
        status["depth_median_error_m"] = "no surface in the test images"
    n = dict.fromkeys(scores, len(poses))
    artifact = {"images": kept, "confusion": confusion, "poses": np.stack(poses), **per_view}
    return TaskResult(scores, n, status, artifact)
