"""The networks of the learned policies: from what a view shows to a distribution of actions, and a value."""

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.distributions import Categorical, Distribution, Independent, Normal

from autonerf_lab.policies.egocentric import EgocentricView
from autonerf_lab.policies.interfaces import HEADINGS, CompactView, PaperView
from autonerf_lab.policies.pointgoal import STOP, GoalView
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

    SHARPNESS = 16.0  # to prefer one of hundreds of places takes scores far apart, and Adam's steps are short

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
        scores = self.SHARPNESS * self.score(torch.cat([x, reach, worth], dim=1))
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


class RecurrentNetwork(nn.Module):
    """A recurrent layer over what a subclass makes of each step; then actions and a value."""

    def add_memory(self, inputs: int, memory: int, actions: int) -> None:
        """The layer (an LSTM: what sb3-contrib trains) over ``inputs`` features of a step, and what reads it."""
        self.lstm = nn.LSTM(inputs, memory)
        self.actor = nn.Linear(memory, actions)
        self.critic = nn.Linear(memory, 1)
        nn.init.zeros_(self.actor.weight)  # before training all actions are equally likely
        nn.init.zeros_(self.actor.bias)

    def features(self, seen: dict[str, Tensor]) -> Tensor:
        """(B, inputs), of B steps."""
        raise NotImplementedError

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
            starts: (B,), 1 where an episode begins.

        Returns:
            Categorical over B actions; values, (B,); the memory after each sequence.
        """
        x = self.features(seen)
        sequences = memory[0].shape[1]
        steps = x.reshape(sequences, -1, x.shape[1]).swapaxes(0, 1)
        begins = starts.reshape(sequences, -1).T  # (steps, S)
        # the layer runs as far as nobody forgets
        cuts = [0, *(1 + torch.nonzero(begins[1:].any(dim=1)).flatten()).tolist(), len(steps)]
        outputs = []
        for first, last in itertools.pairwise(cuts):
            kept = (1 - begins[first])[None, :, None]
            output, memory = self.lstm(steps[first:last], (kept * memory[0], kept * memory[1]))
            outputs.append(output)
        x = torch.cat(outputs).swapaxes(0, 1).flatten(0, 1)
        return Categorical(logits=self.actor(x), validate_args=False), self.critic(x)[:, 0], memory


class EgocentricNetwork(RecurrentNetwork):
    """Three encoders, a recurrent layer, actions and value; as Ramakrishnan et al. 2021, small enough for two cores.

    Args:
        memory: units of the recurrent layer.

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
        self.image = _image_encoder(3, 32 * 7 * 7)
        self.near, self.far = (
            nn.Sequential(
                *(nn.Conv2d(2, 16, 3, stride=2, padding=1), relu, nn.Conv2d(16, 32, 3, stride=2, padding=1), relu),
                *(nn.Conv2d(32, 32, 3), relu, flat, nn.Linear(32 * 6 * 6, 128), relu),
            )
            for _ in range(2)
        )
        self.add_memory(3 * 128 + EgocentricView.FELT, memory, len(Action))

    def features(self, seen: dict[str, Tensor]) -> Tensor:
        """Image, both maps and what was felt."""
        maps = [encode(seen[name].float() / 255) for name, encode in (("near", self.near), ("far", self.far))]
        return torch.cat([self.image(seen["rgb"].float() / 255), *maps, seen["felt"].float()], dim=1)


class GoalNetwork(RecurrentNetwork):
    """Depth and goal to actions: a small sibling of the PointGoal agents of Habitat (Savva et al. 2019).

    Args:
        memory: units of the recurrent layer.

    Example:
        >>> seen = {name: torch.zeros(6, *part.shape) for name, part in GoalView().observation_space.items()}
        >>> network = GoalNetwork()
        >>> network(seen, network.nothing(2), torch.zeros(6))[0].probs[0].tolist()
        [0.25, 0.25, 0.25, 0.25]
    """

    FAR = 10.0  # metres that count as one

    def __init__(self, memory: int = 256) -> None:
        super().__init__()
        self.image = _image_encoder(1, 32 * 4 * 4)
        self.goal = nn.Sequential(nn.Linear(4, 32), nn.ReLU())
        self.add_memory(128 + 32, memory, STOP + 1)

    def features(self, seen: dict[str, Tensor]) -> Tensor:
        """Image and goal; distances near and far both matter."""
        distance, direction = seen["goal"][:, :1].float(), seen["goal"][:, 1:].float()
        goal = torch.cat([distance / self.FAR, torch.exp(-distance), direction], dim=1)
        return torch.cat([self.image(seen["depth"].float()[:, None]), self.goal(goal)], dim=1)


RECURRENT: dict[str, type[RecurrentNetwork]] = {"egocentric": EgocentricNetwork, "goal": GoalNetwork}


def _image_encoder(channels: int, flat: int) -> nn.Sequential:
    """Mnih et al. 2015, half as wide; ``flat`` values are left after the convolutions."""
    relu = nn.ReLU()
    return nn.Sequential(
        *(nn.Conv2d(channels, 16, 8, stride=4), relu, nn.Conv2d(16, 32, 4, stride=2), relu),
        *(nn.Conv2d(32, 32, 3), relu, nn.Flatten(), nn.Linear(flat, 128), relu),
    )


def batched(seen: Sequence[dict[str, np.ndarray]]) -> dict[str, Tensor]:
    """Observations as a network takes them.

    Example:
        >>> batched([{"goal": np.zeros(3)}, {"goal": np.ones(3)}])["goal"].shape
        torch.Size([2, 3])
    """
    return {name: torch.from_numpy(np.stack([one[name] for one in seen])) for name in seen[0]}


def draw(chances: Distribution, rng: np.random.Generator, row: int = 0) -> Any:
    """An action of a row of a distribution over a batch."""
    if isinstance(chances, Categorical):
        shares = chances.probs[row].double().numpy()
        return rng.choice(len(shares), p=shares / shares.sum())
    mean, deviation = chances.mean[row].numpy(), chances.stddev[row].numpy()
    return mean + deviation * rng.standard_normal(mean.shape)


def make_view(settings: dict[str, Any]) -> Any:
    """The view of the settings of a network.

    Example:
        >>> make_view({"kind": "compact", "follow": 25}).follow
        25
    """
    kinds = {"compact": CompactView, "paper": PaperView, "egocentric": EgocentricView, "goal": GoalView}
    recurrent = settings["kind"] in RECURRENT  # whose options are the network's
    return kinds[settings["kind"]](**({} if recurrent else _options(settings)))


def make_network(settings: dict[str, Any]) -> tuple[Any, nn.Module]:
    """The view and the fresh network of settings: a dict with the ``kind`` and options.

    Example:
        >>> view, network = make_network({"kind": "paper", "window": 48, "viewpoints": True})
        >>> view.channels
        48
    """
    view = make_view(settings)
    if isinstance(view, CompactView):
        return view, CompactNetwork()
    if settings["kind"] in RECURRENT:
        return view, RECURRENT[settings["kind"]](**_options(settings))
    return view, PaperNetwork(view.window, view.channels)


def _options(settings: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in settings.items() if name != "kind"}
