"""Hierarchical sampling (Mildenhall et al. 2020, section 5.2): a coarse field places the fine bins."""

import numpy as np
import torch

from autonerf_lab.nerf import rendering
from autonerf_lab.nerf.fields.torch_field import TorchField
from autonerf_lab.nerf.ray_batch import Arrays, Rays, Samples, Targets
from autonerf_lab.nerf.settings import SemanticNerfSettings

PADDING = 1e-5  # added to every weight


class HierarchicalSampler:
    """Regular bins for the coarse field (of equal length up to ``turn``); the field adds bins where these have weight.

    Args:
        settings: number of bins.
        coarse: trained on the same targets; its parameter names must differ from those of the field.
    """

    def __init__(self, settings: SemanticNerfSettings, coarse: TorchField) -> None:
        self.settings, self.coarse = settings, coarse
        self.parameters = coarse.parameters
        self.state: dict[str, np.ndarray] = {}

    def sample(self, rays: Rays, jitter: np.ndarray) -> Samples:
        """Place bins on rays; see :class:`~autonerf_lab.nerf.model.Sampler`."""
        s, shift = self.settings, torch.from_numpy(jitter)
        edges = rendering.first_edges(s.near, s.far, s.turn, shift, s.coarse_samples)
        regular = Samples.between(edges.numpy())
        weights = torch.from_numpy(self.coarse.weights(rays, regular))
        finer = rendering.resample(edges, weights, shift, PADDING, s.fine_samples + 1)
        every = torch.cat([edges, finer[:, 1:-1]], dim=1).sort(dim=1).values
        return Samples.between(every.numpy(), regular)

    def learn(
        self,
        rays: Rays,
        samples: Samples,
        targets: Targets,
        weights: np.ndarray,
        rng: np.random.Generator,
    ) -> tuple[Arrays, dict[str, float]]:
        """Train the coarse field; see :class:`~autonerf_lab.nerf.model.Sampler`."""
        output = self.coarse.train(rays, samples.record, targets, rng, False)
        return output.gradients, {"coarse_mse": output.losses["mse"]}
