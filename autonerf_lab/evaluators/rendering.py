"""Task 1, rendering (section 4.3): images from test poses that are not part of the trajectory.

Test poses are seeded, uniform over the navigable floor and over heading, and independent of the trajectory. The target
is the image of the simulator. Image metrics are averaged over the images; class metrics are computed from one
confusion matrix over all images.

* PSNR = -10 log10 MSE, sRGB values in [0, 1]. The MSE has a lower bound, the error of rounding to 8 bits (uniform,
  half a level), so that a perfect image has 58.9 dB instead of infinity.
* SSIM = mean over pixels and channels of (2 m_x m_y + C1) (2 s_xy + C2) / ((m_x**2 + m_y**2 + C1) (s_x**2 + s_y**2 +
  C2)), C1 = 0.01**2, C2 = 0.03**2, with means m, variances s**2 and covariance s_xy (of a population, not of a sample)
  under the Gaussian window of Wang et al. (2004), sigma 1.5.
* FLIP (Andersson et al. 2020) = mean over pixels of E_c**(1 - E_f), with the difference of the colours E_c, filtered
  by a model of the eye, and the difference of edges and points E_f, at 67 pixels per degree.
* LPIPS (:mod:`~autonerf_lab.evaluators.lpips`) needs weights that are not shipped. Without them it has no value and the
  status ``weights_missing``.
* Per-class accuracy = mean over classes of hits / target pixels; mIoU = mean over classes of hits / (target +
  predicted - hits). The classes are those in the target images, with the background (``miou_objects``: without).
* ``depth_median_error_m``: median over all pixels of ``|rendered - true|`` depth along the optical axis.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import flip_evaluator
import numpy as np
from skimage.metrics import structural_similarity

from autonerf_lab.classes import NUM_CLASSES
from autonerf_lab.data.dataset import Dataset
from autonerf_lab.errors import DataError
from autonerf_lab.evaluators.metrics import metrics_of
from autonerf_lab.evaluators.radiance_field import Renderer
from autonerf_lab.evaluators.task import Task, TaskFigure, TaskResult
from autonerf_lab.geometry import Intrinsics, planar_from_pose
from autonerf_lab.segmentation.metrics import class_scores, confusion_matrix

if TYPE_CHECKING:
    from autonerf_lab.evaluators.context import EvaluationContext
    from autonerf_lab.evaluators.lpips import Lpips
    from autonerf_lab.presets import Preset
    from autonerf_lab.simulator import Simulator

_ROUNDING_MSE = (0.5 / 255) ** 2 / 3
_PIXELS_PER_DEGREE = 67.020645  # default of FLIP: 0.7 m from a monitor that is 0.7 m and 3840 pixels wide
_STORED_IMAGES = 12  # for the figures


@dataclass(frozen=True)
class TargetView:
    """Test view: a pose and its target image."""

    c2w: np.ndarray  # (4, 4) camera-to-world
    intrinsics: Intrinsics
    rgb: np.ndarray  # (H, W, 3) uint8
    depth: np.ndarray | None  # (H, W) float32, along the optical axis, 0 = none
    semantics: np.ndarray | None  # (H, W) uint8, class index
    mask: np.ndarray | None = None  # (H, W) bool, True: the pixel is scored; None: all are


def simulated_views(sim: "Simulator", poses: np.ndarray) -> Iterator[TargetView]:
    """Yield the simulator's images from (N, 4, 4) poses."""
    for c2w in poses:
        frame = sim.render(c2w)
        yield TargetView(c2w, sim.intrinsics, frame.rgb, frame.depth, frame.semantics)


def photographed_views(data: Dataset) -> Iterator[TargetView]:
    """Yield the photographs of a dataset, each with its own camera."""
    for t, c2w in enumerate(data.poses):
        layers = (None if layer is None else layer[t] for layer in (data.depths, data.semantics, data.masks))
        yield TargetView(c2w, data.intrinsics[t], data.images[t], *layers)


def sample_test_poses(sim: "Simulator", count: int, seed: int = 0) -> np.ndarray:
    """Sample (count, 4, 4) camera-to-world poses, uniform over floor and heading.

    The first n poses are the same for every count.
    """
    rng = np.random.default_rng([seed, 1])
    return np.stack([sim.sample_pose(rng) for _ in range(count)])


def psnr(image: np.ndarray, target: np.ndarray) -> float:
    """Compute the peak signal-to-noise ratio of (H, W, 3) images in [0, 1], dB.

    Example:
        >>> round(psnr(np.full((2, 2, 3), 0.6), np.full((2, 2, 3), 0.5)), 6)
        20.0
        >>> round(psnr(np.zeros((2, 2, 3)), np.zeros((2, 2, 3))), 1)
        58.9
    """
    mse = float(np.mean((np.asarray(image, np.float64) - np.asarray(target, np.float64)) ** 2))
    return float(-10 * np.log10(max(mse, _ROUNDING_MSE)))


def ssim(image: np.ndarray, target: np.ndarray) -> float:
    """Compute the structural similarity of (H, W, 3) images in [0, 1] with sides of at least 11 pixels."""
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
    """Compute the mean FLIP error and the (H, W) error map of (H, W, 3) sRGB images in [0, 1]."""
    # Pass a new dictionary each time: the library writes into its default dictionary.
    error, mean, _ = flip_evaluator.evaluate(
        np.ascontiguousarray(target, np.float32),
        np.ascontiguousarray(np.clip(image, 0, 1), np.float32),
        "LDR",
        applyMagma=False,
        parameters={"ppd": _PIXELS_PER_DEGREE},
    )
    return float(mean), error[..., 0]


