"""Training of a field on a trajectory or on photographs (section 4.2: RGB, semantics and poses, no depth)."""

import hashlib
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from tqdm.auto import tqdm

from autonerf_lab import presets
from autonerf_lab.classes import NUM_CLASSES
from autonerf_lab.data.dataset import Dataset
from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.errors import DataError, TrainingError
from autonerf_lab.geometry import is_planar, planar_from_pose
from autonerf_lab.nerf import planes
from autonerf_lab.nerf.checkpoint import TrainingState
from autonerf_lab.nerf.driven_floor import driven_floor_depth, drove_here
from autonerf_lab.nerf.field_frame import SPREAD, FieldFrame, inliers
from autonerf_lab.nerf.model import DepthGuidedSampler, Model, ModelSpec, check_device
from autonerf_lab.nerf.models import model_spec
from autonerf_lab.nerf.optimizer import Adam
from autonerf_lab.nerf.pixel_sampler import PixelSampler
from autonerf_lab.nerf.radiance_field import NeRF
from autonerf_lab.nerf.ray_batch import Array, Arrays, Rays
from autonerf_lab.nerf.scene_box import SceneBox
from autonerf_lab.nerf.settings import Settings, scaled_to_area
from autonerf_lab.nerf.tensorboard import TensorBoardLog
from autonerf_lab.nerf.visibility import VOXEL, Visibility, carve
from autonerf_lab.utils.arguments import refuse_name
from autonerf_lab.utils.resources import is_out_of_memory

PATIENCE = 10  # skipped batches in a row before the state returns to a snapshot
MAX_RETRIES = 3  # returns before the training stops
SNAPSHOT_EVERY = 250  # steps
AVERAGE_EVERY = 4  # steps; successive parameters are nearly the same
SEEN_REACH = 8.0  # largest distance that counts as seen in photographs, units of the field
FAR_AWAY = 1000.0  # end of the rays of photographs, units of the field
RANDOM_LABELS = {"noisy", "NoisyLabels"}  # segmenters whose errors do not depend on the distance


def learning_rate(share: float, settings: Settings) -> float:
    """Return the scheduled learning rate: linear warm-up, then exponential decay from the first to the final rate.

    Args:
        share: completed share of the training, 0 to 1.
        settings: holds the rates.
    """
    warmup = min(share / settings.warmup, 1.0) if settings.warmup else 1.0
    return settings.learning_rate * warmup * (settings.final_learning_rate / settings.learning_rate) ** share


