"""What a model is: a field, which knows what is at a point, and a sampler, which knows where on a ray to ask it.

::

    rays -> sampler.sample -> Samples -> field.train -> weights, losses, gradients -> sampler.learn

What passes between the two is numpy, so that any field works with any sampler: fused numba kernels
(:mod:`.fields.hash_field`) beside torch on any device (:mod:`.fields.torch_field`). A model of your own is a field, or
a sampler, or only another pairing of those on the shelf, and a :class:`ModelSpec` that builds it; see
:mod:`autonerf_lab.nerf.models`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
import torch

from autonerf_lab.errors import UnknownNameError
from autonerf_lab.nerf.kernels.tiling import BLOCK_RAYS
from autonerf_lab.nerf.pose_offsets import Cameras
from autonerf_lab.nerf.ray_batch import Arrays, Learned, Rays, Rendered, Samples, Targets
from autonerf_lab.nerf.scene_box import SceneBox
from autonerf_lab.nerf.settings import Settings

PIECE = 4096  # rays that are rendered at once
GRADIENT_PIECE = 1 << 15  # rays whose gradients are found at once: many cameras have few rays each, and share a piece


class Field(Protocol):
    """Density, colour and class at points. ``parameters`` are updated in place by the optimiser."""

    parameters: Arrays

    def train(
        self, rays: Rays, samples: Samples, targets: Targets, rng: np.random.Generator, rays_too: bool
    ) -> Learned:
        """Losses and gradients of a batch; ``rays_too``: those of origins and directions as well."""

    def render(self, rays: Rays, samples: Samples) -> Rendered:
        """What rays show."""

    def density(self, points: np.ndarray) -> np.ndarray:
        """(N, 3) world points -> (N,) float32, sigma per metre."""

    def color(self, points: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """(N, 3) world points, (N, 3) unit viewing directions -> (N, 3) float32 in [0, 1]."""

    def logits(self, points: np.ndarray) -> np.ndarray:
        """(N, 3) world points -> (N, C) float32."""

    def ray_gradients(
        self, rays: Rays, samples: Samples, target: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(R, 3) colours -> squared error (R,), mean over the channels, and its gradients for origins, directions."""


class Sampler(Protocol):
    """Bins on rays, and whatever is learned about where to put them."""

    parameters: Arrays  # learned by gradient
    state: dict[str, np.ndarray]  # changed by ``learn`` in place

    def sample(self, rays: Rays, jitter: np.ndarray) -> Samples:
        """Bins for rays; ``jitter`` (R,) float32 in [0, 1) places them, 0.5 for evaluation."""

    def learn(
        self,
        rays: Rays,
        samples: Samples,
        targets: Targets,
        weights: np.ndarray,
        field: Field,
        rng: np.random.Generator,
    ) -> tuple[Arrays, dict[str, float]]:
        """Gradients and losses of the sampler, after the field has found ``weights`` (R, S)."""