def evaluate_rendering(
    field: Renderer,
    views: Iterable[TargetView],
    tick: Callable[[], None] = lambda: None,
    lpips: "Lpips | None" = None,
) -> TaskResult:
    """Render test views and compare them with their targets.

    Args:
        field: radiance field or baseline.
        views: targets, see :func:`simulated_views` and :func:`photographed_views`.
        tick: called after each image.
        lpips: LPIPS with its weights; without, LPIPS has no value.

    Returns:
        Means over the views. The artifact holds the values of each view: ``psnr``, ``ssim``, ``flip``, and ``lpips``
        if it is computed (NaN: no value).
    """
    values: dict[str, list[float]] = {"psnr": [], "ssim": [], "flip": []}
    if lpips:
        values["lpips"] = []
    confusion = np.zeros((NUM_CLASSES, NUM_CLASSES), dtype=np.int64)
    depth_errors: list[np.ndarray] = [np.zeros(0, np.float32)]
    stored: list[dict[str, np.ndarray | None]] = []
    poses: list[np.ndarray] = []
    for target in views:
        image = field.render(target.c2w, target.intrinsics)
        true_rgb = target.rgb.astype(np.float32) / 255
        rgb = np.clip(np.nan_to_num(image.rgb), 0, 1).astype(np.float32)
        scored = np.ones(rgb.shape[:2], bool) if target.mask is None else target.mask
        if not scored.any():
            raise DataError(f"the mask of test view {len(poses)} excludes all pixels; hold out another one")
        values["psnr"].append(psnr(rgb, true_rgb) if scored.all() else psnr(rgb[scored], true_rgb[scored]))
        rgb[~scored] = true_rgb[~scored]  # SSIM, FLIP and LPIPS see no error where the image is masked
        values["ssim"].append(ssim(rgb, true_rgb) if min(rgb.shape[:2]) >= 11 else np.nan)
        mean_flip, flip_map = flip(rgb, true_rgb)
        values["flip"].append(mean_flip)
        if lpips:
            values["lpips"].append(lpips(rgb, true_rgb) if min(rgb.shape[:2]) >= lpips.min_side else np.nan)
        if image.semantics is not None and target.semantics is not None:
            confusion += confusion_matrix(image.semantics[scored], target.semantics[scored])
        if target.depth is not None:
            depth_errors.append(np.abs(image.depth - target.depth)[(target.depth > 0) & scored].astype(np.float32))
        if len(stored) < _STORED_IMAGES:
            stored.append(
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
        status["lpips"] = f"images under {lpips.min_side} pixels" if lpips else "weights_missing"
    if scores["ssim"] is None:
        status["ssim"] = "images under 11 pixels"
    if scores["miou_objects"] is None:
        status["miou_objects"] = "no object in the test images"
    if not confusion.any():
        status |= dict.fromkeys(("per_class_accuracy", "miou", "miou_objects"), "no labels")
    if scores["depth_median_error_m"] is None:
        status["depth_median_error_m"] = "no surface in the test images"
    n = dict.fromkeys(scores, len(poses))
    artifact = {"images": stored, "confusion": confusion, "poses": np.stack(poses), **per_view}
    return TaskResult(scores, n, status, artifact)


class RenderingTask(Task):
    """Task 1: rendering from test poses."""

    name, metrics, title = "rendering", metrics_of("rendering"), "Rendering"
    text = (
        "The field is rendered from test poses that are spread uniformly over the floor and are not part of the "
        "trajectory. Colours, classes and depth are compared with the images of the simulator."
    )
    figures = (
        TaskFigure(
            "comparison",
            "render_comparison",
            title="Ground truth and rendering",
            caption="One row per test pose, from the highest to the lowest PSNR. FLIP estimates the difference that a "
            "viewer perceives: 0 is no difference, 1 the largest.",
            alt="Grid of images, one row per test pose: true and rendered colours, FLIP error map, true and rendered "
            "classes",
        ),
        TaskFigure(
            "confusion",
            "confusion",
            title="Confusion matrix of the classes",
            caption="Each row shows how the pixels of one true class are distributed over the rendered classes, in "
            "percent. An empty row is a class that no test view shows.",
            alt="Confusion matrix of true and rendered classes",
        ),
        TaskFigure(
            "depth",
            "depth_errors",
            title="Depth error",
            caption="One row per test pose, from the smallest to the largest median error. In the right column, red "
            "means that the rendered surface is too near and blue that it is too far. The colour scale ends at 50 cm.",
            alt="Grid of images, one row per test pose: colour, true depth, rendered depth, and their signed "
            "difference in centimetres",
        ),
    )

    def run(self, context: "EvaluationContext") -> TaskResult:
        """Render the test poses and compare the images with those of the simulator."""
        poses = sample_test_poses(context.sim, context.preset.test_poses, context.seed)
        views = simulated_views(context.sim, poses)
        result = evaluate_rendering(context.field, views, context.tick, context.lpips)
        # The first of these poses are also those of pose refinement.
        return replace(result, details={"test_poses_x_y_heading": [planar_from_pose(c2w) for c2w in poses]})

    def ticks(self, preset: "Preset") -> int:
        """One tick per test pose."""
        return preset.test_poses
