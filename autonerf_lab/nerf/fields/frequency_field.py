"""Field of Semantic NeRF (Zhi et al. 2021): one deep network on a frequency encoding of the position."""

import numpy as np
import torch

from autonerf_lab.nerf.encodings import frequencies
from autonerf_lab.nerf.fields.hash_encoder import he_uniform
from autonerf_lab.nerf.fields.torch_field import TorchField
from autonerf_lab.nerf.scene_box import SceneBox
from autonerf_lab.nerf.settings import SemanticNerfSettings


class FrequencyField(TorchField):
    """Density, colour and class at points; the semantic head does not depend on the direction.

    Args:
        settings: sizes of the network.
        box: contracts the world into a cube; positions in this cube are encoded.
        classes: number of classes, 0 for a field without semantics.
        rng: random generator of the initial values.
        device: a torch device.
        prefix: prefix of the parameter names, for models with two such fields.
    """

    settings: SemanticNerfSettings

    def __init__(
        self,
        settings: SemanticNerfSettings,
        box: SceneBox,
        classes: int,
        rng: np.random.Generator,
        device: str,
        prefix: str = "",
    ) -> None:
        s, self.box, self.prefix = settings, box, prefix
        position, direction = 3 + 6 * s.position_frequencies, 3 + 6 * s.direction_frequencies
        shapes = {}
        for k in range(s.layers):
            inputs = position if k == 0 else s.width + (position if k == s.skip + 1 else 0)
            shapes[f"trunk_{k}"] = (s.width, inputs)
        shapes |= {
            "density": (1, s.width),
            "feature": (s.width, s.width),
            "color_0": (s.width // 2, s.width + direction),
            "color_1": (3, s.width // 2),
            "semantic_0": (s.width // 2 if classes else 0, s.width),
            "semantic_1": (classes, s.width // 2 if classes else 0),
        }
        values = {}
        for name, (rows, columns) in shapes.items():
            values[f"{prefix}{name}"] = he_uniform((rows, columns), rng)
            values[f"{prefix}{name}_bias"] = np.zeros(rows, np.float32)
        super().__init__(settings, values, device)

    def forward(
        self, points: torch.Tensor, directions: torch.Tensor, frames: torch.Tensor | None
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Evaluate the network at points on rays; see the base class."""
        s, h = self.settings, self._trunk(points)
        raw = self._layer("density", h)[..., 0]
        logits = self._layer("semantic_1", torch.relu(self._layer("semantic_0", h)))
        d = frequencies(directions, s.direction_frequencies) * (1.0 if s.view_dependent else 0.0)
        feature = torch.cat([self._layer("feature", h), d[:, None].expand(*h.shape[:2], -1)], dim=-1)
        color = torch.sigmoid(self._layer("color_1", torch.relu(self._layer("color_0", feature))))
        return raw, color, logits

    def raw_density(self, points: torch.Tensor) -> torch.Tensor:
        """Evaluate the density only; see the base class."""
        return self._layer("density", self._trunk(points))[..., 0]

    def _trunk(self, points: torch.Tensor) -> torch.Tensor:
        s = self.settings
        x = frequencies(2 * self.box.contract_tensor(points) - 1, s.position_frequencies).flatten(0, 1)
        h = x  # flat: autograd copies a view that is changed in place
        for k in range(s.layers):
            h = self._layer(f"trunk_{k}", torch.cat([x, h], dim=-1) if k == s.skip + 1 else h).relu_()
        return h.unflatten(0, points.shape[:2])

    def _layer(self, name: str, x: torch.Tensor) -> torch.Tensor:
        p = self.parameters
        return torch.nn.functional.linear(x, p[f"{self.prefix}{name}"], p[f"{self.prefix}{name}_bias"])
