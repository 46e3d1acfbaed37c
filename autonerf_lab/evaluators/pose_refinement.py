"""Task 4, pose refinement (section 4.3): estimate the pose of an image by gradient descent through the field.

The start pose is the true pose, rotated by 5 degrees about a seeded random axis through the camera centre and
translated by 5 cm in a seeded random direction. Each iteration renders random pixels of the target image, computes the
photometric error ``L = mean (c - c*)**2``, and descends its gradient (the formula in the paper has a plus sign):

    R <- R exp([omega]x),  t <- t + R v,  (omega, v) = - lr(i) Adam(dL/d omega, dL/d v)

The pixels can also be drawn from interest regions (:func:`interest_regions`).

With ``d = R d_cam`` and ``o = t`` the gradients of the pose follow from those of the rays: ``dL/d omega =
sum d_cam x (R^T dL/dd)`` and ``dL/dv = sum R^T dL/do``. All poses are refined together: the rays of one iteration are
one call of the field.

A pose has converged if its geodesic rotation error is below 3 degrees (``rotation_convergence_rate``) and its position
error is below 2 cm (``translation_convergence_rate``); ``convergence_rate`` counts both. The mean rotation and
translation errors are computed over the converged poses only.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import binary_dilation, gaussian_gradient_magnitude

from autonerf_lab.evaluators.metrics import metrics_of
from autonerf_lab.evaluators.radiance_field import RadianceField
from autonerf_lab.evaluators.rendering import sample_test_poses
from autonerf_lab.evaluators.task import Task, TaskFigure, TaskResult
from autonerf_lab.geometry import Intrinsics, rotation_angle, so3_exp

if TYPE_CHECKING:
    from autonerf_lab.evaluators.context import EvaluationContext
    from autonerf_lab.presets import Preset

START_ROTATION_DEG = 5.0
START_TRANSLATION_M = 0.05
CONVERGED_DEG = 3.0
CONVERGED_M = 0.02
_SHOWN = 3  # poses whose images are stored for the figure
_BETA1, _BETA2, _EPS = 0.9, 0.999, 1e-8


@dataclass(frozen=True)
class Refinement:
    """Settings of pose refinement. The learning rate decays exponentially from ``lr`` to ``lr_final``."""

    iterations: int = 200
    rays: int = 1024  # random pixels per pose and iteration
    lr: float = 0.01  # radians and metres: the size of the first steps of Adam
    lr_final: float = 3e-4
    interest: bool = False  # sample pixels from interest regions instead of the whole image


def perturb(c2w: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Rotate a (4, 4) pose by 5 degrees about a random axis and translate it by 5 cm in a random direction.

    Example:
        >>> start = perturb(np.eye(4), np.random.default_rng(0))
        >>> angle = np.degrees(rotation_angle(np.eye(4), start))
        >>> round(float(angle), 6), round(float(np.linalg.norm(start[:3, 3])), 6)
        (5.0, 0.05)
    """
    axis, direction = rng.normal(size=(2, 3))
    start = c2w.copy()
    start[:3, :3] = c2w[:3, :3] @ so3_exp(np.radians(START_ROTATION_DEG) * axis / np.linalg.norm(axis))
    start[:3, 3] += START_TRANSLATION_M * direction / np.linalg.norm(direction)
    return start


def interest_regions(image: np.ndarray) -> np.ndarray:
    """Find the regions of an image with most detail: the 10 % of pixels with the largest gradient, dilated by 2 pixels.

    The idea is that of the interest regions of iNeRF (Yen-Chen et al. 2021), which surround ORB features. In an image
    of one colour every pixel is selected.

    Args:
        image: (H, W, 3) uint8.

    Returns:
        (H, W) bool.

    Example:
        >>> edge = np.zeros((20, 20, 3), np.uint8)
        >>> edge[:, 10:] = 255
        >>> interest_regions(edge)[0].astype(int)
        array([0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0])
    """
    slope = gaussian_gradient_magnitude(image.mean(axis=2), 1)
    return binary_dilation(slope >= max(np.quantile(slope, 0.9), 1e-6), iterations=2) if slope.any() else slope == 0


def pose_gradients(directions: np.ndarray, rotations: np.ndarray, grad_o: np.ndarray, grad_d: np.ndarray) -> np.ndarray:
    """Compute the gradient of a sum over rays with respect to the local motion of each pose.

    Args:
        directions: (K, N, 3) rays in the camera frame.
        rotations: (K, 3, 3) camera-to-world.
        grad_o: (K, N, 3) gradient with respect to the ray origins, world frame.
        grad_d: (K, N, 3) gradient with respect to the ray directions, world frame.

    Returns:
        (K, 6) gradient at zero motion, in the camera frame: rotation vector, then translation.
    """
    rotation = np.cross(directions, grad_d @ rotations).sum(axis=1)
    return np.concatenate([rotation, (grad_o @ rotations).sum(axis=1)], axis=1)


