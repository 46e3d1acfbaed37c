"""Task 4, pose refinement (section 4.3): move a camera until the field shows what the camera saw.

The start is the true camera turned by 5 degrees about a seeded random axis and moved 5 cm in a seeded random direction,
about the camera itself. Each iteration compares random pixels of the simulator's image with the field,
``L = mean (c - c*)**2``, and descends its gradient (the paper's formula prints a plus):

    R <- R exp([omega]x),  t <- t + R v,  (omega, v) = - lr(i) Adam(dL/d omega, dL/d v)

Or the pixels come from interest regions (:func:`interest_regions`), where an image tells most about where it was taken.

With ``d = R d_cam`` and ``o = t`` the chain from rays to camera is ``dL/d omega = sum d_cam x (R^T dL/dd)`` and
``dL/dv = sum R^T dL/do``. All cameras move together: their rays of one iteration are one call of the field.

Converged: geodesic rotation error under 3 degrees (``rotation_convergence_rate``), position error under 2 cm
(``translation_convergence_rate``), both (``convergence_rate``). The two mean errors are those of the converged cameras.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import binary_dilation, gaussian_gradient_magnitude

from autonerf_lab.evaluators.radiance_field import Field
from autonerf_lab.evaluators.task_result import TaskResult
from autonerf_lab.geometry import Intrinsics, rotation_angle, so3_exp

START_ROTATION_DEG = 5.0
START_TRANSLATION_M = 0.05
CONVERGED_DEG = 3.0
CONVERGED_M = 0.02
_SHOWN = 3  # cameras whose images are kept for the picture
_BETA1, _BETA2, _EPS = 0.9, 0.999, 1e-8


@dataclass(frozen=True)
class Refinement:
    """Settings of the descent. The learning rate falls geometrically from ``lr`` to ``lr_final``."""

    iterations: int = 200
    rays: int = 1024  # random pixels of each camera and iteration
    lr: float = 0.01  # radians and metres: Adam's first steps have this size
    lr_final: float = 3e-4
    interest: bool = False  # draw pixels from interest regions, not from the whole image


def perturb(c2w: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(4, 4) pose turned by 5 degrees and moved by 5 cm, about the camera itself.

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
    """Where an image has most detail: the tenth of its pixels with the steepest colours, and two pixels around them.

    After the interest regions of iNeRF (Yen-Chen et al. 2021), which surround its ORB features. An image of one colour
    is all of one interest.

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
    """Gradient of a sum over rays for the local motion of each camera.

    Args:
        directions: (K, N, 3) rays in the camera frame.
        rotations: (K, 3, 3) camera-to-world.
        grad_o: (K, N, 3) gradient for the world origins of the rays.
        grad_d: (K, N, 3) gradient for their world directions.

    Returns:
        (K, 6): rotation vector, then translation, both in the camera frame, at zero motion.
    """
    rotation = np.cross(directions, grad_d @ rotations).sum(axis=1)
    return np.concatenate([rotation, (grad_o @ rotations).sum(axis=1)], axis=1)


