"""Imitation of shortest paths by a PointGoal policy, before PPO.

The policy is trained on the expert action of every step (DAgger: Ross et al. 2011). At first the environments execute
the expert's actions, so that goals are reached; then increasingly the policy's own, so that it learns to recover from
its errors.
"""

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import gymnasium
import msgspec
import numpy as np
import torch
from torch import Tensor, nn
from tqdm import tqdm

from autonerf_lab.errors import DataError
from autonerf_lab.policies.networks import RecurrentNetwork, batched
from autonerf_lab.policies.pointgoal import STOP
from autonerf_lab.training.checkpoint import load_training_state, read_checkpoint, training_state
from autonerf_lab.training.settings import PolicySettings
from autonerf_lab.utils.storage import write_arrays

STEPS, PASSES, LR = 32, 2, 1e-3  # STEPS is the length of backpropagation through time
GUIDED = 0.25  # share of the episodes after which the expert no longer acts
SAVE_EVERY = 60.0  # seconds between two checkpoints


@dataclass(frozen=True)
class ImitationHeader:
    """Header of the checkpoint of an imitation. The running episodes are repeated from their seeds and actions."""

    fingerprint: dict[str, Any]
    ended: Annotated[int, msgspec.Meta(ge=0)]  # episodes
    seeds: list[Annotated[int, msgspec.Meta(ge=0, lt=1 << 31)]]
    actions: list[list[Annotated[int, msgspec.Meta(ge=0, lt=STOP)]]]
    generator: dict[str, Any]  # state of the NumPy generator
    seconds: float


class _RepeatableEpisode:
    """Running episode of an environment that records its seed and actions."""

    def __init__(self, env: gymnasium.Env) -> None:
        self.env, self.seed = env, 0
        self.actions: list[int] = []

    def reset(self, seed: int) -> dict[str, np.ndarray]:
        self.seed, self.actions = seed, []
        observation: dict[str, np.ndarray] = self.env.reset(seed=seed)[0]
        return observation

    def step(self, action: int) -> tuple[dict[str, np.ndarray], float, bool]:
        """Apply an action; return observation, reward and the end of the episode."""
        self.actions.append(action)
        observation, reward, terminated, truncated, _ = self.env.step(action)
        return observation, float(reward), terminated or truncated

    def repeat(self, seed: int, actions: list[int]) -> dict[str, np.ndarray]:
        """Begin an episode and apply actions; return the last observation."""
        observation = self.reset(seed)
        for action in actions:
            observation = self.step(action)[0]
        return observation


class Imitation:
    """State of an imitation: network, Adam, random generators and running episodes.

    Args:
        network: network, trained in place.
        make: makes an environment.
        settings: settings of the training.
    """

    def __init__(self, network: RecurrentNetwork, make: Callable[[], gymnasium.Env], settings: PolicySettings) -> None:
        self.network, self.settings, count = network, settings, settings.environments
        self.rng = np.random.default_rng([settings.seed, 73])
        torch.manual_seed(self._seed())
        self.episodes = [_RepeatableEpisode(make()) for _ in range(count)]
        self.observations = [episode.reset(self._seed()) for episode in self.episodes]
        self.starts, self.memory = torch.ones(count), network.initial_state(count)
        self.optimizer = torch.optim.Adam(network.parameters(), lr=LR)
        self.ended, self.seconds = 0, 0.0
        self._started = time.perf_counter()

    def _seed(self) -> int:
        return int(self.rng.integers(2**31))

    def _tensors(self) -> dict[str, Tensor]:
        hidden, cell = self.memory
        return {"starts": self.starts, "hidden": hidden, "cell": cell, "generator": torch.get_rng_state()}

    def save(self, path: Path, fingerprint: dict[str, Any]) -> None:
        """Write the checkpoint."""
        arrays = training_state(self.network, self.optimizer)
        seeds, actions = zip(*((episode.seed, episode.actions) for episode in self.episodes), strict=True)
        header = ImitationHeader(
            fingerprint, self.ended, list(seeds), list(actions), dict(self.rng.bit_generator.state),
            self.seconds + time.perf_counter() - self._started,
        )  # fmt: skip
        arrays |= {name: value.numpy() for name, value in self._tensors().items()}
        write_arrays(path, arrays, asdict(header))

    def resume(self, path: Path, fingerprint: dict[str, Any]) -> None:
        """Load the checkpoint, if there is one.

        Raises:
            RunFolderError: the checkpoint belongs to a training with other settings.
            DataError: the checkpoint is damaged.
        """
        found = read_checkpoint(path, fingerprint, ImitationHeader)
        if found is None:
            return
        arrays, header = found
        try:
            load_training_state(self.network, self.optimizer, arrays)
            tensors = {name: torch.from_numpy(arrays[name]) for name in self._tensors()}
            for name, like in self._tensors().items():
                if tensors[name].shape != like.shape or tensors[name].dtype != like.dtype:
                    raise ValueError(f"{name} is not {tuple(like.shape)} numbers of type {like.dtype}")
                if not torch.isfinite(tensors[name]).all():
                    raise ValueError(f"{name} is not finite")
            self.starts, self.memory = tensors["starts"], (tensors["hidden"], tensors["cell"])
            self.ended, self.seconds = header.ended, header.seconds
            self.rng.bit_generator.state = header.generator
            self.observations = [
                episode.repeat(seed, actions)
                for episode, seed, actions in zip(self.episodes, header.seeds, header.actions, strict=True)
            ]
            torch.set_rng_state(tensors["generator"])
        except (KeyError, TypeError, ValueError, OverflowError, RuntimeError) as error:
            raise DataError(f"{path} is damaged ({error!r}); remove it to start the training again") from error

    def advance(self) -> int:
        """Make STEPS steps in every environment and train on them; return the number of episodes that ended."""
        share = self.ended / self.settings.demonstrations
        initial, steps = self.memory, []
        for _ in range(STEPS):
            batch = batched(self.observations)
            with torch.inference_mode():
                distribution, _, self.memory = self.network(batch, self.memory, self.starts)
            expert = np.array([e.env.unwrapped.expert_action() for e in self.episodes])  # type: ignore[attr-defined]
            actions = distribution.sample().numpy()
            # The expert decides about *stop*: a wrong stop would end the episode early.
            guided = (self.rng.random(len(actions)) < 1 - share / GUIDED) | (expert == STOP) | (actions == STOP)
            actions = np.where(guided, expert, actions)
            rewards, over = np.zeros(len(actions), np.float32), np.zeros(len(actions), np.float32)
            for k, episode in enumerate(self.episodes):
                self.observations[k], rewards[k], over[k] = episode.step(int(actions[k]))
                if over[k]:
                    self.observations[k] = episode.reset(self._seed())
            arrays = torch.from_numpy(expert), torch.from_numpy(rewards), torch.from_numpy(over)
            steps.append((batch, self.starts, *arrays))
            self.starts = torch.from_numpy(over)
        with torch.inference_mode():
            next_value = self.network(batched(self.observations), self.memory, self.starts)[1]
        for _ in range(PASSES):
            _update(self.network, self.optimizer, LR * (1 - share), initial, steps, next_value, self.settings)
        ended = int(sum(float(step[4].sum()) for step in steps))
        self.ended += ended
        return ended