def fit(
    data: Trajectory | Dataset,
    model: str | ModelSpec = "semantic-nerfacto",
    preset: str | presets.Preset | None = None,
    *,
    seed: int = 0,
    steps: int | None = None,
    seconds: float | None = None,
    settings: Settings | None = None,
    device: str | None = None,
    checkpoint: str | Path | None = None,
    progress: bool = True,
    callback: Callable[[int, Model], None] | None = None,
    log_dir: str | Path | None = None,
) -> NeRF:
    """Train a field on a trajectory or on photographs.

    Args:
        data: RGB images, poses and optionally semantics, whose loss is weighted by their confidence if it is known;
            models whose ``depth_weight`` is above 0 also need depth.
        model: a name (see :mod:`autonerf_lab.nerf.models`), or a custom
            :class:`~autonerf_lab.nerf.model.ModelSpec`.
        preset: selects the hyper-parameters and the number of steps; those of ``fast`` grow with the explored area
            of a house (:func:`~autonerf_lab.nerf.settings.scaled_to_area`).
        seed: random seed; the same seed gives the same bits.
        steps: number of steps instead of the preset's.
        seconds: duration of the training instead of a number of steps (for benchmarks and live lessons; not
            reproducible to the bit).
        settings: hyper-parameters instead of the preset's.
        device: None for the fastest implementation on the CPU, or a torch device ("cuda").
        checkpoint: folder that stores the state of the training, from which an interrupted training continues.
        progress: show a progress bar with the running PSNR.
        callback: called with the number of completed steps and the model after each step; ``model.losses`` has the
            losses of the step.
        log_dir: folder for a TensorBoard log of the losses; needs the extra ``training``.

    Raises:
        UnknownNameError: the model or preset does not exist.
        WrongTypeError: ``model`` is neither a name nor a ModelSpec, or ``data`` is a name.
        DataError: the data cannot be learned from, or ``seconds`` is not above 0.
        RunFolderError: ``checkpoint`` holds a training with other data, seed or settings.
        DeviceError: the device does not exist on this machine.
        MissingPackageError: ``log_dir`` without TensorBoard.
        TrainingError: the losses stay not finite after retries, the training ends with parameters that are not finite,
            or memory is short; the last checkpoint is valid.
    """
    check_device(device)
    refuse_name(data, "the trajectory", "lab.load_trajectory({})")
    if seconds is not None and not 0 < seconds < np.inf:
        raise DataError(f"seconds must be a finite number above 0, not {seconds!r}")
    spec = model_spec(model)
    chosen = presets.preset(preset)
    data = Dataset.from_trajectory(data) if isinstance(data, Trajectory) else data
    if settings is None:
        settings = spec.settings_for(chosen.name)
        if chosen.name == "fast":
            settings = scaled_to_area(settings, _explored_area(data))
    settings = replace(settings, steps=steps) if steps is not None else settings
    try:
        state, pixels = prepare(data, spec, settings, seed, device)
        built, frame = state.model, pixels.frame
        if checkpoint is not None:
            limit = {} if seconds is None else {"seconds": seconds}
            state.resume(checkpoint, {"seed": seed, "model": spec.name, "views": _fingerprint(data)} | limit)
            if state.planes:
                pixels.learn_planes(**state.planes)
        log = None if log_dir is None else TensorBoardLog(log_dir, state.step)
        callbacks = [call for call in (callback, log) if call is not None]
        try:
            _train(state, pixels, seconds, checkpoint, progress, callbacks)
        finally:
            if log is not None:
                log.close()
        poses = data.poses if built.pose_offsets is None else built.pose_offsets.corrected(data.poses, frame.unit)
        built.set_progress(1.0)
        visibility = _visibility(built, pixels, data.metric, seed)
    except Exception as error:
        if not is_out_of_memory(error):
            raise
        raise TrainingError(
            f"not enough memory for {spec.name} ({error}); lower rays, samples or log2_entries in its settings, or use "
            "fewer or smaller images"
        ) from error
    meta: dict[str, Any] = {key: data.meta.get(key) for key in ("scene", "scene_sha256", "policy", "start")}
    if data.true_poses is not None or data.pose_source != "true":
        meta["pose_source"] = data.pose_source
    if data.true_poses is not None:
        meta["true_poses"] = [planar_from_pose(pose) for pose in data.true_poses]
    meta |= {"semantics": data.meta["semantics"]} if "semantics" in data.meta else {}
    meta |= {"model": spec.name, "preset": chosen.name, "seed": seed, "steps": state.step}
    meta |= {"train_psnr": state.psnr, "seconds": state.seconds, "skipped_steps": state.skipped}
    return NeRF(built, poses, data.intrinsics[0], visibility, meta, frame, _classes(data))


def prepare(
    data: Dataset, spec: ModelSpec, settings: Settings, seed: int = 0, device: str | None = None
) -> tuple[TrainingState, PixelSampler]:
    """Return the state of a training before its first step, and the pixels to train on.

    Args:
        data: see :func:`fit`.
        spec: recipe of the model.
        settings: hyper-parameters; those that do not fit the data are changed, see ``state.model.settings``.
        seed: random seed.
        device: None for the fastest implementation on the CPU, or a torch device.

    Raises:
        DataError: the data cannot be learned from.
    """
    settings = _for_data(settings, data)
    if not settings.depth_weight:
        data = replace(data, depths=driven_floor_depth(data) if settings.floor_weight else None)
    frame = FieldFrame.from_dataset(data)
    rng = np.random.default_rng(seed)
    positions = frame.to_field(data.poses[:, :3, 3])
    around = positions if data.metric else positions[inliers(positions)]
    box = SceneBox.around(around, settings.margin, settings.shell)
    model = spec.build(settings, box, len(data), _classes(data), rng, device)
    if model.pose_offsets is not None:
        planar = settings.refine_planar
        model.pose_offsets.planar = is_planar(data.poses) if planar is None else planar
    shares = (settings.rays_by_class, settings.rays_by_contrast, settings.rays_on_planes)
    pixels = PixelSampler(data, frame, settings.label_distance, *shares)
    if isinstance(model.sampler, DepthGuidedSampler):
        model.sampler.observe(pixels)
    return TrainingState(model, Adam(model.parameters), rng), pixels


