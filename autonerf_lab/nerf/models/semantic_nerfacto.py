"""Semantic Nerfacto (section 3.2): hash field and proposal sampling, with a semantic head."""

import numpy as np

from autonerf_lab.nerf.fields.hash_field import HashField
from autonerf_lab.nerf.model import Model, ModelSpec
from autonerf_lab.nerf.samplers.proposal import ProposalSampler
from autonerf_lab.nerf.scene_box import SceneBox
from autonerf_lab.nerf.settings import ProposalSettings

SETTINGS = {
    "smoke": ProposalSettings(
        steps=120, rays=1024, samples=16, levels=6, log2_entries=14, table_rate=10.0, seen_rays=60_000
    ),
    "fast": ProposalSettings(
        rays_by_class=0.1, rays_by_contrast=0.5, rays_on_planes=0.04, final_learning_rate=5e-3, averaged=0.2
    ),
    "paper": ProposalSettings(
        steps=30_000,
        rays=4096,
        rays_by_class=0.0,
        floor_weight=0.0,
        table_rate=1.0,
        min_weight=0.0,
        samples=48,
        proposal_samples=(256, 96),
        proposal_every=5,
        proposal_levels=5,
        proposal_log2_entries=17,
        proposal_ratio=4.0,
        histogram_padding=0.01,
        levels=16,
        log2_entries=19,
        coarse=0.96,  # 16 to 2048 cells over 15 m
        fine=0.0075,
        semantic_layers=2,
        appearance=32,
        final_learning_rate=1e-4,
    ),
}


def build(
    settings: ProposalSettings, box: SceneBox, frames: int, classes: int, rng: np.random.Generator, device: str | None
) -> Model:
    """Build the model with fused kernels on the CPU, or with torch on ``device``."""
    if device is None:
        field, sampler = HashField(settings, box, frames, classes, rng), ProposalSampler(settings, box, rng)
        return Model(settings, box, field, sampler, frames)
    from autonerf_lab.nerf.fields.torch_hash_field import TorchHashField
    from autonerf_lab.nerf.samplers.torch_proposal import TorchProposalSampler

    torch_field = TorchHashField(settings, box, frames, classes, rng, device)
    return Model(settings, box, torch_field, TorchProposalSampler(settings, box, rng, device), frames)


SPEC = ModelSpec(SETTINGS, build)