def move(poses: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """(K, 4, 4) poses moved by (K, 6) local motions: ``R exp([omega]x)`` and ``t + R v``."""
    moved = poses.copy()
    moved[:, :3, 3] += np.einsum("kij,kj->ki", poses[:, :3, :3], motion[:, 3:])
    moved[:, :3, :3] = poses[:, :3, :3] @ np.stack([so3_exp(omega) for omega in motion[:, :3]])
    return moved


def refine(
    field: Field,
    starts: np.ndarray,
    targets: np.ndarray,
    intrinsics: Intrinsics,
    settings: Refinement | None = None,
    seed: int = 0,
    tick: Callable[[], None] = lambda: None,
) -> tuple[np.ndarray, np.ndarray]:
    """Refine K cameras at once.

    Args:
        field: only ``ray_gradients`` is used.
        starts: (K, 4, 4) camera-to-world.
        targets: (K, H, W, 3) uint8, what each camera saw.
        intrinsics: of the targets.
        settings: of the descent.
        seed: of the random pixels.
        tick: called after each iteration.

    Returns:
        (iterations + 1, K, 4, 4) poses, the start first, and (iterations, K) losses. A camera whose gradient is not
        finite stays where it is in that iteration.
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
        gradient = pose_gradients(
            local, poses[:, :3, :3], grad_o.astype(np.float64).reshape(shape), grad_d.astype(np.float64).reshape(shape)
        )
        broken = ~np.isfinite(gradient).all(axis=1)
        gradient[broken] = 0
        gradient /= settings.rays
        first = _BETA1 * first + (1 - _BETA1) * gradient
        second = _BETA2 * second + (1 - _BETA2) * gradient**2
        lr = settings.lr * (settings.lr_final / settings.lr) ** (i / max(1, settings.iterations - 1))
        step = (first / (1 - _BETA1 ** (i + 1))) / (np.sqrt(second / (1 - _BETA2 ** (i + 1))) + _EPS)
        step[broken] = 0  # Adam would move it on by what it remembers
        poses = move(poses, -lr * step)
        trace.append(poses)
        losses.append(loss.reshape(count, -1).mean(axis=1))
        tick()
    return np.stack(trace), np.array(losses).reshape(settings.iterations, count)


def pose_errors(poses: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(K,) geodesic rotation errors in degrees and (K,) position errors in metres."""
    rotation = np.array([np.degrees(rotation_angle(a, b)) for a, b in zip(poses, truth, strict=True)])
    return rotation, np.linalg.norm(poses[:, :3, 3] - truth[:, :3, 3], axis=1)


def refinement_scores(rotation: np.ndarray, translation: np.ndarray) -> dict[str, float | None]:
    """The five scores from the final errors (degrees, metres); the means are None when no camera converged.

    Example:
        >>> refinement_scores(np.array([0.2, 1.0, 4.0]), np.array([0.01, 0.03, 0.01]))["convergence_rate"]
        33.33333333333333
    """
    turned, moved = rotation < CONVERGED_DEG, translation < CONVERGED_M
    both = turned & moved
    return {
        "convergence_rate": float(100 * both.mean()),
        "rotation_convergence_rate": float(100 * turned.mean()),
        "translation_convergence_rate": float(100 * moved.mean()),
        "rotation_error_deg": float(rotation[both].mean()) if both.any() else None,
        "translation_error_m": float(translation[both].mean()) if both.any() else None,
    }


def refinement_result(rotation: np.ndarray, translation: np.ndarray) -> TaskResult:
    """:func:`refinement_scores` with what they are means of."""
    values = refinement_scores(rotation, translation)
    converged = int(np.sum((rotation < CONVERGED_DEG) & (translation < CONVERGED_M)))
    n = dict.fromkeys(values, len(rotation)) | {"rotation_error_deg": converged, "translation_error_m": converged}
    return TaskResult(values, n, {name: "none converged" for name, value in values.items() if value is None})


def evaluate_pose_refinement(
    field: Field,
    truth: np.ndarray,
    targets: np.ndarray,
    intrinsics: Intrinsics,
    settings: Refinement | None = None,
    seed: int = 0,
    tick: Callable[[], None] = lambda: None,
) -> TaskResult:
    """Perturb, refine and judge (K, 4, 4) cameras that saw ``targets`` (K, H, W, 3) uint8."""
    rng = np.random.default_rng([seed, 4])
    starts = np.stack([perturb(c2w, rng) for c2w in truth])
    trace, losses = refine(field, starts, targets, intrinsics, settings, seed, tick)
    rotation, translation = pose_errors(trace[-1], truth)
    kept = np.unique(np.linspace(0, len(trace) - 1, 101).round().astype(int))
    artifact = {
        "iterations": kept,
        "trace": trace[kept],
        "losses": losses,
        "truth": truth,
        "targets": targets[:_SHOWN],
        "before": [np.asarray(field.render(c2w, intrinsics).rgb) for c2w in starts[:_SHOWN]],
        "after": [np.asarray(field.render(c2w, intrinsics).rgb) for c2w in trace[-1][:_SHOWN]],
        "rotation_error_deg": rotation,
        "translation_error_m": translation,
    }
    return replace(refinement_result(rotation, translation), artifact=artifact)
