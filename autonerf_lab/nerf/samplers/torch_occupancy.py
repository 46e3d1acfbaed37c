"""Occupancy-grid sampling in torch: reference of :mod:`autonerf_lab.nerf.samplers.occupancy`, and for CUDA."""

import numpy as np
import torch

from autonerf_lab.nerf import rendering
from autonerf_lab.nerf.fields.torch_field import midpoints
from autonerf_lab.nerf.model import Field
from autonerf_lab.nerf.ray_batch import Rays, Samples
from autonerf_lab.nerf.samplers.occupancy import OccupancySampler
from autonerf_lab.nerf.scene_box import SceneBox
from autonerf_lab.nerf.settings import OccupancySettings


class TorchOccupancySampler(OccupancySampler):
    """The same sampler in torch, on any device: the readable reference of the kernel."""

    def __init__(self, settings: OccupancySettings, box: SceneBox, field: Field, device: str) -> None:
        super().__init__(settings, box, field)
        self.device = torch.device(device)

    def sample(self, rays: Rays, jitter: np.ndarray) -> Samples:
        """Place bins on rays; see :class:`~autonerf_lab.nerf.model.Sampler`."""
        s, density = self.settings, torch.from_numpy(self.state["occupancy"]).to(self.device)
        origins, directions, shift = (
            torch.from_numpy(a).to(self.device) for a in (rays.origins, rays.directions, jitter)
        )
        edges = rendering.first_edges(s.near, s.far, s.turn, shift, s.candidates)
        x = self.box.contract_tensor(midpoints(origins, directions, edges[:, :-1], edges[:, 1:]))
        size = torch.tensor(density.shape, device=self.device)
        cells = torch.minimum((x * size).long().clamp(min=0), size - 1)
        found = density[tuple(cells.unbind(-1))]
        threshold = min(s.occupied, density.mean().item())
        starts, ends = rendering.occupied_bins(edges, found, threshold, s.reach, shift, s.marched)
        marched = self.field_density(rays, Samples(starts.cpu().numpy(), ends.cpu().numpy()))
        starts, ends = rendering.visible_bins(starts, ends, torch.from_numpy(marched).to(self.device), shift, s.samples)
        return Samples(starts.cpu().numpy(), ends.cpu().numpy())