def move(poses: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """Apply (K, 6) local motions to (K, 4, 4) poses: ``R exp([omega]x)`` and ``t + R v``."""
    moved = poses.copy()
    moved[:, :3, 3] += np.einsum("kij,kj->ki", poses[:, :3, :3], motion[:, 3:])
    moved[:, :3, :3] = poses[:, :3, :3] @ so3_exp(motion[:, :3])
    return moved


def refine(
    field: RadianceField,
    starts: np.ndarray,
    targets: np.ndarray,
    intrinsics: Intrinsics,
    settings: Refinement | None = None,
    seed: int = 0,
    tick: Callable[[], None] = lambda: None,
) -> tuple[np.ndarray, np.ndarray]:
    """Refine K poses together.

    Args:
        field: only ``ray_gradients`` is used.
        starts: (K, 4, 4) camera-to-world start poses.
        targets: (K, H, W, 3) uint8 target images.
        intrinsics: of the targets.
        settings: of the optimisation.
        seed: random seed of the pixels.
        tick: called after each iteration.

    Returns:
        (iterations + 1, K, 4, 4) poses, beginning with the start poses, and (iterations, K) losses. In an iteration in
        which the gradient of a pose is not finite, this pose does not move.
    """
    settings = settings or Refinement()
    rng = np.random.default_rng([seed, 41])
    count, pixels = len(starts), intrinsics.width * intrinsics.height
    directions = intrinsics.directions().reshape(-1, 3)
    regions = [np.flatnonzero(interest_regions(image)) for image in targets] if settings.interest else None
    colors = targets.reshape(count, pixels, 3)
    poses, trace, losses = starts.astype(np.float64), [starts], []
    first, second = np.zeros((count, 6)), np.zeros((count, 6))
    for i in range(settings.iterations):
        if regions is None:
            pick = rng.integers(pixels, size=(count, settings.rays))
        else:
            pick = np.stack([rng.choice(region, settings.rays) for region in regions])
        local = directions[pick]
        rays_d = local @ poses[:, :3, :3].transpose(0, 2, 1)
        rays_o = np.broadcast_to(poses[:, None, :3, 3], rays_d.shape)
        wanted = np.take_along_axis(colors, pick[..., None], axis=1) / np.float32(255)
        loss, grad_o, grad_d = field.ray_gradients(
            *(np.ascontiguousarray(a.reshape(-1, 3), np.float32) for a in (rays_o, rays_d, wanted))
        )
        shape = (count, settings.rays, 3)
        grad_o, grad_d = (a.astype(np.float64).reshape(shape) for a in (grad_o, grad_d))
        with np.errstate(invalid="ignore"):  # infinite gradients
            gradient = pose_gradients(local, poses[:, :3, :3], grad_o, grad_d)
        broken = ~np.isfinite(gradient).all(axis=1)
        gradient[broken] = 0
        gradient /= settings.rays
        first = _BETA1 * first + (1 - _BETA1) * gradient
        second = _BETA2 * second + (1 - _BETA2) * gradient**2
        lr = settings.lr * (settings.lr_final / settings.lr) ** (i / max(1, settings.iterations - 1))
        step = (first / (1 - _BETA1 ** (i + 1))) / (np.sqrt(second / (1 - _BETA2 ** (i + 1))) + _EPS)
        step[broken] = 0  # the moments of Adam alone would still move the pose
        poses = move(poses, -lr * step)
        trace.append(poses)
        losses.append(loss.reshape(count, -1).mean(axis=1))
        tick()
    return np.stack(trace), np.array(losses).reshape(settings.iterations, count)


def pose_errors(poses: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute (K,) geodesic rotation errors in degrees and (K,) position errors in metres of (K, 4, 4) poses."""
    return np.degrees(rotation_angle(poses, truth)), np.linalg.norm(poses[:, :3, 3] - truth[:, :3, 3], axis=1)


def refinement_scores(rotation: np.ndarray, translation: np.ndarray) -> dict[str, float | None]:
    """Compute the five scores from the final errors.

    Args:
        rotation: (K,) degrees.
        translation: (K,) metres.

    Returns:
        The scores by name. The two mean errors are None if no pose converged.

    Example:
        >>> refinement_scores(np.array([0.2, 1.0, 4.0]), np.array([0.01, 0.03, 0.01]))["convergence_rate"]
        33.33333333333333
    """
    rotation_ok, translation_ok = rotation < CONVERGED_DEG, translation < CONVERGED_M
    both = rotation_ok & translation_ok
    return {
        "convergence_rate": float(100 * both.mean()),
        "rotation_convergence_rate": float(100 * rotation_ok.mean()),
        "translation_convergence_rate": float(100 * translation_ok.mean()),
        "rotation_error_deg": float(rotation[both].mean()) if both.any() else None,
        "translation_error_m": float(translation[both].mean()) if both.any() else None,
    }


def refinement_result(rotation: np.ndarray, translation: np.ndarray) -> TaskResult:
    """Return :func:`refinement_scores` with the number of poses behind each score."""
    values = refinement_scores(rotation, translation)
    converged = int(np.sum((rotation < CONVERGED_DEG) & (translation < CONVERGED_M)))
    n = dict.fromkeys(values, len(rotation)) | {"rotation_error_deg": converged, "translation_error_m": converged}
    return TaskResult(values, n, {name: "none converged" for name, value in values.items() if value is None})


def evaluate_pose_refinement(
    field: RadianceField,
    truth: np.ndarray,
    targets: np.ndarray,
    intrinsics: Intrinsics,
    settings: Refinement | None = None,
    seed: int = 0,
    tick: Callable[[], None] = lambda: None,
) -> TaskResult:
    """Perturb and refine poses, and compare them with the true ones.

    Args:
        field: its methods ``ray_gradients`` and ``render`` are used.
        truth: (K, 4, 4) true camera-to-world poses.
        targets: (K, H, W, 3) uint8 images from these poses.
        intrinsics: of the targets.
        settings: of the optimisation.
        seed: random seed of the start poses and the pixels.
        tick: called after each iteration.
    """
    rng = np.random.default_rng([seed, 4])
    starts = np.stack([perturb(c2w, rng) for c2w in truth])
    trace, losses = refine(field, starts, targets, intrinsics, settings, seed, tick)
    rotation, translation = pose_errors(trace[-1], truth)
    stored = np.unique(np.linspace(0, len(trace) - 1, 101).round().astype(int))
    artifact = {
        "iterations": stored,
        "trace": trace[stored],
        "losses": losses,
        "truth": truth,
        "targets": targets[:_SHOWN],
        "before": [np.asarray(field.render(c2w, intrinsics).rgb) for c2w in starts[:_SHOWN]],
        "after": [np.asarray(field.render(c2w, intrinsics).rgb) for c2w in trace[-1][:_SHOWN]],
        "rotation_error_deg": rotation,
        "translation_error_m": translation,
    }
    return replace(refinement_result(rotation, translation), artifact=artifact)


class PoseRefinementTask(Task):
    """Task 4: pose refinement."""

    name, metrics, title = "pose_refinement", metrics_of("pose_refinement"), "Pose refinement"
    text = (
        "A camera pose is disturbed by 5° and 5 cm. Gradient descent through the field then moves it so that the "
        "rendering matches the target image. A pose has converged if its final error is below 3° and 2 cm."
    )
    figures = (
        TaskFigure(
            "animation",
            "refinement_frames",
            title="Refinement of one pose",
            caption="The rendering moves towards the target image while its pose is corrected. The dotted lines are "
            "the convergence thresholds, 3° and 2 cm.",
            alt="Animation: target image, rendering and their difference, beside the curves of the two pose errors",
            inputs=("field", "artifact"),
        ),
        TaskFigure(
            "traces",
            "refinement_trace",
            title="Errors of all poses",
            caption="Left: one line per pose. Right: target, rendering and difference for up to three poses, before "
            "and after the refinement.",
            alt="Rotation and position errors of all poses over the iterations, and images before and after refinement",
        ),
    )

    def run(self, context: "EvaluationContext") -> TaskResult:
        """Refine disturbed test poses with the settings of the preset."""
        preset = context.preset
        poses = sample_test_poses(context.sim, preset.refine_poses, context.seed)
        targets = np.stack([context.sim.render(c2w).rgb for c2w in poses])
        settings = Refinement(preset.refine_iterations, preset.refine_rays, interest=preset.refine_interest)
        return evaluate_pose_refinement(
            context.field, poses, targets, context.sim.intrinsics, settings, context.seed, context.tick
        )

    def ticks(self, preset: "Preset") -> int:
        """One tick per iteration."""
        return preset.refine_iterations
