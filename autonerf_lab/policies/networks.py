"""The networks of the learned policies: from what a view shows to a distribution of actions, and a value."""

from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.distributions import Categorical, Distribution, Independent, Normal

from autonerf_lab.policies.egocentric import EgocentricView
from autonerf_lab.policies.views import HEADINGS, CompactView, PaperView
from autonerf_lab.types import Action

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


class EgocentricNetwork(nn.Module):
    """Three encoders, a recurrent layer, actions and value; as Ramakrishnan et al. 2021, small enough for two cores.

    Args:
        memory: units of the recurrent layer (an LSTM: what sb3-contrib trains).

    Example:
        >>> space = EgocentricView.observation_space
        >>> seen = {name: torch.zeros(6, *part.shape) for name, part in space.items()}
        >>> network = EgocentricNetwork()
        >>> actions, value, memory = network(seen, network.nothing(2), torch.zeros(6))  # two sequences of three steps
        >>> actions.sample().shape, value.shape, memory[0].shape
        (torch.Size([6]), torch.Size([6]), torch.Size([1, 2, 256]))
    """

    def __init__(self, memory: int = 256) -> None:
        super().__init__()
        relu, flat = nn.ReLU(), nn.Flatten()
        self.image = nn.Sequential(
            *(nn.Conv2d(3, 16, 8, stride=4), relu, nn.Conv2d(16, 32, 4, stride=2), relu),
            *(nn.Conv2d(32, 32, 3), relu, flat, nn.Linear(32 * 7 * 7, 128), relu),
        )
        self.near, self.far = (
            nn.Sequential(
                *(nn.Conv2d(2, 16, 3, stride=2, padding=1), relu, nn.Conv2d(16, 32, 3, stride=2, padding=1), relu),
                *(nn.Conv2d(32, 32, 3), relu, flat, nn.Linear(32 * 6 * 6, 128), relu),
            )
            for _ in range(2)
        )
        self.lstm = nn.LSTM(3 * 128 + EgocentricView.FELT, memory)
        self.actor = nn.Linear(memory, len(Action))
        self.critic = nn.Linear(memory, 1)
        nn.init.zeros_(self.actor.weight)  # before training all actions are equally likely
        nn.init.zeros_(self.actor.bias)

    def nothing(self, sequences: int) -> tuple[Tensor, Tensor]:
        """The memory before an episode."""
        return (torch.zeros(1, sequences, self.lstm.hidden_size),) * 2  # type: ignore[return-value]

    def forward(
        self, seen: dict[str, Tensor], memory: tuple[Tensor, Tensor], starts: Tensor
    ) -> tuple[Distribution, Tensor, tuple[Tensor, Tensor]]:
        """Steps of S sequences of equal length, one sequence after the other, B steps in all.

        Args:
            seen: of B steps.
            memory: two of (1, S, memory), from before each sequence.
            starts: (B,), 1 where an episode begins: only at the first step of a sequence.

        Returns:
            Categorical over B actions; values, (B,); the memory after each sequence.
        """
        maps = [encode(seen[name].float() / 255) for name, encode in (("near", self.near), ("far", self.far))]
        x = torch.cat([self.image(seen["rgb"].float() / 255), *maps, seen["felt"].float()], dim=1)
        sequences = memory[0].shape[1]
        kept = (1 - starts.reshape(sequences, -1)[:, 0])[None, :, None]
        before = (kept * memory[0], kept * memory[1])
        steps, after = self.lstm(x.reshape(sequences, -1, x.shape[1]).swapaxes(0, 1), before)
        x = steps.swapaxes(0, 1).flatten(0, 1)
        return Categorical(logits=self.actor(x), validate_args=False), self.critic(x)[:, 0], after


def draw(chances: Distribution, rng: np.random.Generator) -> Any:
    """One action of a distribution over a batch of one."""
    if isinstance(chances, Categorical):
        shares = chances.probs[0].double().numpy()
        return rng.choice(len(shares), p=shares / shares.sum())
    mean, deviation = chances.mean[0].numpy(), chances.stddev[0].numpy()
    return mean + deviation * rng.standard_normal(mean.shape)


def make_network(settings: dict[str, Any]) -> tuple[Any, nn.Module]:
    """The view and the fresh network of settings: a dict with the ``kind``, compact, paper or egocentric, and options.

    Example:
        >>> view, network = make_network({"kind": "paper", "window": 48, "viewpoints": True})
        >>> view.channels
        48
    """
    options = {name: value for name, value in settings.items() if name != "kind"}
    if settings["kind"] == "compact":
        return CompactView(**options), CompactNetwork()
    if settings["kind"] == "egocentric":
        return EgocentricView(), EgocentricNetwork(**options)
    view = PaperView(**options)
    return view, PaperNetwork(view.window, view.channels)
