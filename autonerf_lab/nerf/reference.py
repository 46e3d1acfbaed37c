"""Semantic Nerfacto in plain torch: one readable function from parameters to losses, for CUDA, tests and comparison.

It reads the same parameters, takes the same steps and returns the same losses as
:class:`autonerf_lab.nerf.nerfacto.SemanticNerfacto`, which does the work on the CPU with fused kernels.
"""

from dataclasses import dataclass

import torch
from torch.nn import functional

from autonerf_lab.nerf import rendering
from autonerf_lab.nerf.encodings import HashGrid, hash_encode, spherical_harmonics
from autonerf_lab.nerf.nerfacto import SemanticNerfacto

Parameters = dict[str, torch.Tensor]


@dataclass(frozen=True)
class Rendered:
    """What a batch of rays shows, with what the losses need."""

    color: torch.Tensor  # (R, 3), without background
    logits: torch.Tensor  # (R, C)
    depth: torch.Tensor  # (R,) median distance, metres
    weights: torch.Tensor  # (R, S)
    edges: torch.Tensor  # (R, S + 1)
    proposals: list[tuple[torch.Tensor, torch.Tensor]]  # (edges, weights) of each round


def parameters_of(model: SemanticNerfacto, device: str = "cpu", dtype: torch.dtype = torch.float32) -> Parameters:
    """Copies of the model's parameters that record gradients."""
    return {
        name: torch.tensor(value, device=device, dtype=dtype, requires_grad=True)
        for name, value in model.parameters.items()
    }


def contract(model: SemanticNerfacto, points: torch.Tensor) -> torch.Tensor:
    """:meth:`SceneBox.contract`, differentiable."""
    box = model.box
    u = (points - torch.as_tensor(box.center).to(points)) / torch.as_tensor(box.half).to(points)
    beyond = u.abs() - 1
    squeezed = u.sign() * (1 + box.shell - box.shell**2 / (beyond.clamp(min=0) + box.shell))
    return (torch.where(beyond > 0, squeezed, u) / (1 + box.shell) + 1) / 2


def geometry(model: SemanticNerfacto, p: Parameters, points: torch.Tensor) -> torch.Tensor:
    """(sigma, h_d) = f_d(h(x)): (N, 3) world points -> (N, 16), the log density first."""
    x = hash_encode(contract(model, points), p["table"], model.grid)
    return functional.relu(x @ p["density_0"].T) @ p["density_1"].T


def proposal_log_density(
    model: SemanticNerfacto, p: Parameters, k: int, grid: HashGrid, points: torch.Tensor
) -> torch.Tensor:
    """(N, 3) -> (N,), the small network of proposal round k."""
    x = hash_encode(contract(model, points), p[f"proposal_{k}_table"], grid)
    return (functional.relu(x @ p[f"proposal_{k}_0"].T) @ p[f"proposal_{k}_1"].T)[:, 0]


def render(
    model: SemanticNerfacto,
    p: Parameters,
    rays_o: torch.Tensor,
    rays_d: torch.Tensor,
    appearance: torch.Tensor,
    jitter: torch.Tensor,
) -> Rendered:
    """Rays (R, 3), unit directions, embeddings (R, E), jitter (R,) -> everything that is rendered."""
    s = model.settings
    edges = rendering.first_edges(s.near, s.far, s.turn, jitter, s.proposal_samples[0])
    proposals = []
    for k, (grid, following) in enumerate(zip(model.proposal_grids, (*s.proposal_samples[1:], s.samples), strict=True)):
        raw = proposal_log_density(model, p, k, grid, middles(rays_o, rays_d, edges).detach()).view(len(edges), -1)
        weights = rendering.weights_from_density(rendering.density_from_raw(raw), edges)
        proposals.append((edges, weights))
        edges = rendering.resample(edges, weights, jitter, s.padding / weights.shape[1], following)
    shape = edges.shape[0], s.samples
    g = geometry(model, p, middles(rays_o, rays_d, edges))
    features = torch.cat([spherical_harmonics(rays_d), appearance], dim=1)
    hidden = g @ p["color_geometry"].T + (features @ p["color_ray"].T).repeat_interleave(s.samples, dim=0)
    hidden = functional.relu(functional.relu(hidden) @ p["color_1"].T)
    color = torch.sigmoid(hidden @ p["color_2"][:3].T)
    logits = functional.relu(g @ p["semantic_0"].T) @ p["semantic_1"].T
    weights = rendering.weights_from_density(rendering.density_from_raw(g[:, 0]).view(shape), edges)
    return Rendered(
        rendering.composite(weights, color.view(*shape, 3)),
        rendering.composite(weights, logits.view(*shape, -1)),
        rendering.median_depth(weights, edges),
        weights,
        edges,
        proposals,
    )


def losses(
    model: SemanticNerfacto,
    rendered: Rendered,
    target: torch.Tensor,
    labels: torch.Tensor,
    background: torch.Tensor,
) -> dict[str, torch.Tensor]:
    """Mean losses without their factors; rays with a negative label count as zero entropy."""
    left = 1 - rendered.weights.sum(dim=1, keepdim=True)
    entropy = functional.cross_entropy(rendered.logits, labels.clamp(min=0), reduction="none") * (labels >= 0)
    interlevel = sum(
        rendering.interlevel_loss(edges, weights, rendered.edges, rendered.weights).mean()
        for edges, weights in rendered.proposals
    )
    return {
        "mse": ((rendered.color + left * background - target) ** 2).mean(),
        "cross_entropy": entropy.mean(),
        "distortion": rendering.distortion_loss(rendered.weights, rendered.edges, model.settings.turn).mean(),
        "interlevel": torch.as_tensor(interlevel),
    }


def total_loss(model: SemanticNerfacto, terms: dict[str, torch.Tensor]) -> torch.Tensor:
    """The weighted sum that is trained."""
    s = model.settings
    return (
        terms["mse"]
        + s.semantic_weight * terms["cross_entropy"]
        + s.distortion_weight * terms["distortion"]
        + s.interlevel_weight * terms["interlevel"]
    )


def middles(rays_o: torch.Tensor, rays_d: torch.Tensor, edges: torch.Tensor) -> torch.Tensor:
    """(R * S, 3) bin middles."""
    t = (edges[:, 1:] + edges[:, :-1]) / 2
    return (rays_o[:, None] + t[..., None] * rays_d[:, None]).reshape(-1, 3)
