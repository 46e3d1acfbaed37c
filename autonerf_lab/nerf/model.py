"""Models: a field, which predicts density, colour and class at points, and a sampler, which places points on rays.

::

    rays -> sampler.sample -> Samples -> field.train -> weights, losses, gradients -> sampler.learn

Field and sampler exchange numpy arrays, so that any field works with any sampler: fused numba kernels
(:mod:`.fields.hash_field`) or torch on any device (:mod:`.fields.torch_field`). A model of your own is a field, a
sampler, or a new combination of existing ones, and a :class:`ModelSpec` that builds it; see
:mod:`autonerf_lab.nerf.models`.
"""

import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np

from autonerf_lab.errors import DeviceError, UnknownNameError
from autonerf_lab.nerf.pixel_sampler import PixelSampler
from autonerf_lab.nerf.pose_offsets import PoseOffsets, level_weights, pose_rate
from autonerf_lab.nerf.ray_batch import Arrays, Rays, RenderOutput, Samples, Targets, TrainOutput
from autonerf_lab.nerf.scene_box import SceneBox
from autonerf_lab.nerf.settings import Settings

RENDER_CHUNK = 4096  # rays rendered at once
GRADIENT_CHUNK = 1 << 15  # rays whose gradients are computed at once


class Field(Protocol):
    """Density, colour and class logits at points. The optimiser updates ``parameters`` in place.

    Points, rays and lengths are in coordinates of the field, :class:`~autonerf_lab.nerf.field_frame.FieldFrame`. The
    attribute ``rays_at_once``, if there is one, is the largest number of rays of a call of ``render`` or
    ``ray_gradients``, instead of those of this module.
    """

    parameters: Arrays

    def train(
        self, rays: Rays, samples: Samples, targets: Targets, rng: np.random.Generator, ray_gradients: bool
    ) -> TrainOutput:
        """Return losses and gradients of a batch of rays.

        Args:
            rays: any number of rays.
            samples: bins on them.
            targets: ground truth of the rays.
            rng: for random backgrounds.
            ray_gradients: compute the gradients of origins and directions, too.
        """

    def render(self, rays: Rays, samples: Samples) -> RenderOutput:
        """Render rays."""

    def density(self, points: np.ndarray) -> np.ndarray:
        """Return (N,) float32 densities per unit of length at (N, 3) points."""

    def color(self, points: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Return (N, 3) float32 colours in [0, 1] at (N, 3) points for (N, 3) unit viewing directions."""

    def logits(self, points: np.ndarray) -> np.ndarray:
        """Return (N, C) float32 class logits at (N, 3) points."""

    def ray_gradients(
        self, rays: Rays, samples: Samples, target: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the squared colour error of rays and its gradients.

        Args:
            rays: any number of rays.
            samples: bins on them.
            target: (R, 3) float32 colours in [0, 1].

        Returns:
            error (R,), mean over the channels; gradients (R, 3) of origins and of directions.
        """


class Sampler(Protocol):
    """Placement of bins on rays. A learned placement has trained parameters."""

    parameters: Arrays  # trained by gradient
    state: dict[str, np.ndarray]  # updated in place by ``learn``

    def sample(self, rays: Rays, jitter: np.ndarray) -> Samples:
        """Place bins on rays; ``jitter`` (R,) float32 in [0, 1) shifts them, 0.5 for evaluation."""

    def learn(
        self,
        rays: Rays,
        samples: Samples,
        targets: Targets,
        weights: np.ndarray,
        rng: np.random.Generator,
    ) -> tuple[Arrays, dict[str, float]]:
        """Return gradients and losses of the sampler, given the field's ``weights`` (R, S) of the samples."""


@runtime_checkable
class DepthGuidedSampler(Protocol):
    """A sampler that learns where surfaces are from the depth of the training images, before the training.

    Its attribute ``observed``, if there is one, holds the arrays by name that a saved field needs of this, but a
    checkpoint of the training does not: a training that continues observes again.
    """

    def observe(self, pixels: PixelSampler) -> None:
        """Take in the measured depth of the training images."""

    def filter_depth(self, rays: Rays, depth: np.ndarray) -> np.ndarray:
        """Return the (R,) depth to train with: the measured one, or what all images together say; 0 for none."""

    def is_empty(self, points: np.ndarray) -> np.ndarray:
        """Return (N,) bool: True where depth shows empty space at (N, 3) points; the field learns little there."""


@runtime_checkable
class CoarseToFineField(Protocol):
    """A field whose fine details can be faded in, so that rough poses can be refined."""

    def set_level_weights(self, weights_at: Callable[[int], np.ndarray]) -> None:
        """Weight the levels of the encoding; ``weights_at`` returns the weights for a number of levels."""


class Model:
    """A field and a sampler, trained and used together.

    Args:
        settings: hyper-parameters.
        box: region of full resolution.
        field: predicts density, colour and class at points.
        sampler: places points on rays.
        frames: number of training images.

    Attributes:
        parameters: all trained arrays by name.
        state: arrays of the sampler that change without a gradient.
        observed: arrays of the sampler that stay as they were before the training; :class:`DepthGuidedSampler`.
        losses: mean losses of the last training step by name.
        pose_offsets: learned corrections of the training poses; None if the settings do not ask for them.
    """

    def __init__(self, settings: Settings, box: SceneBox, field: Field, sampler: Sampler, frames: int) -> None:
        self.settings, self.box, self.field, self.sampler = settings, box, field, sampler
        self.pose_offsets = PoseOffsets(frames) if settings.refine_cameras else None
        self.parameters: Arrays = {**field.parameters, **sampler.parameters}
        if self.pose_offsets is not None:
            self.parameters |= self.pose_offsets.parameters
        self.state = sampler.state
        self.observed: dict[str, np.ndarray] = getattr(sampler, "observed", {})
        self.losses: dict[str, float] = {}
        self._lock = threading.RLock()  # field and sampler reuse buffers: a viewer renders while others do

    def learning_rates(self, rate: float, share: float) -> dict[str, float]:
        """Return the learning rate of each parameter.

        Args:
            rate: scheduled rate of the networks.
            share: completed share of the training, 0 to 1.
        """
        table = rate * getattr(self.settings, "table_rate", 1.0)
        rates = {name: table if name.endswith("table") else rate for name in self.parameters}
        if self.pose_offsets is not None:
            rates |= dict.fromkeys(self.pose_offsets.parameters, pose_rate(share))
        return rates

    def set_progress(self, share: float) -> None:
        """Prepare for a training step at a share of the training: with pose offsets, levels are faded in."""
        if self.pose_offsets is not None and isinstance(self.field, CoarseToFineField):
            self.field.set_level_weights(lambda levels: level_weights(levels, share))

    def train_step(self, rays: Rays, targets: Targets, rng: np.random.Generator) -> tuple[Arrays, dict[str, float]]:
        """Return the gradients by parameter name and the mean losses of a batch.

        The gradients may be buffers to which the next step adds, unless the optimiser has cleared them.
        """
        jitter = rng.random(len(rays), dtype=np.float32)
        if isinstance(self.sampler, DepthGuidedSampler):
            targets = replace(targets, depth=self.sampler.filter_depth(rays, targets.depth))
        rays = replace(rays, depth=targets.depth)
        if self.pose_offsets is None:
            samples = self.sampler.sample(rays, jitter)
            output = self.field.train(rays, samples, targets, rng, False)
            d_offsets: Arrays = {}
        else:
            rays = self.pose_offsets.apply(rays)
            samples = self.sampler.sample(rays, jitter)
            output = self.field.train(rays, samples, targets, rng, True)
            d_offsets = self.pose_offsets.gradients(rays, output)
        gradients, losses = self.sampler.learn(rays, samples, targets, output.weights, rng)
        self.losses = {**output.losses, **losses}
        return {**output.gradients, **gradients, **d_offsets}, self.losses

    def density(self, points: np.ndarray) -> np.ndarray:
        """Return (N,) float32 densities per unit of length at (N, 3) points; 0 in space measured to be empty."""
        density = self.field.density(points)
        if isinstance(self.sampler, DepthGuidedSampler):
            return np.where(self.sampler.is_empty(points), np.float32(0), density)
        return density

    def render_rays(
        self, rays_o: np.ndarray, rays_d: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Render any number of rays, in chunks.

        Args:
            rays_o: (N, 3) float32 origins.
            rays_d: (N, 3) float32 unit directions.

        Returns:
            color (N, 3), logits (N, C), depth (N,) median distance along the ray, opacity (N,); float32.
        """
        parts = []
        for chunk in self._chunks(len(rays_o), RENDER_CHUNK):
            rays = Rays(rays_o[chunk], rays_d[chunk])
            with self._lock, _no_gradients():
                output = self.field.render(rays, self._evaluation_samples(rays))
                parts.append((output.color, output.logits, output.depth, output.weights.sum(axis=1)))
        color, logits, depth, opacity = (np.concatenate(values) for values in zip(*parts, strict=True))
        return color, logits, depth, opacity

    def ray_gradients(
        self, rays_o: np.ndarray, rays_d: np.ndarray, target: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the squared error of rays and its gradients through the frozen field (section 4.3, task 4).

        The distances of the samples are held fixed, as in training. Rays are processed in chunks.

        Args:
            rays_o: (N, 3) float32 origins.
            rays_d: (N, 3) float32 unit directions.
            target: (N, 3) float32 colours in [0, 1].

        Returns:
            error (N,), mean over the channels; gradients (N, 3) of origins and of unit directions.
        """
        parts = []
        for chunk in self._chunks(len(rays_o), GRADIENT_CHUNK):
            rays = Rays(rays_o[chunk], rays_d[chunk])
            with self._lock:
                with _no_gradients():
                    samples = self._evaluation_samples(rays)
                parts.append(self.field.ray_gradients(rays, samples, target[chunk]))
        error, d_o, d_d = (np.concatenate(values) for values in zip(*parts, strict=True))
        return error, d_o, d_d

    def _chunks(self, count: int, size: int) -> Iterator[slice]:
        size = getattr(self.field, "rays_at_once", size)
        return (slice(first, first + size) for first in range(0, max(count, 1), size))

    def _evaluation_samples(self, rays: Rays) -> Samples:
        return self.sampler.sample(rays, np.full(len(rays), 0.5, np.float32))


def _no_gradients() -> AbstractContextManager:
    """Return ``torch.no_grad()``; fields that compute without torch need not load it."""
    torch = sys.modules.get("torch")
    return nullcontext() if torch is None else torch.no_grad()


@dataclass(frozen=True)
class ModelSpec:
    """Recipe for a model. ``MODELS`` holds one per built-in model; a plug-in package registers its own.

    ``build(settings, box, frames, classes, rng, device)`` returns a :class:`Model`. The arguments are the settings of
    the preset, the :class:`~autonerf_lab.nerf.scene_box.SceneBox` of the training poses, the number of training images,
    the number of classes (0 for images without labels), a NumPy generator for the initial values, and the device: None
    for the fastest implementation on the CPU, or a torch device.
    """

    settings: Mapping[str, Settings]  # by preset
    build: Callable[..., Model]
    name: str = "custom"

    def settings_for(self, preset: str) -> Settings:
        """Return the hyper-parameters of a preset.

        Raises:
            UnknownNameError: the model has no settings for this preset.
        """
        if preset not in self.settings:
            raise UnknownNameError(f"preset of {self.name}", preset, self.settings)
        return self.settings[preset]

    def named(self, name: str) -> "ModelSpec":
        """Return a copy with another name."""
        return replace(self, name=name)


def check_device(device: str | None) -> None:
    """Check that torch can compute on a device; None, the CPU, always passes.

    Raises:
        DeviceError: the device does not exist on this machine.

    Example:
        >>> check_device("cpu")
        >>> check_device("gpu")
        Traceback (most recent call last):
        autonerf_lab.errors.DeviceError: device 'gpu' is not available on this machine; without it the CPU computes
    """
    if device is None:
        return
    import torch

    try:
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError) as error:
        raise DeviceError(
            f"device {str(device)!r} is not available on this machine; without it the CPU computes"
        ) from error
