"""Training: a walk or photographs go in, a field comes out (section 4.2: RGB, semantics and poses, no depth)."""

import hashlib
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tqdm.auto import tqdm

from autonerf_lab import config
from autonerf_lab.classes import NUM_CLASSES
from autonerf_lab.data.dataset import Dataset
from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.errors import DataError, TrainingError
from autonerf_lab.nerf.checkpoint import TrainingState
from autonerf_lab.nerf.frame import SPREAD, FieldFrame, inliers
from autonerf_lab.nerf.model import Model, ModelSpec
from autonerf_lab.nerf.models import model_spec
from autonerf_lab.nerf.optimizer import Adam
from autonerf_lab.nerf.pixel_sampler import Pixels
from autonerf_lab.nerf.radiance_field import NeRF
from autonerf_lab.nerf.ray_batch import Array
from autonerf_lab.nerf.scene_box import SceneBox
from autonerf_lab.nerf.settings import Settings
from autonerf_lab.nerf.visibility import VOXEL, Visibility, carve

SEEN_REACH = 8.0  # how far photographs see, in the field's units
FAR_AWAY = 1000.0  # where their rays end


def learning_rate(share: float, settings: Settings) -> float:
    """Linear warm-up, then exponential decay from the first to the final rate.

    Args:
        share: of the training that is done, 0 to 1.
        settings: holds the rates.
    """
    warmup = min(share / settings.warmup, 1.0) if settings.warmup else 1.0
    return settings.learning_rate * warmup * (settings.final_learning_rate / settings.learning_rate) ** share


def fit(
    data: Trajectory | Dataset,
    model: str | ModelSpec = "semantic-nerfacto",
    preset: str | config.Preset | None = None,
    *,
    seed: int = 0,
    steps: int | None = None,
    seconds: float | None = None,
    settings: Settings | None = None,
    device: str | None = None,
    checkpoint: str | Path | None = None,
    progress: bool = True,
    callback: Callable[[int, Model], None] | None = None,
) -> NeRF:
    """Train a field on a walk or on photographs.

    Args:
        data: RGB, poses and, where there are any, semantics; depth is looked at only where settings say so.
        model: a name (see :mod:`autonerf_lab.nerf.models`), or a :class:`~autonerf_lab.nerf.model.ModelSpec` of
            your own.
        preset: decides the hyper-parameters and the number of steps.
        seed: of everything random; same seed, same bits.
        steps: instead of the preset's.
        seconds: train for this long instead (for benchmarks and live lessons; not reproducible to the bit).
        settings: hyper-parameters instead of the preset's.
        device: None for the fastest way on this machine's cores, or a torch device ("cuda").
        checkpoint: folder that keeps the state of the training, to go on from after an interruption.
        progress: show a bar with the running PSNR.
        callback: called with the number of steps done and the model, after each step.

    Raises:
        UnknownNameError: no such model or preset.
        WrongTypeError: ``model`` is neither a name nor a ModelSpec.
        DataError: nothing to learn from.
        TrainingError: a loss is not finite, or memory is short.
    """
    spec = model_spec(model)
    chosen = config.preset(preset)
    settings = settings or spec.settings_for(chosen.name)
    settings = replace(settings, steps=steps) if steps is not None else settings
    data = Dataset.of(data) if isinstance(data, Trajectory) else data
    settings = _for_data(settings, data)
    frame = FieldFrame.of(data)
    rng = np.random.default_rng(seed)
    positions = frame.enter(data.poses[:, :3, 3])
    around = positions if data.metric else positions[inliers(positions)]
    box = SceneBox.around(around, settings.margin, settings.shell)
    classes = 0 if data.semantics is None else NUM_CLASSES
    try:
        built = spec.build(settings, box, len(data), classes, rng, device)
        state = TrainingState(built, Adam(built.parameters), rng)
        if checkpoint is not None:
            state.resume(checkpoint, {"seed": seed, "model": spec.name, "views": _fingerprint(data)})
        pixels = Pixels(data if settings.depth_weight else replace(data, depths=None), frame)
        _train(state, pixels, seconds, checkpoint, progress, callback)
        poses = data.poses if built.cameras is None else built.cameras.poses(data.poses, frame.unit)
        visibility = _visibility(built, pixels, data.metric, seed)
    except (MemoryError, torch.OutOfMemoryError) as error:
        raise TrainingError(
            f"not enough memory for {spec.name} ({error}); lower rays, samples or log2_entries in its settings, or use "
            "fewer or smaller images"
        ) from error
    meta: dict[str, Any] = {key: data.meta.get(key) for key in ("scene", "scene_sha256", "policy", "start")}
    meta |= {"model": spec.name, "preset": chosen.name, "seed": seed, "steps": state.step}
    meta |= {"train_psnr": state.psnr, "seconds": state.seconds}
    return NeRF(built, poses, data.cameras[0], visibility, meta, frame, classes)