class Model:
    """A field and a sampler, trained and used together.

    Args:
        settings: hyper-parameters.
        box: where the scene is.
        field: knows what is at a point.
        sampler: knows where to ask.
        frames: number of training images.
    """

    def __init__(self, settings: Settings, box: SceneBox, field: Field, sampler: Sampler, frames: int) -> None:
        self.settings, self.box, self.field, self.sampler = settings, box, field, sampler
        self.cameras = Cameras(frames) if settings.refine_cameras else None
        self.parameters: Arrays = {**field.parameters, **sampler.parameters}
        if self.cameras is not None:
            self.parameters |= self.cameras.parameters
        self.state = sampler.state

    def rate(self, name: str) -> float:
        """How much faster than the schedule a parameter learns."""
        if name in Cameras.RATES:
            return Cameras.RATES[name]
        return getattr(self.settings, "table_rate", 1.0) if name.endswith("table") else 1.0

    def train_step(self, rays: Rays, targets: Targets, rng: np.random.Generator) -> tuple[Arrays, dict[str, float]]:
        """Gradients by parameter name (buffers that the next step reuses) and mean losses of a batch."""
        jitter = rng.random(len(rays), dtype=np.float32)
        if self.cameras is None:
            samples = self.sampler.sample(rays, jitter)
            learned = self.field.train(rays, samples, targets, rng, False)
            moved: Arrays = {}
        else:
            rays = self.cameras.move(rays)
            samples = self.sampler.sample(rays, jitter)
            learned = self.field.train(rays, samples, targets, rng, True)
            moved = self.cameras.gradients(rays, learned)
        found, losses = self.sampler.learn(rays, samples, targets, learned.weights, self.field, rng)
        return {**learned.gradients, **found, **moved}, {**learned.losses, **losses}

    @torch.no_grad()
    def render_rays(
        self, rays_o: np.ndarray, rays_d: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Render rays, in pieces.

        Args:
            rays_o: (N, 3) float32 origins, metres.
            rays_d: (N, 3) float32 unit directions.

        Returns:
            color (N, 3), logits (N, C), depth (N,) median distance along the ray in metres, opacity (N,); float32.
        """
        parts = []
        for first in range(0, len(rays_o), PIECE):
            rays = _padded(rays_o[first : first + PIECE], rays_d[first : first + PIECE])
            shown = self.field.render(rays, self.sampler.sample(rays, _centred(rays)))
            count = min(PIECE, len(rays_o) - first)
            part = shown.color, shown.logits, shown.depth, shown.weights.sum(axis=1)
            parts.append([values[:count] for values in part])
        color, logits, depth, opacity = (np.concatenate(values) for values in zip(*parts, strict=True))
        return color, logits, depth, opacity

    def ray_gradients(
        self, rays_o: np.ndarray, rays_d: np.ndarray, target: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Squared error of rays and its gradient, through the frozen field, in pieces (section 4.3, task 4).

        The distances of the samples are held fixed, as they are in training.

        Args:
            rays_o: (N, 3) float32 origins, metres.
            rays_d: (N, 3) float32 unit directions.
            target: (N, 3) float32 colours in [0, 1].

        Returns:
            error (N,), mean over the channels; gradients (N, 3) for origins and for unit directions.
        """
        parts = []
        for first in range(0, len(rays_o), GRADIENT_PIECE):
            rays = _padded(rays_o[first : first + GRADIENT_PIECE], rays_d[first : first + GRADIENT_PIECE])
            wanted = target[first : first + GRADIENT_PIECE]
            count, missing = len(wanted), len(rays) - len(wanted)
            wanted = np.concatenate([wanted, np.repeat(wanted[-1:], missing, axis=0)]) if missing else wanted
            samples = self.sampler.sample(rays, _centred(rays))
            parts.append([np.copy(a[:count]) for a in self.field.ray_gradients(rays, samples, wanted)])
        error, d_o, d_d = (np.concatenate(values) for values in zip(*parts, strict=True))
        return error, d_o, d_d


@dataclass(frozen=True)
class ModelSpec:
    """How to make a model: what ``MODELS`` holds, and what a package registers.

    ``build(settings, box, frames, classes, rng, device)`` gets the number of training images, the number of classes (0
    when nothing is labelled), a generator for the initial values, and where to compute: None for the fastest way on
    this machine's cores, or a torch device.
    """

    settings: Mapping[str, Settings]  # by preset
    build: Callable[..., Model]
    name: str = field(default="custom")

    def settings_for(self, preset: str) -> Settings:
        """The hyper-parameters of a preset.

        Raises:
            UnknownNameError: the model has none by that name.
        """
        if preset not in self.settings:
            raise UnknownNameError(f"preset of {self.name}", preset, self.settings)
        return self.settings[preset]

    def named(self, name: str) -> "ModelSpec":
        """The same under the name it is registered by."""
        return replace(self, name=name)


def _centred(rays: Rays) -> np.ndarray:
    return np.full(len(rays), 0.5, np.float32)


def _padded(rays_o: np.ndarray, rays_d: np.ndarray) -> Rays:
    """Rows repeated at the end until they fill whole blocks."""
    missing = -len(rays_o) % BLOCK_RAYS
    return Rays(*(np.concatenate([a, np.repeat(a[-1:], missing, axis=0)]) if missing else a for a in (rays_o, rays_d)))
