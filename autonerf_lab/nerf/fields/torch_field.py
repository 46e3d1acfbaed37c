"""Fields by autograd, on any device: a subclass defines ``forward`` and may override ``loss``.

This is the readable reference of the fused kernels, the implementation for CUDA, and the base class of custom fields.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
from torch.nn import functional

from autonerf_lab.nerf import rendering
from autonerf_lab.nerf.ray_batch import Arrays, Rays, RenderOutput, Samples, Targets, TrainOutput
from autonerf_lab.nerf.settings import Settings

DOWN = (0.0, 0.0, -1.0)  # viewing direction of queries that do not depend on it


class RenderedTensors(NamedTuple):
    """Rendered values of R rays with S samples, differentiable."""

    color: torch.Tensor  # (R, 3) without background
    logits: torch.Tensor  # (R, C)
    weights: torch.Tensor  # (R, S)
    left: torch.Tensor  # (R,) transmittance behind the last bin
    starts: torch.Tensor  # (R, S) distances of the bins, metres
    ends: torch.Tensor  # (R, S)
    raw: torch.Tensor  # (R, S) log densities before :func:`~autonerf_lab.nerf.rendering.density_from_raw`


class TorchField(ABC):
    """Density, colour and class at points, by autograd.

    A custom loss needs no training loop of its own. For example, a penalty on transparent rays::

        class OpaqueField(TorchHashField):
            def loss(self, rendered, targets):
                total, losses = super().loss(rendered, targets)
                losses["transparency"] = rendered.left.mean()
                return total + 0.01 * losses["transparency"], losses

    Args:
        settings: loss weights.
        values: initial parameters by name.
        device: a torch device.
    """

    def __init__(self, settings: Settings, values: dict[str, np.ndarray], device: str) -> None:
        self.settings, self.device = settings, torch.device(device)
        if self.device.type == "cpu":
            self.rays_at_once = 256  # their values stay in the cache of a core
        self.parameters: Arrays = tensors(values, device)

    @abstractmethod
    def forward(
        self, points: torch.Tensor, directions: torch.Tensor, frames: torch.Tensor | None
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Evaluate the field at points on rays.

        Args:
            points: (R, S, 3) in the coordinates of the field, metres.
            directions: (R, 3) unit, from the camera into the scene.
            frames: (R,) training image of each ray; None for rays that belong to no image.

        Returns:
            raw (R, S), converted to a density by :func:`~autonerf_lab.nerf.rendering.density_from_raw`; color
            (R, S, 3) in [0, 1]; logits (R, S, C).
        """

    def loss(self, rendered: RenderedTensors, targets: Targets) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        """Compute the training loss: squared colour error, distortion, and cross entropy and depth error if used.

        Args:
            rendered: values of the rays; ``color`` includes a random background.
            targets: ground truth of the rays, numpy; :meth:`tensor` moves arrays to the field's device.

        Returns:
            the scalar to minimise, and the mean losses by name, which are logged; ``mse`` must be among them.
        """
        s = self.settings
        squared = (rendered.color - self.tensor(targets.color)) ** 2
        if targets.importance is not None:
            squared = squared * self.tensor(targets.importance)[:, None]
        losses = {
            "mse": squared.mean(),
            "distortion": rendering.distortion_loss(rendered.weights, rendered.starts, rendered.ends, s.turn).mean(),
        }
        total = losses["mse"] + s.distortion_weight * losses["distortion"]
        if rendered.logits.shape[1]:
            labels = self.tensor(targets.labels)
            entropy = functional.cross_entropy(rendered.logits, labels.clamp(min=0), reduction="none") * (labels >= 0)
            entropy = entropy if targets.trust is None else entropy * self.tensor(targets.trust)
            losses["cross_entropy"] = entropy.mean()
            losses["class_accuracy"] = (rendered.logits.argmax(dim=1) == labels).float().mean()
            total = total + s.semantic_weight * losses["cross_entropy"]
        if s.distance_weight:
            measured = self.tensor(targets.depth)
            losses["depth"] = rendering.surface_loss(rendered.raw, rendered.starts, rendered.ends, measured, s).mean()
            total = total + s.distance_weight * losses["depth"]
        return total, losses

    def train(
        self, rays: Rays, samples: Samples, targets: Targets, rng: np.random.Generator, ray_gradients: bool
    ) -> TrainOutput:
        """Return losses and gradients of a batch; see :class:`~autonerf_lab.nerf.model.Field`."""
        background = self.tensor(rng.random((len(rays), 3), dtype=np.float32))
        origins, directions = (self.tensor(a).requires_grad_(ray_gradients) for a in (rays.origins, rays.directions))
        rendered = self._render(origins, directions, rays.frames, samples)
        rendered = rendered._replace(color=rendered.color + rendered.left[:, None] * background)
        total, losses = self.loss(rendered, targets)
        wrt = self.parameters | ({"origins": origins, "directions": directions} if ray_gradients else {})
        gradients = gradients_of(total, wrt)
        d_rays = [gradients.pop(name).cpu().numpy() for name in ("origins", "directions") if ray_gradients]
        values = {name: loss.item() for name, loss in losses.items()}
        return TrainOutput(gradients, values, rendered.weights.detach().cpu().numpy(), *d_rays)

    @torch.no_grad()
    def render(self, rays: Rays, samples: Samples) -> RenderOutput:
        """Render rays; see :class:`~autonerf_lab.nerf.model.Field`."""
        origins, directions = self.tensor(rays.origins), self.tensor(rays.directions)
        r = self._render(origins, directions, rays.frames, samples)
        depth = rendering.median_depth(r.weights, r.starts, r.ends)
        return RenderOutput(*(value.cpu().numpy() for value in (r.color, r.logits, depth, r.weights)))

    def raw_density(self, points: torch.Tensor) -> torch.Tensor:
        """Return the first output of :meth:`forward` at (R, S, 3) points; override it where that costs less."""
        return self.forward(points, points.new_tensor(DOWN).expand(len(points), 3), None)[0]

    @torch.no_grad()
    def weights(self, rays: Rays, samples: Samples) -> np.ndarray:
        """Return the (R, S) weights of samples, as :meth:`render` does, without colours and classes."""
        starts, ends = self.tensor(samples.starts), self.tensor(samples.ends)
        raw = self.raw_density(midpoints(self.tensor(rays.origins), self.tensor(rays.directions), starts, ends))
        return rendering.weights_from_density(rendering.density_from_raw(raw), starts, ends).cpu().numpy()

    def density(self, points: np.ndarray) -> np.ndarray:
        """Return densities at points; see :class:`~autonerf_lab.nerf.model.Field`."""
        return self._query(points, None, lambda x, d: rendering.density_from_raw(self.raw_density(x)))

    def color(self, points: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Return colours at points; see :class:`~autonerf_lab.nerf.model.Field`."""
        return self._query(points, directions, lambda x, d: self.forward(x, d, None)[1])

    def logits(self, points: np.ndarray) -> np.ndarray:
        """Return class logits at points; see :class:`~autonerf_lab.nerf.model.Field`."""
        return self._query(points, None, lambda x, d: self.forward(x, d, None)[2])

    def ray_gradients(
        self, rays: Rays, samples: Samples, target: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return errors and gradients of rays; see :class:`~autonerf_lab.nerf.model.Field`."""
        origins, directions = (self.tensor(a).requires_grad_() for a in (rays.origins, rays.directions))
        color = self._render(origins, directions, rays.frames, samples).color
        error = ((color - self.tensor(target)) ** 2).mean(dim=1)
        d_o, d_d = torch.autograd.grad(error.sum(), (origins, directions))
        return error.detach().cpu().numpy(), d_o.cpu().numpy(), d_d.cpu().numpy()

    def tensor(self, array: np.ndarray) -> torch.Tensor:
        """Return an array as a tensor on the field's device; floats get the dtype of the parameters."""
        found = torch.from_numpy(np.ascontiguousarray(array)).to(self.device)
        dtype = next(iter(self.parameters.values())).dtype  # double in tests
        return found.to(dtype) if found.is_floating_point() else found

    def _render(
        self, origins: torch.Tensor, directions: torch.Tensor, frames: np.ndarray | None, samples: Samples
    ) -> RenderedTensors:
        starts, ends = self.tensor(samples.starts), self.tensor(samples.ends)
        points = midpoints(origins, directions, starts, ends)
        images = None if frames is None else self.tensor(frames)
        raw, color, logits = self.forward(points, directions, images)
        weights = rendering.weights_from_density(rendering.density_from_raw(raw), starts, ends)
        color, logits = rendering.composite(weights, color), rendering.composite(weights, logits)
        return RenderedTensors(color, logits, weights, 1 - weights.sum(dim=1), starts, ends, raw)

    @torch.no_grad()
    def _query(
        self, points: np.ndarray, directions: np.ndarray | None, evaluate: Callable[..., torch.Tensor]
    ) -> np.ndarray:
        """Evaluate the field at (N, 3) points in chunks: ``evaluate`` gets (n, 1, 3) points and (n, 3) directions."""
        if directions is None:
            directions = np.broadcast_to(np.array(DOWN), (len(points), 3))
        found, size = [], 1 << (13 if self.device.type == "cpu" else 16)
        for first in range(0, max(len(points), 1), size):
            chunk = slice(first, first + size)
            x, d = (self.tensor(np.asarray(a[chunk], np.float32)) for a in (points, directions))
            found.append(evaluate(x[:, None], d)[:, 0].cpu().numpy())
        return np.concatenate(found)


def tensors(values: dict[str, np.ndarray], device: str) -> Arrays:
    """Return parameters as tensors that record gradients."""
    return {name: torch.tensor(value, device=device, requires_grad=True) for name, value in values.items()}


def gradients_of(total: torch.Tensor, parameters: Arrays) -> Arrays:
    """Return the gradient of each parameter on which ``total`` depends."""
    found = torch.autograd.grad(total, list(parameters.values()), allow_unused=True)
    return {name: value for name, value in zip(parameters, found, strict=True) if value is not None}


def midpoints(
    origins: torch.Tensor, directions: torch.Tensor, starts: torch.Tensor, ends: torch.Tensor
) -> torch.Tensor:
    """Return the (R, S, 3) bin midpoints, for rays (R, 3) and bins (R, S)."""
    t = (starts + ends) / 2
    return origins[:, None] + t[..., None] * directions[:, None]
