"""PPO of Stable-Baselines3 around the project's networks, in pieces that can be stopped and go on exactly."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from sb3_contrib import RecurrentPPO
from sb3_contrib.common.recurrent.policies import RecurrentActorCriticPolicy
from sb3_contrib.common.recurrent.type_aliases import RNNStates
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import DictRolloutBuffer
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import Schedule
from torch import Tensor

from autonerf_lab.policies.networks import RECURRENT
from autonerf_lab.training.settings import PolicySettings
from autonerf_lab.training.worker_pool import WorkerPool


class _Networked(BasePolicy):
    """A policy that is a network of this project, with Adam.

    Args:
        observation_space: of the view.
        action_space: of the view.
        lr_schedule: of the remaining share of the training.
        network: makes the network.
    """

    def __init__(
        self,
        observation_space: spaces.Space[Any],
        action_space: spaces.Space[Any],
        lr_schedule: Schedule,
        network: Callable[[], torch.nn.Module],
        use_sde: bool = False,
    ) -> None:
        BasePolicy.__init__(self, observation_space, action_space)  # that of an actor-critic would make other networks
        # Channels last: gradients of convolutions in half the time. (torch's annotations do not know the keyword.)
        self.network: torch.nn.Module = network().to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.optimizer = torch.optim.Adam(self.network.parameters(), lr=lr_schedule(1), eps=1e-5)


class NetworkPolicy(_Networked):
    """What PPO asks of a policy, answered by a network that returns a distribution and a value."""

    def forward(self, obs: Any, deterministic: bool = False) -> tuple[Tensor, Tensor, Tensor]:
        """Actions, values, log-probabilities."""
        chances, value = self.network(obs)
        actions = chances.mode if deterministic else chances.sample()
        return actions, value[:, None], chances.log_prob(actions)

    def evaluate_actions(self, obs: Any, actions: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Values, log-probabilities, entropies."""
        chances, value = self.network(obs)
        return value[:, None], chances.log_prob(actions), chances.entropy()

    def predict_values(self, obs: Any) -> Tensor:
        """Values, (B, 1)."""
        return self.network(obs)[1][:, None]

    def _predict(self, observation: Any, deterministic: bool = False) -> Tensor:
        return self.forward(observation, deterministic)[0]


class RecurrentNetworkPolicy(_Networked, RecurrentActorCriticPolicy):
    """What recurrent PPO asks of a policy: as :class:`NetworkPolicy`, with a memory that actor and critic share."""

    @property
    def lstm_actor(self) -> torch.nn.LSTM:  # type: ignore[override]
        """Whose shape the memory has."""
        lstm = self.network.lstm
        assert isinstance(lstm, torch.nn.LSTM)
        return lstm

    def forward(  # type: ignore[override]
        self, obs: Any, lstm_states: RNNStates, episode_starts: Tensor, deterministic: bool = False
    ) -> Any:
        """Actions, values, log-probabilities, memory."""
        chances, value, memory = self.network(obs, lstm_states.pi, episode_starts)
        actions = chances.mode if deterministic else chances.sample()
        return actions, value[:, None], chances.log_prob(actions), RNNStates(memory, memory)

    def evaluate_actions(  # type: ignore[override]
        self, obs: Any, actions: Tensor, lstm_states: RNNStates, episode_starts: Tensor
    ) -> Any:
        """Values, log-probabilities, entropies."""
        chances, value, _ = self.network(obs, lstm_states.pi, episode_starts)
        return value[:, None], chances.log_prob(actions), chances.entropy()

    def predict_values(  # type: ignore[override]
        self, obs: Any, lstm_states: tuple[Tensor, ...], episode_starts: Tensor
    ) -> Tensor:
        """Values, (B, 1)."""
        value: Tensor = self.network(obs, lstm_states, episode_starts)[1]
        return value[:, None]


