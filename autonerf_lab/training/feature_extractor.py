"""Features extractor for the stock policies of Stable-Baselines3.

The default extractor of ``MultiInputPolicy`` flattens maps, which gives networks of many millions of parameters.
"""

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.preprocessing import get_flattened_obs_dim, is_image_space
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import Tensor, nn

_DEPTH_SCALE = 5.0  # metres, range of the depth sensor


class MapFeaturesExtractor(BaseFeaturesExtractor):
    """Small convolutional network for each map and image of a dict observation; other entries are concatenated.

    Suitable for all environments of this package. With the default ``AutoNeRF/Explore-v0`` it has less than half a
    million parameters.

    Args:
        observation_space: dict of boxes (C, H, W) or (H, W), and of small vectors or discrete values.
        features: number of features of each map and image.

    Example:
        >>> import gymnasium
        >>> from stable_baselines3 import PPO
        >>> env = gymnasium.make("AutoNeRF/Explore-v0", scene="train-00", size=16, rgb=False)
        >>> options = {"features_extractor_class": MapFeaturesExtractor}
        >>> ppo = PPO("MultiInputPolicy", env, n_steps=64, policy_kwargs=options, device="cpu")
        >>> sum(parameter.numel() for parameter in ppo.policy.parameters()) < 500_000
        True
    """

    def __init__(self, observation_space: spaces.Dict, features: int = 64) -> None:
        encoders: dict[str, nn.Module] = {}
        scales: dict[str, float] = {}
        size = 0
        for name, space in observation_space.spaces.items():
            if isinstance(space, spaces.Box) and len(space.shape) in (2, 3) and min(space.shape[-2:]) > 4:
                encoders[name] = _encoder(space.shape[0] if len(space.shape) == 3 else 1, features)
                scales[name] = _scale(space)
                size += features
            else:
                size += get_flattened_obs_dim(space)
        super().__init__(observation_space, size)
        self._scales = scales
        self.encoders = nn.ModuleDict(encoders)

    def forward(self, observations: dict[str, Tensor]) -> Tensor:
        """Encode a batch of observations, (B, features)."""
        parts = []
        for name, value in observations.items():
            if name in self.encoders:
                image = value.float() if value.dim() == 4 else value.float()[:, None]
                parts.append(self.encoders[name](image / self._scales[name]))
            else:
                parts.append(value.float().flatten(1))
        return torch.cat(parts, dim=1)


def _encoder(channels: int, features: int) -> nn.Sequential:
    return nn.Sequential(
        *(nn.Conv2d(channels, 16, 5, stride=2, padding=2), nn.ReLU()),
        *(nn.Conv2d(16, 32, 3, stride=2, padding=1), nn.ReLU()),
        *(nn.Conv2d(32, 32, 3, stride=2, padding=1), nn.ReLU()),
        *(nn.AdaptiveAvgPool2d(4), nn.Flatten(), nn.Linear(32 * 4 * 4, features), nn.ReLU()),
    )


def _scale(space: spaces.Box) -> float:
    """Return the divisor that brings an image to about [0, 1]; Stable-Baselines3 scales color images itself."""
    if is_image_space(space, check_channels=False, normalized_image=False):
        return 1.0
    return float(space.high.max()) if np.issubdtype(space.dtype, np.integer) else _DEPTH_SCALE
