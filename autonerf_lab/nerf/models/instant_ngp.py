"""Instant-NGP (Müller et al. 2022) with a semantic head: hash field and occupancy grid."""

from dataclasses import replace
from typing import Any

import numpy as np

from autonerf_lab.nerf.fields.hash_field import HashField
from autonerf_lab.nerf.model import Model, ModelSpec
from autonerf_lab.nerf.samplers.occupancy import OccupancySampler
from autonerf_lab.nerf.scene_box import SceneBox
from autonerf_lab.nerf.settings import OccupancySettings

SETTINGS = {
    "smoke": OccupancySettings(
        steps=120, rays=1024, levels=6, log2_entries=14, table_rate=10.0, candidates=128, seen_rays=60_000
    ),
    "fast": OccupancySettings(steps=1800, rays_by_class=0.1, rays_by_contrast=0.5, rays_on_planes=0.04),
    "paper": OccupancySettings(
        steps=30_000,
        rays=4096,
        rays_by_class=0.0,
        floor_weight=0.0,
        distortion_weight=0.002,
        decay=0.95,
        table_rate=1.0,
        min_weight=0.0,
        samples=128,
        candidates=1024,
        reach=8.0,
        marched=128,
        cell=0.12,  # 128 cells over 15 m
        grid_warmup=256,
        levels=16,
        log2_entries=19,
        coarse=0.96,  # 16 to 2048 cells over 15 m
        fine=0.0075,
        semantic_layers=2,
        final_learning_rate=1e-4,
    ),
}


def build(
    settings: OccupancySettings, box: SceneBox, frames: int, classes: int, rng: np.random.Generator, device: str | None
) -> Model:
    """Build the model with fused kernels on the CPU, or with torch on ``device``."""
    if device is None:
        field = HashField(settings, box, frames, classes, rng)
        return Model(settings, box, field, OccupancySampler(settings, box, field), frames)
    from autonerf_lab.nerf.fields.torch_hash_field import TorchHashField
    from autonerf_lab.nerf.samplers.torch_occupancy import TorchOccupancySampler

    torch_field = TorchHashField(settings, box, frames, classes, rng, device)
    return Model(settings, box, torch_field, TorchOccupancySampler(settings, box, torch_field, device), frames)


SPEC = ModelSpec(SETTINGS, build)

# On RGB-D images: the grid knows from measured depth which cells are empty, and a depth loss shapes the density.
RGBD: dict[str, Any] = {
    "depth_weight": 2.25,
    "density_gain": 8.0,
    "cell": 0.06,
    "reach": 1.0,
    "marched": 24,
    "distortion_weight": 0.002,
    "label_distance": 1.0,
}
RGBD_SPEC = ModelSpec(
    {
        # The reach of `fast` was measured with its own steps only, and rays by contrast without depth only.
        "smoke": replace(SETTINGS["smoke"], **RGBD | {"label_distance": 0.0, "reach": 0.6}, steps=200),
        "fast": replace(SETTINGS["fast"], **RGBD, rays_by_class=0.2, rays_by_contrast=0.0),
        "paper": replace(SETTINGS["paper"], **RGBD),
    },
    build,
)