class TimedBuffer(DictRolloutBuffer):
    """A rollout of decisions that take different times: what follows one is discounted by gamma ** duration.

    Advantages are those of Schulman et al. 2016, equation 16, for a semi-Markov process (Sutton et al. 1999).
    """

    durations: np.ndarray  # (rollout, environments), in decisions of full length; set while it fills

    def reset(self) -> None:
        """Begin a rollout."""
        super().reset()
        self.durations = np.ones((self.buffer_size, self.n_envs), np.float32)

    def compute_returns_and_advantage(self, last_values: Tensor, dones: np.ndarray) -> None:
        """Advantages, and returns as their sums with the values; ``last_values`` are those after the last decision."""
        values = np.concatenate([self.values, last_values.numpy(force=True).reshape(1, -1)])
        goes_on = 1 - np.concatenate([self.episode_starts[1:], dones[None]]).astype(np.float32)
        discount = self.gamma**self.durations * goes_on
        following = np.zeros(self.n_envs, np.float32)
        for k in reversed(range(self.buffer_size)):
            surprise = self.rewards[k] + discount[k] * values[k + 1] - values[k]
            following = surprise + discount[k] * self.gae_lambda * following
            self.advantages[k] = following
        self.returns = self.advantages + self.values


def make_ppo(
    pool: WorkerPool, network: Callable[[], torch.nn.Module], settings: PolicySettings, log: Path | None
) -> PPO | RecurrentPPO:
    """PPO with these settings, recurrent for a network with a memory; ``log`` is the folder of TensorBoard."""
    options: dict[str, Any] = {
        "learning_rate": lambda remaining: settings.lr * remaining,
        "n_steps": settings.rollout,
        "batch_size": settings.batch,
        "n_epochs": settings.epochs,
        "gamma": settings.gamma,
        "gae_lambda": settings.gae,
        "clip_range": settings.clip,
        "ent_coef": settings.entropy,
        "vf_coef": settings.value,
        "target_kl": settings.target_kl,
        "max_grad_norm": settings.max_grad_norm,
        "policy_kwargs": {"network": network},
        "tensorboard_log": None if log is None else str(log),
        "seed": settings.seed,
        "device": "cpu",
    }
    if settings.network["kind"] in RECURRENT:
        return RecurrentPPO(RecurrentNetworkPolicy, pool, **options)
    return PPO(NetworkPolicy, pool, rollout_buffer_class=TimedBuffer, **options)  # type: ignore[arg-type]


def network_of(ppo: PPO | RecurrentPPO) -> torch.nn.Module:
    """The network that is trained."""
    assert isinstance(ppo.policy, _Networked)
    return ppo.policy.network


def numbers(ppo: PPO | RecurrentPPO) -> dict[str, np.ndarray]:
    """Parameters of the network, and what Adam remembers of each."""
    network, optimizer = network_of(ppo), ppo.policy.optimizer
    found = {f"parameter/{name}": value.detach() for name, value in network.named_parameters()}
    for name, value in network.named_parameters():
        state = optimizer.state.get(value, {})
        found |= {f"adam/{name}/{key}": torch.as_tensor(kept) for key, kept in state.items()}
    return {name: value.numpy().copy() for name, value in found.items()}


def restore(ppo: PPO | RecurrentPPO, arrays: dict[str, np.ndarray]) -> None:
    """Undo :func:`numbers`.

    Raises:
        KeyError: a number is missing.
    """
    network, optimizer = network_of(ppo), ppo.policy.optimizer
    begun = any(name.startswith("adam/") for name in arrays)  # after imitation PPO has not
    with torch.no_grad():
        for name, value in network.named_parameters():
            value.copy_(torch.from_numpy(arrays[f"parameter/{name}"]))
            if begun:
                optimizer.state[value] = {
                    key: torch.from_numpy(arrays[f"adam/{name}/{key}"]) for key in ("step", "exp_avg", "exp_avg_sq")
                }
