"""LPIPS weights with random values."""

import numpy as np

# (number in torchvision's list, channels in, channels out) of the convolutions, by stage
CONVOLUTIONS = (
    ((0, 3, 64), (2, 64, 64)),
    ((5, 64, 128), (7, 128, 128)),
    ((10, 128, 256), (12, 256, 256), (14, 256, 256)),
    ((17, 256, 512), (19, 512, 512), (21, 512, 512)),
    ((24, 512, 512), (26, 512, 512), (28, 512, 512)),
)


def random_weights() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    arrays = {}
    for stage, layers in enumerate(CONVOLUTIONS):
        for k, before, after in layers:
            spread = np.sqrt(2 / (9 * before))
            arrays[f"features.{k}.weight"] = spread * rng.standard_normal((after, before, 3, 3), np.float32)
            arrays[f"features.{k}.bias"] = 0.1 * rng.standard_normal(after, np.float32)
        arrays[f"lin{stage}.model.1.weight"] = rng.random((1, after, 1, 1), np.float32)
    return arrays
