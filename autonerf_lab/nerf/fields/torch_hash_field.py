"""Hash encoding and small networks in torch: reference of :mod:`autonerf_lab.nerf.fields.hash_field`, and for CUDA."""

from collections.abc import Callable

import numpy as np
import torch

from autonerf_lab.nerf.encodings import hash_encode
from autonerf_lab.nerf.fields.hash_field import build_grid, initial_parameters
from autonerf_lab.nerf.fields.torch_field import TorchField
from autonerf_lab.nerf.scene_box import SceneBox
from autonerf_lab.nerf.settings import HashSettings
from autonerf_lab.nerf.spherical_harmonics import spherical_harmonics


class TorchHashField(TorchField):
    """Field with the parameters and values of :class:`~autonerf_lab.nerf.fields.hash_field.HashField`, by autograd.

    Args:
        settings, box, frames, classes, rng: as for :class:`~autonerf_lab.nerf.fields.hash_field.HashField`.
        device: a torch device.
    """

    settings: HashSettings

    def __init__(
        self,
        settings: HashSettings,
        box: SceneBox,
        frames: int,
        classes: int,
        rng: np.random.Generator,
        device: str,
    ) -> None:
        self.grid, self.box = build_grid(settings, box), box
        super().__init__(settings, initial_parameters(settings, self.grid, frames, classes, rng), device)
        self._feature_weights = self.tensor(np.ones(2 * settings.levels, np.float32))

    def set_level_weights(self, weights_at: Callable[[int], np.ndarray]) -> None:
        """Weight the levels of the table; see :class:`~autonerf_lab.nerf.model.CoarseToFineField`."""
        self._feature_weights = self.tensor(np.repeat(weights_at(self.settings.levels), 2))

    def forward(
        self, points: torch.Tensor, directions: torch.Tensor, frames: torch.Tensor | None
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Evaluate the networks at points on rays; see the base class."""
        p = self.parameters
        x = hash_encode(self.box.contract_tensor(points).flatten(0, 1), p["table"], self.grid) * self._feature_weights
        weights = p["density_0"][:, : x.shape[1]]  # without the padding of the kernels
        geometry = (torch.relu(x @ weights.T) @ p["density_1"].T).unflatten(0, points.shape[:2])
        features = spherical_harmonics(directions)
        if not self.settings.view_dependent:
            features = features * (torch.arange(features.shape[1], device=features.device) == 0)
        if self.settings.appearance:
            table = p["appearance"]
            embedding = table.mean(dim=0).expand(len(directions), -1) if frames is None else table[frames]
            features = torch.cat([features, embedding], dim=1)
        hidden = torch.relu(geometry @ p["color_geometry"].T + (features @ p["color_ray"].T)[:, None])
        color = torch.sigmoid(torch.relu(hidden @ p["color_1"].T) @ p["color_2"][:3].T)
        semantic = torch.relu(geometry @ p["semantic_0"].T)
        if "semantic_middle" in p:
            semantic = torch.relu(semantic @ p["semantic_middle"].T)
        logits = semantic @ p["semantic_1"].T
        return self.settings.density_gain * geometry[..., 0], color, logits
