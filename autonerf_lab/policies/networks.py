"""Networks of the learned policies: from an encoded observation to a distribution over actions and a value."""

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.distributions import Categorical, Distribution, Independent, Normal

from autonerf_lab.policies.egocentric import EgocentricInterface
from autonerf_lab.policies.interfaces import HEADING_BINS, CompactInterface
from autonerf_lab.policies.pointgoal import STOP
from autonerf_lab.types import Action

_CHUNK = 100  # observations that are encoded together; the images of a larger batch would not stay in the cache
_INVALID = -1e4  # logit of a block without a candidate position


class CompactNetwork(nn.Module):
    """Fully convolutional network for :class:`~autonerf_lab.policies.interfaces.CompactInterface`.

    The heading enters as two coordinates of every block in the robot's frame, ahead and left, which determine the cost
    of a turn. Before training all candidate positions are equally likely.

    Args:
        width: number of channels.

    Example:
        >>> space = CompactInterface().observation_space
        >>> obs = {name: torch.zeros(2, *part.shape) for name, part in space.items()}
        >>> blocks, value = CompactNetwork()(obs)
        >>> blocks.sample().shape, value.shape
        (torch.Size([2]), torch.Size([2]))
    """

    SHARPNESS = 16.0  # scale of the logits: a preference among hundreds of candidates needs large differences

    def __init__(self, width: int = 32) -> None:
        super().__init__()
        self.first = nn.Conv2d(CompactInterface.CHANNELS + CompactInterface.REACH + 2, width, 3, padding=1)
        self.body = nn.ModuleList(nn.Conv2d(width, width, 3, padding=d, dilation=d) for d in (2, 4, 1))
        self.score = nn.Conv2d(width + CompactInterface.REACH + 3, 1, 1)
        self.critic = nn.Sequential(nn.Linear(2 * width, 128), nn.ReLU(), nn.Linear(128, 1))
        nn.init.zeros_(self.score.weight)
        self.north: Tensor
        self.east: Tensor
        middle = (torch.arange(CompactInterface.GRID) + 0.5) / CompactInterface.GRID * 2 - 1
        self.register_buffer(
            "north", middle[:, None].expand(CompactInterface.GRID, CompactInterface.GRID), persistent=False
        )
        self.register_buffer(
            "east", middle[None].expand(CompactInterface.GRID, CompactInterface.GRID), persistent=False
        )

    def forward(self, obs: dict[str, Tensor]) -> tuple[Distribution, Tensor]:
        """Return a Categorical over 1024 blocks, batch shape (B,), and the values, (B,)."""
        logits, values = zip(*(self._evaluate(chunk) for chunk in chunks(obs)), strict=True)
        return Categorical(logits=torch.cat(logits), validate_args=False), torch.cat(values)

    def _evaluate(self, obs: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
        """Return the logits, (B, 1024), and the values, (B,)."""
        cos, sin = obs["heading"].float()[:, :, None, None].unbind(1)
        sides = torch.stack([cos * self.east + sin * self.north, cos * self.north - sin * self.east], dim=1)
        reach = obs["reach"].float()
        x = torch.relu(self.first(torch.cat([obs["map"].float(), reach, sides], dim=1)))
        for layer in self.body:
            x = x + torch.relu(layer(x))
        valid = reach[:, :1] > 0
        # Gain per path length is given to the network directly, because it is the most useful feature.
        worth = reach[:, 2:5] / (reach[:, 1:2] + 0.1)
        scores = self.SHARPNESS * self.score(torch.cat([x, reach, worth], dim=1))
        logits = torch.where(valid, scores, torch.full_like(scores, _INVALID)).flatten(1)
        masked = x * valid
        pooled = torch.cat([masked.sum((2, 3)) / valid.sum((2, 3)).clamp_min(1), masked.amax((2, 3))], dim=1)
        return logits, self.critic(pooled)[:, 0]


class PaperNetwork(nn.Module):
    """Global policy of the paper and its released code: a Gaussian over the window.

    Args:
        window: cells a side of the window of :class:`~autonerf_lab.policies.interfaces.PaperInterface`.
        channels: channels of its map.

    Example:
        >>> obs = {"map": torch.zeros(1, 24, 48, 48), "heading": torch.zeros(1)}
        >>> PaperNetwork(48)(obs)[0].sample().shape
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
        self.heading = nn.Embedding(HEADING_BINS, 8)
        self.body = nn.Sequential(
            nn.Linear(32 * (window // 16) ** 2 + 8, 256), nn.ReLU(), nn.Linear(256, 256), nn.ReLU()
        )
        self.mean = nn.Linear(256, 2)
        self.log_std = nn.Parameter(torch.zeros(2))
        self.critic = nn.Linear(256, 1)

    def forward(self, obs: dict[str, Tensor]) -> tuple[Distribution, Tensor]:
        """Return a Gaussian over (B, 2) actions and the values, (B,)."""
        heading = self.heading(obs["heading"].long().reshape(-1))
        x = self.body(torch.cat([self.maps(obs["map"].float()), heading], dim=1))
        return Independent(Normal(self.mean(x), self.log_std.exp()), 1, validate_args=False), self.critic(x)[:, 0]


class RecurrentNetwork(nn.Module):
    """LSTM over the features of each step, which a subclass defines, with an actor and a critic."""

    def add_memory(self, inputs: int, memory: int, actions: int) -> None:
        """Create the LSTM over ``inputs`` features (the layer that sb3-contrib trains), the actor and the critic."""
        self.lstm = nn.LSTM(inputs, memory)
        self.actor = nn.Linear(memory, actions)
        self.critic = nn.Linear(memory, 1)
        nn.init.zeros_(self.actor.weight)  # before training all actions are equally likely
        nn.init.zeros_(self.actor.bias)

    def features(self, obs: dict[str, Tensor]) -> Tensor:
        """Return the features of B steps, (B, inputs)."""
        raise NotImplementedError

    def initial_state(self, sequences: int) -> tuple[Tensor, Tensor]:
        """Return the recurrent state at the start of an episode, zeros, for a number of sequences."""
        return (torch.zeros(1, sequences, self.lstm.hidden_size),) * 2  # type: ignore[return-value]

    def forward(
        self, obs: dict[str, Tensor], memory: tuple[Tensor, Tensor], starts: Tensor
    ) -> tuple[Distribution, Tensor, tuple[Tensor, Tensor]]:
        """Evaluate S sequences of equal length, concatenated to B steps.

        Args:
            obs: observations of B steps.
            memory: recurrent state before each sequence, two tensors (1, S, memory).
            starts: (B,), 1 where an episode begins.

        Returns:
            A Categorical with batch shape (B,), the values, (B,), and the recurrent state after each sequence.
        """
        x = torch.cat([self.features(chunk) for chunk in chunks(obs)])
        sequences = memory[0].shape[1]
        steps = x.reshape(sequences, -1, x.shape[1]).swapaxes(0, 1)
        begins = starts.reshape(sequences, -1).T  # (steps, S)
        # Run the LSTM up to the next episode boundary.
        cuts = [0, *(1 + torch.nonzero(begins[1:].any(dim=1)).flatten()).tolist(), len(steps)]
        outputs = []
        for first, last in itertools.pairwise(cuts):
            continues = (1 - begins[first])[None, :, None]
            output, memory = self.lstm(steps[first:last], (continues * memory[0], continues * memory[1]))
            outputs.append(output)
        x = torch.cat(outputs).swapaxes(0, 1).flatten(0, 1)
        return Categorical(logits=self.actor(x), validate_args=False), self.critic(x)[:, 0], memory


class EgocentricNetwork(RecurrentNetwork):
    """Recurrent network of the end-to-end policies, after Ramakrishnan et al. 2021, reduced for two CPU cores.

    Args:
        memory: units of the LSTM.

    Example:
        >>> space = EgocentricInterface.observation_space
        >>> obs = {name: torch.zeros(6, *part.shape) for name, part in space.items()}
        >>> network = EgocentricNetwork()
        >>> actions, value, memory = network(obs, network.initial_state(2), torch.zeros(6))  # 2 sequences of 3 steps
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
        self.add_memory(3 * 128 + EgocentricInterface.FELT, memory, len(Action))

    def features(self, obs: dict[str, Tensor]) -> Tensor:
        """Encode the image, both maps, the last action and its collision flag."""
        maps = [encode(obs[name].float() / 255) for name, encode in (("near", self.near), ("far", self.far))]
        return torch.cat([self.image(obs["rgb"].float() / 255), *maps, obs["felt"].float()], dim=1)


class GoalNetwork(RecurrentNetwork):
    """Recurrent network of the PointGoal policy, a small version of the agents of Habitat (Savva et al. 2019).

    Args:
        memory: units of the LSTM.

    Example:
        >>> from autonerf_lab.policies.pointgoal import GoalInterface
        >>> obs = {name: torch.zeros(6, *part.shape) for name, part in GoalInterface().observation_space.items()}
        >>> network = GoalNetwork()
        >>> network(obs, network.initial_state(2), torch.zeros(6))[0].probs[0].tolist()
        [0.25, 0.25, 0.25, 0.25]
    """

    FAR = 10.0  # metres, unit of the distance

    def __init__(self, memory: int = 256) -> None:
        super().__init__()
        self.image = _image_encoder(1, 32 * 4 * 4)
        self.goal = nn.Sequential(nn.Linear(4, 32), nn.ReLU())
        self.add_memory(128 + 32, memory, STOP + 1)

    def features(self, obs: dict[str, Tensor]) -> Tensor:
        """Encode the depth image and the goal; a linear and an exponential term resolve far and near distances."""
        distance, direction = obs["goal"][:, :1].float(), obs["goal"][:, 1:].float()
        goal = torch.cat([distance / self.FAR, torch.exp(-distance), direction], dim=1)
        return torch.cat([self.image(obs["depth"].float()[:, None]), self.goal(goal)], dim=1)


def _image_encoder(channels: int, flat: int) -> nn.Sequential:
    """Image encoder of Mnih et al. 2015, half as wide; ``flat`` is the output size of the convolutions."""
    relu = nn.ReLU()
    return nn.Sequential(
        *(nn.Conv2d(channels, 16, 8, stride=4), relu, nn.Conv2d(16, 32, 4, stride=2), relu),
        *(nn.Conv2d(32, 32, 3), relu, nn.Flatten(), nn.Linear(flat, 128), relu),
    )


def chunks(obs: dict[str, Tensor]) -> list[dict[str, Tensor]]:
    """Split a batch of encoded observations into batches of at most 100.

    Example:
        >>> [len(chunk["goal"]) for chunk in chunks({"goal": torch.zeros(220, 3)})]
        [100, 100, 20]
    """
    parts = {name: value.split(_CHUNK) for name, value in obs.items()}
    return [dict(zip(parts, chunk, strict=True)) for chunk in zip(*parts.values(), strict=True)]


def batched(observations: Sequence[dict[str, np.ndarray]]) -> dict[str, Tensor]:
    """Stack encoded observations to the batch that a network takes.

    Example:
        >>> batched([{"goal": np.zeros(3)}, {"goal": np.ones(3)}])["goal"].shape
        torch.Size([2, 3])
    """
    return {name: torch.from_numpy(np.stack([obs[name] for obs in observations])) for name in observations[0]}


def sample_action(distribution: Distribution, rng: np.random.Generator, row: int = 0) -> Any:
    """Sample an action from one row of a batched distribution, with NumPy's random numbers."""
    if isinstance(distribution, Categorical):
        probabilities = distribution.probs[row].double().numpy()
        return rng.choice(len(probabilities), p=probabilities / probabilities.sum())
    mean, deviation = distribution.mean[row].numpy(), distribution.stddev[row].numpy()
    return mean + deviation * rng.standard_normal(mean.shape)