def _classes(data: Dataset) -> int:
    return 0 if data.semantics is None else NUM_CLASSES


def _explored_area(data: Dataset) -> float:
    """Return the explored area that :func:`~autonerf_lab.exploration.explore` recorded, m²; 0 for other data."""
    recorded = data.meta.get("explored_m2")
    last = recorded[-1] if data.metric and isinstance(recorded, list) and recorded else 0.0
    return float(last) if isinstance(last, int | float) and np.isfinite(last) else 0.0


def _for_data(settings: Settings, data: Dataset) -> Settings:
    """Check the data, and return the settings adapted to them.

    Raises:
        DataError: the data cannot be learned from.
    """
    if len(data) < 2 or not np.ptp(data.poses, axis=0).any():
        raise DataError("cannot learn a scene from one view: at least two different poses are needed")
    data.check()
    if data.masks is not None and not any(mask.any() for mask in data.masks):
        raise DataError("the masks exclude all pixels; a mask is black where the image is not used")
    if data.semantics is not None and (most := max(int(layer.max()) for layer in data.semantics)) >= NUM_CLASSES:
        raise DataError(f"the semantics contain the class {most}; classes are 0 to {NUM_CLASSES - 1}")
    if settings.depth_weight and data.depths is None:
        raise DataError(
            "the model learns from depth (depth_weight is above 0), but the data has no depth; choose a model without "
            "it, such as semantic-nerfacto, or data with depth"
        )
    if settings.floor_weight and not drove_here(data):
        settings = replace(settings, floor_weight=0.0)
    if settings.depth_weight or not settings.floor_weight or len({(c.width, c.height) for c in data.intrinsics}) > 1:
        settings = replace(settings, rays_on_planes=0.0)
    # Without depth training, the only depth is that of the driven floor and of planes.
    if not data.metric or not settings.depth_weight or data.meta.get("semantics") in RANDOM_LABELS:
        settings = replace(settings, label_distance=0.0)
    if data.confidences is not None and settings.label_distance:
        settings = replace(settings, rays_by_class=0.0)  # many of the rare predicted labels are wrong
    if data.metric:
        return settings
    return replace(settings, far=FAR_AWAY, turn=min(settings.turn, SPREAD * 2), shell=1.0)


def _fingerprint(data: Dataset) -> str:
    """Return a hash of the poses, intrinsics, images and layers."""
    digest = hashlib.sha256(data.poses.tobytes())
    digest.update(repr(data.intrinsics).encode())
    for layers in (data.images, data.masks, data.semantics, data.confidences, data.depths):
        for layer in layers or ():
            digest.update(layer.tobytes())
    return digest.hexdigest()


def _train(
    state: TrainingState,
    pixels: PixelSampler,
    seconds: float | None,
    checkpoint: str | Path | None,
    progress: bool,
    callbacks: list[Callable[[int, Model], None]],
) -> None:
    """Train until the number of steps, or the number of seconds, is reached.

    Raises:
        TrainingError: see :func:`train_step`, or no finite trained parameters are left.
    """
    settings = state.model.settings
    started = time.perf_counter() - state.seconds
    state.take_snapshot()
    with tqdm(total=settings.steps, initial=state.step, disable=not progress, desc="fit", unit="step") as bar:
        while True:
            state.seconds = time.perf_counter() - started
            share = state.step / settings.steps if seconds is None else state.seconds / seconds
            if share >= 1:
                break
            if settings.rays_on_planes and share >= planes.START and not state.planes and not state.failures:
                state.planes = planes.planar_pixels(state.model, pixels)
                pixels.learn_planes(**state.planes)
            train_step(state, pixels, share)
            if not state.failures and share >= 1 - settings.averaged and state.step % AVERAGE_EVERY == 0:
                state.average.add()
            bar.update()
            if state.step % 20 == 0:
                bar.set_postfix_str(f"PSNR {state.psnr:.1f} dB")
            if checkpoint is not None:
                state.save_periodically(checkpoint)
            for callback in callbacks:
                callback(state.step, state.model)
    if state.failures and not state.is_finite():  # a batch that was skipped alone leaves the state as it was
        state.restore_snapshot()
    state.average.apply()
    untrained = state.skipped and not any(state.optimizer.steps.values())
    if untrained or not state.is_finite():
        raise TrainingError(
            f"no finite trained parameters are left after {state.step} steps, of which {state.skipped} were skipped; "
            "check the images, poses and settings"
        )


