"""Semantic NeRF (Zhi et al. 2021), the paper's vanilla field: one deep network, coarse and fine.

``paper`` has its hyper-parameters and wants a GPU: 200,000 steps of 0.8 TFLOP. ``fast`` is the same architecture with a
quarter of the width, half of the rays and a third of the samples, for a few hundred steps: it learns the rooms, their
colours and large objects in a minute, and gives up what takes a network this deep hours, texture and small things.
"""

import numpy as np

from autonerf_lab.nerf.fields.frequency_field import FrequencyField
from autonerf_lab.nerf.model import Model, ModelSpec
from autonerf_lab.nerf.samplers.hierarchical import HierarchicalSampler
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
    """Torch everywhere: its time goes into matrix products."""
    where = device or "cpu"
    coarse = FrequencyField(settings, box, classes, rng, where, prefix="coarse_")
    fine = FrequencyField(settings, box, classes, rng, where)
    return Model(settings, box, fine, HierarchicalSampler(settings, coarse), frames)


SPEC = ModelSpec(SETTINGS, build)