def _for_data(settings: Settings, data: Dataset) -> Settings:
    """Settings that fit the data.

    Raises:
        DataError: there is nothing to learn from.
    """
    if len(data) < 2 or not np.ptp(data.poses, axis=0).any():
        raise DataError("cannot learn a scene from one view: at least two different poses are needed")
    data.check()
    if data.semantics is not None and (most := max(int(layer.max()) for layer in data.semantics)) >= NUM_CLASSES:
        raise DataError(f"the semantics hold the class {most}; classes are 0 to {NUM_CLASSES - 1}")
    if settings.depth_weight and data.depths is None:
        raise DataError("depth_weight is set, but the data has no depth; set it to 0, or keep depth on the walk")
    if data.metric:
        return settings
    return replace(settings, far=FAR_AWAY, turn=min(settings.turn, SPREAD * 2), shell=1.0)


def _fingerprint(data: Dataset) -> str:
    """Tells one set of views from another."""
    digest = hashlib.sha256(data.poses.tobytes())
    digest.update(repr(data.cameras).encode())
    for image in data.images:
        digest.update(image.tobytes())
    return digest.hexdigest()


def _train(
    state: TrainingState,
    pixels: Pixels,
    seconds: float | None,
    checkpoint: str | Path | None,
    progress: bool,
    callback: Callable[[int, Model], None] | None,
) -> None:
    settings = state.model.settings
    started = time.perf_counter() - state.seconds
    with tqdm(total=settings.steps, initial=state.step, disable=not progress, desc="fit", unit="step") as bar:
        while True:
            state.seconds = time.perf_counter() - started
            share = state.step / settings.steps if seconds is None else state.seconds / seconds
            if share >= 1:
                break
            train_step(state, pixels, learning_rate(share, settings))
            bar.update()
            if state.step % 20 == 0:
                bar.set_postfix_str(f"PSNR {state.psnr:.1f} dB")
            if checkpoint is not None:
                state.save_now_and_then(checkpoint)
            if callback is not None:
                callback(state.step, state.model)


def train_step(state: TrainingState, pixels: Pixels, rate: float) -> None:
    """Learn from one batch; a loss that is not finite stops everything before it reaches the parameters.

    Raises:
        TrainingError: names what is not finite.
    """
    model = state.model
    chosen = pixels.draw(model.settings.rays, state.rng, model.settings.rays_by_class)
    gradients, losses = model.train_step(pixels.rays(chosen), pixels.targets(chosen), state.rng)
    broken = [name for name, value in losses.items() if not np.isfinite(value)]
    # whatever breaks in a table passes through the networks: looking at these is enough, and cheap
    broken += [name for name, value in gradients.items() if not name.endswith("table") and not _finite(value)]
    if broken:
        raise TrainingError(
            f"{', '.join(broken)} not finite at step {state.step}: training stopped, the last checkpoint is intact; "
            "check the images and poses, or lower learning_rate"
        )
    state.optimizer.step(gradients, {name: rate * model.rate(name) for name in gradients})
    state.losses = losses
    decibel = float(-10 * np.log10(max(losses["mse"], 1e-10)))
    state.psnr = decibel if state.step == 0 else 0.98 * state.psnr + 0.02 * decibel
    state.step += 1


def _finite(value: Array) -> bool:
    return bool(torch.isfinite(value).all()) if isinstance(value, torch.Tensor) else bool(np.isfinite(value).all())


def _visibility(model: Model, pixels: Pixels, metric: bool, seed: int) -> Visibility:
    """Carve what the cameras saw, by the depth that the field itself renders for a sample of the training rays."""
    rays = pixels.rays(pixels.draw(min(model.settings.seen_rays, len(pixels)), np.random.default_rng(seed)))
    _, _, depth, _ = model.render_rays(rays.origins, rays.directions)
    if metric:
        return carve(rays.origins, rays.directions, depth)
    # the background of photographs has no end and a lost camera no place, a grid has
    near = (np.abs(rays.origins - model.box.center) <= model.box.half).all(axis=1)
    return carve(rays.origins[near], rays.directions[near], np.minimum(depth[near], SEEN_REACH), voxel=2 * VOXEL)
