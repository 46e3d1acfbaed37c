"""Semantic Nerfacto on RGB-D images: the same field, with samples around the measured surfaces and a depth loss."""

import numpy as np

from autonerf_lab.nerf.fields.hash_field import HashField
from autonerf_lab.nerf.model import Model, ModelSpec
from autonerf_lab.nerf.samplers.surface import SurfaceSampler
from autonerf_lab.nerf.scene_box import SceneBox
from autonerf_lab.nerf.settings import SurfaceSettings

SETTINGS = {
    "smoke": SurfaceSettings(
        steps=120, rays=1024, levels=6, log2_entries=14, table_rate=10.0, label_distance=0.0, seen_rays=60_000
    ),
    "fast": SurfaceSettings(steps=3400, final_learning_rate=5e-3, averaged=0.2),
    "paper": SurfaceSettings(
        steps=30_000,
        rays=4096,
        rays_by_class=0.0,
        table_rate=1.0,
        min_weight=0.0,
        samples=24,
        evaluation_samples=48,
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
    settings: SurfaceSettings, box: SceneBox, frames: int, classes: int, rng: np.random.Generator, device: str | None
) -> Model:
    """Build the model with fused kernels on the CPU, or with torch on ``device``."""
    sampler = SurfaceSampler(settings)
    if device is None:
        return Model(settings, box, HashField(settings, box, frames, classes, rng), sampler, frames)
    from autonerf_lab.nerf.fields.torch_hash_field import TorchHashField

    return Model(settings, box, TorchHashField(settings, box, frames, classes, rng, device), sampler, frames)


SPEC = ModelSpec(SETTINGS, build)
