"""Semantic NeRF (Zhi et al. 2021), the vanilla NeRF of the paper: one deep network, coarse and fine.

``paper`` has the published hyper-parameters and needs a GPU: 200,000 steps of 0.8 TFLOP. ``fast`` is the same
architecture with a quarter of the width, half of the rays and a third of the samples, for a few hundred steps. In a
minute it learns the rooms, their colours and large objects, but not textures and small objects.
"""

import numpy as np

from autonerf_lab.nerf.model import Model, ModelSpec
from autonerf_lab.nerf.scene_box import SceneBox
from autonerf_lab.nerf.settings import SemanticNerfSettings

SETTINGS = {
    "smoke": SemanticNerfSettings(
        steps=250, rays=256, width=32, coarse_samples=12, fine_samples=12, learning_rate=5e-3, final_learning_rate=1e-3
    ),
    "fast": SemanticNerfSettings(
        steps=450, rays=512, width=64, coarse_samples=24, fine_samples=32, learning_rate=5e-3, final_learning_rate=5e-4
    ),
    "paper": SemanticNerfSettings(
        steps=200_000, rays=1024, rays_by_class=0.0, learning_rate=5e-4, final_learning_rate=7.9e-5, warmup=0.0
    ),
}


def build(
    settings: SemanticNerfSettings,
    box: SceneBox,
    frames: int,
    classes: int,
    rng: np.random.Generator,
    device: str | None,
) -> Model:
    """Build the model in torch, on the CPU, too: matrix products dominate its run time."""
    from autonerf_lab.nerf.fields.frequency_field import FrequencyField
    from autonerf_lab.nerf.samplers.hierarchical import HierarchicalSampler

    where = device or "cpu"
    coarse = FrequencyField(settings, box, classes, rng, where, prefix="coarse_")
    fine = FrequencyField(settings, box, classes, rng, where)
    return Model(settings, box, fine, HierarchicalSampler(settings, coarse), frames)


SPEC = ModelSpec(SETTINGS, build)