def imitate_shortest_paths(
    network: RecurrentNetwork,
    make: Callable[[], gymnasium.Env],
    settings: PolicySettings,
    path: Path,
    fingerprint: dict[str, Any],
    progress: bool = False,
) -> float:
    """Train actor and critic until ``settings.demonstrations`` episodes have ended, or resume from the checkpoint.

    Args:
        network: network, trained in place.
        make: makes a :class:`~autonerf_lab.envs.pointgoal.PointGoalEnv`, with or without wrappers.
        settings: settings of the training.
        path: file of the checkpoint.
        fingerprint: policy, settings and inputs of the training, to recognise its checkpoint.
        progress: show a progress bar.

    Returns:
        Seconds of the calls that were interrupted.

    Raises:
        RunFolderError: the checkpoint belongs to a training with other settings.
        DataError: the checkpoint is damaged.
    """
    imitation, total = Imitation(network, make, settings), settings.demonstrations
    imitation.resume(path, fingerprint)
    saved = time.perf_counter()
    with tqdm(
        total=total, initial=imitation.ended, desc="imitate shortest paths", unit="episode", disable=not progress
    ) as bar:
        while imitation.ended < total:
            bar.update(imitation.advance())
            if time.perf_counter() - saved >= SAVE_EVERY:
                imitation.save(path, fingerprint)
                saved = time.perf_counter()
    return imitation.seconds


def _update(
    network: RecurrentNetwork,
    optimizer: torch.optim.Optimizer,
    lr: float,
    initial: tuple[Tensor, Tensor],
    steps: list[tuple[dict[str, Tensor], Tensor, Tensor, Tensor, Tensor]],
    next_value: Tensor,
    settings: PolicySettings,
) -> None:
    """Make one gradient step: log-likelihood of the expert actions, squared error of the values."""
    batches, starts, expert, rewards, over = zip(*steps, strict=True)
    returns = []
    for reward, end in zip(reversed(rewards), reversed(over), strict=True):
        next_value = reward + settings.gamma * (1 - end) * next_value
        returns.append(next_value)
    # The network takes the sequences one after the other.
    obs = {name: torch.stack([batch[name] for batch in batches], dim=1).flatten(0, 1) for name in batches[0]}
    flat = [torch.stack(part, dim=1).flatten() for part in (starts, expert, returns[::-1])]
    distribution, value, _ = network(obs, initial, flat[0])
    loss = settings.value * ((value - flat[2]) ** 2).mean() - distribution.log_prob(flat[1]).mean()
    for group in optimizer.param_groups:
        group["lr"] = lr
    optimizer.zero_grad()
    loss.backward()
    nn.utils.clip_grad_norm_(network.parameters(), settings.max_grad_norm)
    optimizer.step()
