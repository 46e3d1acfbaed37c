"""Hierarchical sampling (Mildenhall et al. 2020, section 5.2): a coarse field on even bins says where to look again."""

import numpy as np
import torch

from autonerf_lab.nerf import rendering
from autonerf_lab.nerf.fields.torch_field import TorchField
from autonerf_lab.nerf.model import Field
from autonerf_lab.nerf.ray_batch import Arrays, Rays, Samples, Targets
from autonerf_lab.nerf.settings import SemanticNerfSettings

PADDING = 1e-5  # added to every weight


class HierarchicalSampler:
    """Even bins for the coarse field (of equal length up to ``turn``), and finer ones besides for the field itself.

    Args:
        settings: number of bins.
        coarse: learns from the same targets; its parameters' names differ from the field's.
    """

    def __init__(self, settings: SemanticNerfSettings, coarse: TorchField) -> None:
        self.settings, self.coarse = settings, coarse
        self.parameters = coarse.parameters
        self.state: dict[str, np.ndarray] = {}

    def sample(self, rays: Rays, jitter: np.ndarray) -> Samples:
        s, shift = self.settings, torch.from_numpy(jitter)
        edges = rendering.first_edges(s.near, s.far, s.turn, shift, s.coarse_samples)
        even = Samples.between(edges.numpy())
        weights = torch.from_numpy(self.coarse.render(rays, even).weights)
        finer = rendering.resample(edges, weights, shift, PADDING, s.fine_samples + 1)
        every = torch.cat([edges, finer[:, 1:-1]], dim=1).sort(dim=1).values
        return Samples.between(every.numpy(), even)

    def learn(
        self,
        rays: Rays,
        samples: Samples,
        targets: Targets,
        weights: np.ndarray,
        field: Field,
        rng: np.random.Generator,
    ) -> tuple[Arrays, dict[str, float]]:
        learned = self.coarse.train(rays, samples.record, targets, rng, False)
        return learned.gradients, {"coarse_mse": learned.losses["mse"]}
