"""The networks of the modular policies: from what a view shows to a distribution of waypoints, and a value."""

import torch
from torch import Tensor, nn
from torch.distributions import Categorical, Distribution, Independent, Normal

from autonerf_lab.policies.views import HEADINGS, CompactView

_IMPOSSIBLE = -1e4  # logit of a block that holds no place


class CompactNetwork(nn.Module):
    """Convolutions at the resolution of the blocks; a place is judged by what lies around it, wherever that is.

    The heading enters as two coordinates of every block, metres ahead of the robot and to its left: what a turn costs.
    Before training all places are equally likely.

    Args:
        width: channels.

    Example:
        >>> seen = {name: torch.zeros(2, *space.shape) for name, space in CompactView().observation_space.items()}
        >>> blocks, value = CompactNetwork()(seen)
        >>> blocks.sample().shape, value.shape
        (torch.Size([2]), torch.Size([2]))
    """

    def __init__(self, width: int = 32) -> None:
        super().__init__()
        self.first = nn.Conv2d(CompactView.CHANNELS + CompactView.REACH + 2, width, 3, padding=1)
        self.body = nn.ModuleList(nn.Conv2d(width, width, 3, padding=d, dilation=d) for d in (2, 4, 1))
        self.score = nn.Conv2d(width + CompactView.REACH + 3, 1, 1)
        self.critic = nn.Sequential(nn.Linear(2 * width, 128), nn.ReLU(), nn.Linear(128, 1))
        nn.init.zeros_(self.score.weight)
        self.north: Tensor
        self.east: Tensor
        middle = (torch.arange(CompactView.GRID) + 0.5) / CompactView.GRID * 2 - 1
        self.register_buffer("north", middle[:, None].expand(CompactView.GRID, CompactView.GRID), persistent=False)
        self.register_buffer("east", middle[None].expand(CompactView.GRID, CompactView.GRID), persistent=False)

    def forward(self, seen: dict[str, Tensor]) -> tuple[Distribution, Tensor]:
        """Categorical over B x 1024 blocks, and the value, (B,)."""
        cos, sin = seen["heading"].float()[:, :, None, None].unbind(1)
        sides = torch.stack([cos * self.east + sin * self.north, cos * self.north - sin * self.east], dim=1)
        reach = seen["reach"].float()
        x = torch.relu(self.first(torch.cat([seen["map"].float(), reach, sides], dim=1)))
        for layer in self.body:
            x = x + torch.relu(layer(x))
        there = reach[:, :1] > 0
        # What is gained for the way is the first thing to learn: no need to find it through convolutions.
        worth = reach[:, 2:5] / (reach[:, 1:2] + 0.1)
        scores = self.score(torch.cat([x, reach, worth], dim=1))
        logits = torch.where(there, scores, torch.full_like(scores, _IMPOSSIBLE)).flatten(1)
        inside = x * there
        pooled = torch.cat([inside.sum((2, 3)) / there.sum((2, 3)).clamp_min(1), inside.amax((2, 3))], dim=1)
        return Categorical(logits=logits, validate_args=False), self.critic(pooled)[:, 0]


class PaperNetwork(nn.Module):
    """The global policy of the paper and its released code: a Gaussian over the window.

    Args:
        window: cells a side of the view's window.
        channels: of the view's map.

    Example:
        >>> seen = {"map": torch.zeros(1, 24, 48, 48), "heading": torch.zeros(1)}
        >>> PaperNetwork(48)(seen)[0].sample().shape
        torch.Size([1, 2])
    """

    def __init__(self, window: int = 240, channels: int = 24) -> None:
        super().__init__()
        pool = nn.MaxPool2d(2)
        layers: list[nn.Module] = [pool]
        for width in (32, 64, 128):
            layers += [nn.Conv2d(channels, width, 3, padding=1), nn.ReLU(), pool]
            channels = width
        layers += [nn.Conv2d(128, 64, 3, padding=1), nn.ReLU(), nn.Conv2d(64, 32, 3, padding=1), nn.ReLU()]
        self.maps = nn.Sequential(*layers, nn.Flatten())
        self.heading = nn.Embedding(HEADINGS, 8)
        self.body = nn.Sequential(
            nn.Linear(32 * (window // 16) ** 2 + 8, 256), nn.ReLU(), nn.Linear(256, 256), nn.ReLU()
        )
        self.mean = nn.Linear(256, 2)
        self.log_std = nn.Parameter(torch.zeros(2))
        self.critic = nn.Linear(256, 1)

    def forward(self, seen: dict[str, Tensor]) -> tuple[Distribution, Tensor]:
        """Gaussian over (B, 2) actions, and the value, (B,)."""
        heading = self.heading(seen["heading"].long().reshape(-1))
        x = self.body(torch.cat([self.maps(seen["map"].float()), heading], dim=1))
        return Independent(Normal(self.mean(x), self.log_std.exp()), 1, validate_args=False), self.critic(x)[:, 0]
