"""A field by autograd, on any device: write ``forward``, and training, rendering and queries follow.

This is the readable reference of the fused kernels, what runs on CUDA, and the base of a field of your own.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable

import numpy as np
import torch
from torch.nn import functional

from autonerf_lab.nerf import rendering
from autonerf_lab.nerf.ray_batch import NO_DEPTH, Arrays, Learned, Rays, Rendered, Samples, Targets
from autonerf_lab.nerf.settings import Settings

Tensors = dict[str, torch.Tensor]


class TorchField(ABC):
    """Density, colour and class at points, by autograd.

    Args:
        settings: loss weights.
        values: initial parameters by name.
        device: a torch device.
    """

    def __init__(self, settings: Settings, values: dict[str, np.ndarray], device: str) -> None:
        self.settings, self.device = settings, torch.device(device)
        self.parameters: Arrays = tensors(values, device)

    @abstractmethod
    def forward(
        self, points: torch.Tensor, directions: torch.Tensor, frames: torch.Tensor | None
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """What is at points on rays.

        Args:
            points: (R, S, 3) world, metres.
            directions: (R, 3) unit, from the camera into the scene.
            frames: (R,) training image of each ray, None of no image.

        Returns:
            raw (R, S), from which :func:`~autonerf_lab.nerf.rendering.density_from_raw` makes a density; color
            (R, S, 3) in [0, 1]; logits (R, S, C).
        """

    def train(
        self, rays: Rays, samples: Samples, targets: Targets, rng: np.random.Generator, rays_too: bool
    ) -> Learned:
        s = self.settings
        background = self._tensor(rng.random((len(rays), 3), dtype=np.float32))
        origins, directions = (self._tensor(a).requires_grad_(rays_too) for a in (rays.origins, rays.directions))
        color, logits, weights, left = self._render(origins, directions, rays.frames, samples)
        starts, ends = self._tensor(samples.starts), self._tensor(samples.ends)
        losses = {
            "mse": ((color + left[:, None] * background - self._tensor(targets.color)) ** 2).mean(),
            "distortion": rendering.distortion_loss(weights, starts, ends, s.turn).mean(),
        }
        total = losses["mse"] + s.distortion_weight * losses["distortion"]
        if logits.shape[1]:
            labels = self._tensor(targets.labels)
            entropy = functional.cross_entropy(logits, labels.clamp(min=0), reduction="none") * (labels >= 0)
            losses["cross_entropy"] = entropy.mean()
            losses["class_accuracy"] = (logits.argmax(dim=1) == labels).float().mean()
            total = total + s.semantic_weight * losses["cross_entropy"]
        if s.depth_weight:
            wanted = self._tensor(targets.depth)
            expected = (weights * (starts + ends) / 2).sum(dim=1) + left * ends[:, -1]
            losses["depth"] = ((expected - wanted).abs() * (wanted != NO_DEPTH)).mean()
            total = total + s.depth_weight * losses["depth"]
        wrt = self.parameters | ({"origins": origins, "directions": directions} if rays_too else {})
        gradients = gradients_of(total, wrt)
        d_rays = [gradients.pop(name).cpu().numpy() for name in ("origins", "directions") if rays_too]
        values = {name: loss.item() for name, loss in losses.items()}
        return Learned(gradients, values, weights.detach().cpu().numpy(), *d_rays)

    @torch.no_grad()
    def render(self, rays: Rays, samples: Samples) -> Rendered:
        origins, directions = self._tensor(rays.origins), self._tensor(rays.directions)
        color, logits, weights, _ = self._render(origins, directions, rays.frames, samples)
        depth = rendering.median_depth(weights, self._tensor(samples.starts), self._tensor(samples.ends))
        return Rendered(*(value.cpu().numpy() for value in (color, logits, depth, weights)))

    def density(self, points: np.ndarray) -> np.ndarray:
        return self._query(points, None, lambda raw, color, logits: rendering.density_from_raw(raw))

    def color(self, points: np.ndarray, directions: np.ndarray) -> np.ndarray:
        return self._query(points, directions, lambda raw, color, logits: color)

    def logits(self, points: np.ndarray) -> np.ndarray:
        return self._query(points, None, lambda raw, color, logits: logits)

    def ray_gradients(
        self, rays: Rays, samples: Samples, target: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        origins, directions = (self._tensor(a).requires_grad_() for a in (rays.origins, rays.directions))
        color, _, _, _ = self._render(origins, directions, rays.frames, samples)
        error = ((color - self._tensor(target)) ** 2).mean(dim=1)
        d_o, d_d = torch.autograd.grad(error.sum(), (origins, directions))
        return error.detach().cpu().numpy(), d_o.cpu().numpy(), d_d.cpu().numpy()

    def _render(
        self, origins: torch.Tensor, directions: torch.Tensor, frames: np.ndarray | None, samples: Samples
    ) -> tuple[torch.Tensor, ...]:
        """Color (R, 3) without background, logits (R, C), weights (R, S), light that is left (R,)."""
        starts, ends = self._tensor(samples.starts), self._tensor(samples.ends)
        points = middle_points(origins, directions, starts, ends)
        images = None if frames is None else self._tensor(frames)
        raw, color, logits = self.forward(points, directions, images)
        weights = rendering.weights_from_density(rendering.density_from_raw(raw), starts, ends)
        return (
            rendering.composite(weights, color),
            rendering.composite(weights, logits),
            weights,
            1 - weights.sum(dim=1),
        )

    @torch.no_grad()
    def _query(
        self, points: np.ndarray, directions: np.ndarray | None, pick: Callable[..., torch.Tensor]
    ) -> np.ndarray:
        if directions is None:
            directions = np.broadcast_to(np.array([0.0, 0.0, -1.0]), (len(points), 3))
        found, piece = [], 1 << 16
        for first in range(0, max(len(points), 1), piece):
            here = slice(first, first + piece)
            x, d = (self._tensor(np.asarray(a[here], np.float32)) for a in (points, directions))
            found.append(pick(*(value[:, 0] for value in self.forward(x[:, None], d, None))).cpu().numpy())
        return np.concatenate(found)

    def _tensor(self, array: np.ndarray) -> torch.Tensor:
        found = torch.from_numpy(np.ascontiguousarray(array)).to(self.device)
        dtype = next(iter(self.parameters.values())).dtype  # double in tests
        return found.to(dtype) if found.is_floating_point() else found


def tensors(values: dict[str, np.ndarray], device: str) -> Arrays:
    """Parameters that record gradients."""
    return {name: torch.tensor(value, device=device, requires_grad=True) for name, value in values.items()}


def gradients_of(total: torch.Tensor, parameters: Arrays) -> Arrays:
    """The gradient of each parameter that ``total`` depends on."""
    found = torch.autograd.grad(total, list(parameters.values()), allow_unused=True)
    return {name: value for name, value in zip(parameters, found, strict=True) if value is not None}


def middle_points(
    origins: torch.Tensor, directions: torch.Tensor, starts: torch.Tensor, ends: torch.Tensor
) -> torch.Tensor:
    """(R, S, 3), where the field is asked: rays (R, 3), bins (R, S)."""
    t = (starts + ends) / 2
    return origins[:, None] + t[..., None] * directions[:, None]