def train_step(state: TrainingState, pixels: PixelSampler, share: float) -> None:
    """Update the model by one batch of pixels, at a share of the training from 0 to 1.

    A batch with a loss or gradient that is not finite is skipped. After :data:`PATIENCE` skipped batches in a row, the
    state returns to its last snapshot with half of the learning rates.

    Raises:
        TrainingError: the training failed again after :data:`MAX_RETRIES` returns; the last checkpoint is valid.
    """
    model = state.model
    if state.step % SNAPSHOT_EVERY == 0 and not state.failures:
        state.take_snapshot()
    model.set_progress(share)
    chosen = pixels.sample(model.settings.rays, state.rng)
    rays = pixels.rays(chosen)
    gradients, losses = model.train_step(rays, pixels.targets(chosen), state.rng)
    broken = [name for name, value in losses.items() if not np.isfinite(value)]
    # Errors in a table reach the networks, too; checking only the networks is fast.
    broken += [name for name, value in gradients.items() if not name.endswith("table") and not _finite(value)]
    state.step += 1
    if broken:
        _clear(gradients)  # the next step adds to these buffers
        state.skipped += 1
        state.failures += 1
        if state.failures % PATIENCE == 0:
            if state.failures > MAX_RETRIES * PATIENCE:
                raise TrainingError(
                    f"{', '.join(broken)} not finite in {state.failures} steps in a row up to step {state.step}, with "
                    f"a learning rate lowered {MAX_RETRIES} times{_suspects(model, pixels, rays)}; check the images, "
                    "poses and settings"
                )
            state.restore_snapshot()
        return
    state.failures = 0
    rates = model.learning_rates(learning_rate(share, model.settings), share)
    state.optimizer.step(gradients, {name: state.rate_scale * rate for name, rate in rates.items()})
    decibel = float(-10 * np.log10(max(losses["mse"], 1e-10)))
    state.psnr = 0.98 * state.psnr + 0.02 * decibel if state.losses else decibel
    state.losses = losses


def _suspects(model: Model, pixels: PixelSampler, rays: Rays) -> str:
    """Return the training images whose rays of a batch are not finite, as a part of an error message."""
    assert rays.frames is not None
    broken = ~np.isfinite(model.render_rays(rays.origins, rays.directions)[0]).all(axis=1)
    names = [pixels.names[frame] for frame in np.unique(rays.frames[broken])[:5]]
    return f" (images: {', '.join(names)})" if names else ""


def _clear(gradients: Arrays) -> None:
    for value in gradients.values():
        if isinstance(value, np.ndarray):
            value[...] = 0


def _finite(value: Array) -> bool:
    return bool((np.isfinite(value) if isinstance(value, np.ndarray) else value.isfinite()).all())


def _visibility(model: Model, pixels: PixelSampler, metric: bool, seed: int) -> Visibility:
    """Carve the seen space by the depth that the field renders for a sample of the training rays."""
    rays = pixels.rays(pixels.sample(min(model.settings.seen_rays, len(pixels)), np.random.default_rng(seed)))
    rays = rays if model.pose_offsets is None else model.pose_offsets.apply(rays)
    _, _, depth, _ = model.render_rays(rays.origins, rays.directions)
    if metric:
        return carve(rays.origins, rays.directions, depth)
    # The background of photographs is unlimited, and outlier poses lie anywhere; the grid must stay small.
    near = (np.abs(rays.origins - model.box.center) <= model.box.half).all(axis=1)
    return carve(rays.origins[near], rays.directions[near], np.minimum(depth[near], SEEN_REACH), voxel=2 * VOXEL)
