"""Training: a walk goes in, a field comes out (section 3.3: RGB, semantics and poses, no depth)."""

import hashlib
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from tqdm.auto import tqdm

from autonerf_lab import config
from autonerf_lab.errors import DataError, TrainingError, UnknownNameError
from autonerf_lab.nerf.checkpoint import TrainingState
from autonerf_lab.nerf.field import NeRF
from autonerf_lab.nerf.nerfacto import MATRICES, NO_LABEL, SemanticNerfacto
from autonerf_lab.nerf.optimizer import Adam
from autonerf_lab.nerf.scene_box import SceneBox
from autonerf_lab.nerf.settings import NerfactoSettings, settings_for
from autonerf_lab.nerf.visibility import Visibility, carve
from autonerf_lab.trajectory import Trajectory

MODELS = {"semantic-nerfacto": SemanticNerfacto}
SMALL = MATRICES  # gradients that are looked at every step: whatever breaks passes through them
SEEN_RAYS = 400_000  # rays that carve the visibility grid, at most one for each training pixel


class Pixels:
    """The training pixels of a trajectory, drawn at random."""

    def __init__(self, trajectory: Trajectory) -> None:
        directions = trajectory.intrinsics.directions().reshape(-1, 3)
        self.directions = (directions / np.linalg.norm(directions, axis=1, keepdims=True)).astype(np.float32)
        self.poses = trajectory.poses.astype(np.float32)
        self.rgb = trajectory.rgb.reshape(len(trajectory.poses), -1, 3)
        self.labels = None
        if trajectory.semantics is not None:
            self.labels = trajectory.semantics.reshape(len(trajectory.poses), -1)

    def rays(self, frames: np.ndarray, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Origins and unit directions (R, 3) float32, world frame, of pixels in frames."""
        poses = self.poses[frames]
        directions = np.einsum("rij,rj->ri", poses[:, :3, :3], self.directions[pixels])
        return np.ascontiguousarray(poses[:, :3, 3]), directions

    def draw(self, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Uniform over frames and pixels."""
        return rng.integers(len(self.poses), size=count), rng.integers(len(self.directions), size=count)

    def batch(self, frames: np.ndarray, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Colours (R, 3) float32 in [0, 1] and labels (R,) int64."""
        colors = self.rgb[frames, pixels].astype(np.float32) / np.float32(255)
        if self.labels is None:
            return colors, np.full(len(frames), NO_LABEL)
        return colors, self.labels[frames, pixels].astype(np.int64)


def learning_rate(share: float, settings: NerfactoSettings) -> float:
    """Linear warm-up, then exponential decay from the first to the final rate.

    Args:
        share: of the training that is done, 0 to 1.
        settings: holds the rates.
    """
    warmup = min(share / settings.warmup, 1.0) if settings.warmup else 1.0
    return settings.learning_rate * warmup * (settings.final_learning_rate / settings.learning_rate) ** share


def fit(
    trajectory: Trajectory,
    model: str = "semantic-nerfacto",
    preset: str | config.Preset | None = None,
    *,
    seed: int = 0,
    steps: int | None = None,
    seconds: float | None = None,
    settings: NerfactoSettings | None = None,
    checkpoint: str | Path | None = None,
    progress: bool = True,
    callback: Callable[[int, SemanticNerfacto], None] | None = None,
) -> NeRF:
    """Train a field on a walk.

    Args:
        trajectory: RGB, poses and, where there are any, semantics; depth is not looked at.
        model: a name in ``MODELS``.
        preset: decides the hyper-parameters and the number of steps.
        seed: of everything random; same seed, same bits.
        steps: instead of the preset's.
        seconds: train for this long instead (for benchmarks and live lessons; not reproducible to the bit).
        settings: hyper-parameters instead of the preset's.
        checkpoint: folder that keeps the state of the training, to go on from after an interruption.
        progress: show a bar with the running PSNR.
        callback: called with the number of steps done and the model, after each step.

    Raises:
        UnknownNameError: no such model or preset.
        DataError: nothing to learn from.
        TrainingError: a loss is not finite.
    """
    if model not in MODELS:
        raise UnknownNameError("model", model, MODELS)
    chosen = config.preset(preset)
    settings = settings or settings_for(chosen)
    settings = replace(settings, steps=steps) if steps is not None else settings
    if len(trajectory.poses) < 2 or np.ptp(trajectory.poses, axis=0).max() < 1e-6:
        raise DataError("cannot learn a scene from one view: the trajectory needs at least two different poses")
    rng = np.random.default_rng(seed)
    box = SceneBox.around(trajectory.poses[:, :3, 3], settings.margin, settings.shell)
    field = MODELS[model](settings, box, len(trajectory.poses), rng)
    state = TrainingState(field, Adam(field.parameters), rng)
    if checkpoint is not None:
        state.resume(checkpoint, {"seed": seed, "model": model, "views": _fingerprint(trajectory)})
    pixels = Pixels(trajectory)
    started = time.perf_counter() - state.seconds
    with tqdm(total=settings.steps, initial=state.step, disable=not progress, desc="fit", unit="step") as bar:
        while True:
            state.seconds = time.perf_counter() - started
            share = state.step / settings.steps if seconds is None else state.seconds / seconds
            if share >= 1:
                break
            _step(state, pixels, learning_rate(share, settings))
            bar.update()
            if state.step % 20 == 0:
                bar.set_postfix_str(f"PSNR {state.psnr:.1f} dB")
            if checkpoint is not None:
                state.save_now_and_then(checkpoint)
            if callback is not None:
                callback(state.step, field)
    meta: dict[str, Any] = {key: trajectory.meta.get(key) for key in ("scene", "scene_sha256", "policy", "start")}
    meta |= {"model": model, "preset": chosen.name, "seed": seed, "steps": state.step}
    meta |= {"train_psnr": state.psnr, "seconds": state.seconds}
    return NeRF(field, trajectory.poses, trajectory.intrinsics, _visibility(field, pixels, seed), meta)


def _fingerprint(trajectory: Trajectory) -> str:
    """Tells the views of one walk from those of another."""
    return hashlib.sha256(trajectory.poses.tobytes() + trajectory.rgb.tobytes()).hexdigest()


def _step(state: TrainingState, pixels: Pixels, rate: float) -> None:
    """One batch; a loss that is not finite stops everything before it reaches the parameters."""
    settings = state.model.settings
    frames, indices = pixels.draw(settings.rays, state.rng)
    target, labels = pixels.batch(frames, indices)
    learn_proposals = state.step % settings.proposal_every == 0
    gradients, losses = state.model.train_step(
        pixels.rays(frames, indices), target, labels, frames, state.rng, learn_proposals
    )
    broken = [name for name, value in losses.items() if not np.isfinite(value)]
    broken += [name for name in SMALL if not np.isfinite(gradients[name]).all()]
    if broken:
        raise TrainingError(
            f"{', '.join(broken)} not finite at step {state.step}: training stopped, the last checkpoint is intact; "
            "check the images and poses, or lower learning_rate"
        )
    rates = {name: rate * (settings.table_rate if name.endswith("table") else 1.0) for name in gradients}
    state.optimizer.step(gradients, rates)
    state.losses = losses
    decibel = float(-10 * np.log10(max(losses["mse"], 1e-10)))
    state.psnr = decibel if state.step == 0 else 0.98 * state.psnr + 0.02 * decibel
    state.step += 1


def _visibility(model: SemanticNerfacto, pixels: Pixels, seed: int) -> Visibility:
    """Carve what the cameras saw, by the depth that the field itself renders for a sample of the training rays."""
    count = min(SEEN_RAYS, pixels.rgb.shape[0] * pixels.rgb.shape[1])
    rays_o, rays_d = pixels.rays(*pixels.draw(count, np.random.default_rng(seed)))
    _, _, depth, _ = model.render_rays(rays_o, rays_d)
    return carve(rays_o, rays_d, depth)
