"""Proposal sampling in torch: reference of :mod:`autonerf_lab.nerf.samplers.proposal`, and for CUDA."""

import numpy as np
import torch

from autonerf_lab.nerf import rendering
from autonerf_lab.nerf.encodings import hash_encode
from autonerf_lab.nerf.fields.torch_field import gradients_of, midpoints, tensors
from autonerf_lab.nerf.ray_batch import Arrays, Rays, Samples, Targets
from autonerf_lab.nerf.samplers.proposal import initial_values, is_due
from autonerf_lab.nerf.scene_box import SceneBox
from autonerf_lab.nerf.settings import ProposalSettings


class TorchProposalSampler:
    """The same sampler by autograd, on any device: the readable reference of the kernels."""

    def __init__(self, settings: ProposalSettings, box: SceneBox, rng: np.random.Generator, device: str) -> None:
        self.settings, self.box, self.device = settings, box, torch.device(device)
        self.grids, values = initial_values(settings, box, rng)
        self.parameters: Arrays = tensors(values, device)
        self.state = {"proposal_steps": np.zeros(1, np.int64)}

    def sample(self, rays: Rays, jitter: np.ndarray) -> Samples:
        """Place bins on rays; see :class:`~autonerf_lab.nerf.model.Sampler`."""
        s, p = self.settings, self.parameters
        shift = torch.from_numpy(jitter).to(self.device)
        rays_o, rays_d = (torch.from_numpy(a).to(self.device) for a in (rays.origins, rays.directions))
        edges = rendering.first_edges(s.near, s.far, s.turn, shift, s.proposal_samples[0])
        rounds = []
        for k, following in enumerate((*s.proposal_samples[1:], s.samples)):
            x = self.box.contract_tensor(midpoints(rays_o, rays_d, edges[:, :-1], edges[:, 1:])).flatten(0, 1)
            features = hash_encode(x, p[f"proposal_{k}_table"], self.grids[k])
            hidden = torch.relu(features @ p[f"proposal_{k}_0"][:, : features.shape[1]].T)
            raw = (hidden @ p[f"proposal_{k}_1"][0]).view(len(rays), edges.shape[1] - 1)
            weights = rendering.weights_from_density(rendering.density_from_raw(raw), edges[:, :-1], edges[:, 1:])
            rounds.append((edges, weights))
            edges = rendering.resample(edges, weights, shift, s.histogram_padding, following)
        return Samples.between(edges.cpu().numpy(), (edges, rounds))

    def learn(
        self,
        rays: Rays,
        samples: Samples,
        targets: Targets,
        weights: np.ndarray,
        rng: np.random.Generator,
    ) -> tuple[Arrays, dict[str, float]]:
        """Return gradients and losses of the proposals; see :class:`~autonerf_lab.nerf.model.Sampler`."""
        if not is_due(self.state, self.settings):
            return {}, {}
        fine_edges, rounds = samples.record
        fine = torch.from_numpy(weights).to(self.device)
        loss = torch.stack([rendering.interlevel_loss(e, w, fine_edges, fine).mean() for e, w in rounds]).sum()
        return gradients_of(self.settings.interlevel_weight * loss, self.parameters), {"interlevel": loss.item()}
