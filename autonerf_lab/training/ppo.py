"""PPO of Stable-Baselines3 with the networks of :mod:`autonerf_lab.policies.networks`, and its training state."""

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

from autonerf_lab.policies.spec import spec_of
from autonerf_lab.training.settings import PolicySettings
from autonerf_lab.training.worker_pool import WorkerPool


class _NetworkBase(BasePolicy):
    """Stable-Baselines3 policy with a given network and Adam.

    Args:
        observation_space: observation space of the policy interface.
        action_space: action space of the policy interface.
        lr_schedule: learning rate as a function of the remaining share of the training.
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
        # BasePolicy, because the constructor of ActorCriticPolicy would make its own networks.
        BasePolicy.__init__(self, observation_space, action_space)
        # Channels-last memory halves the time of convolution gradients.
        self.network: torch.nn.Module = network().to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.optimizer = torch.optim.Adam(self.network.parameters(), lr=lr_schedule(1), eps=1e-5)


class NetworkPolicy(_NetworkBase):
    """Policy for PPO, whose network returns a distribution and a value."""

    def forward(self, obs: Any, deterministic: bool = False) -> tuple[Tensor, Tensor, Tensor]:
        """Return actions, values and log-probabilities."""
        distribution, value = self.network(obs)
        actions = distribution.mode if deterministic else distribution.sample()
        return actions, value[:, None], distribution.log_prob(actions)

    def evaluate_actions(self, obs: Any, actions: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return values, log-probabilities and entropies."""
        distribution, value = self.network(obs)
        return value[:, None], distribution.log_prob(actions), distribution.entropy()

    def predict_values(self, obs: Any) -> Tensor:
        """Return the values, (B, 1)."""
        return self.network(obs)[1][:, None]

    def _predict(self, observation: Any, deterministic: bool = False) -> Tensor:
        return self.forward(observation, deterministic)[0]


class RecurrentNetworkPolicy(_NetworkBase, RecurrentActorCriticPolicy):
    """Policy for recurrent PPO, whose actor and critic share one recurrent state."""

    @property
    def lstm_actor(self) -> torch.nn.LSTM:  # type: ignore[override]
        """LSTM that defines the shape of the recurrent state."""
        lstm = self.network.lstm
        assert isinstance(lstm, torch.nn.LSTM)
        return lstm

    def forward(  # type: ignore[override]
        self, obs: Any, lstm_states: RNNStates, episode_starts: Tensor, deterministic: bool = False
    ) -> Any:
        """Return actions, values, log-probabilities and the recurrent state."""
        distribution, value, memory = self.network(obs, lstm_states.pi, episode_starts)
        actions = distribution.mode if deterministic else distribution.sample()
        return actions, value[:, None], distribution.log_prob(actions), RNNStates(memory, memory)

    def evaluate_actions(  # type: ignore[override]
        self, obs: Any, actions: Tensor, lstm_states: RNNStates, episode_starts: Tensor
    ) -> Any:
        """Return values, log-probabilities and entropies."""
        distribution, value, _ = self.network(obs, lstm_states.pi, episode_starts)
        return value[:, None], distribution.log_prob(actions), distribution.entropy()

    def predict_values(  # type: ignore[override]
        self, obs: Any, lstm_states: tuple[Tensor, ...], episode_starts: Tensor
    ) -> Tensor:
        """Return the values, (B, 1)."""
        value: Tensor = self.network(obs, lstm_states, episode_starts)[1]
        return value[:, None]


class TimedBuffer(DictRolloutBuffer):
    """Rollout buffer for decisions of different durations: the next value is discounted by gamma ** duration.

    Generalised advantage estimation (Schulman et al. 2016, equation 16) for a semi-Markov decision process (Sutton et
    al. 1999).
    """

    durations: np.ndarray  # (rollout, environments), in decisions of maximum duration; filled during the rollout

    def reset(self) -> None:
        """Clear the buffer for a new rollout."""
        super().reset()
        self.durations = np.ones((self.buffer_size, self.n_envs), np.float32)

    def compute_returns_and_advantage(self, last_values: Tensor, dones: np.ndarray) -> None:
        """Compute advantages, and returns as advantage plus value; ``last_values`` are those of the final states."""
        values = np.concatenate([self.values, last_values.numpy(force=True).reshape(1, -1)])
        continues = 1 - np.concatenate([self.episode_starts[1:], dones[None]]).astype(np.float32)
        discount = self.gamma**self.durations * continues
        advantage = np.zeros(self.n_envs, np.float32)
        for k in reversed(range(self.buffer_size)):
            prediction_error = self.rewards[k] + discount[k] * values[k + 1] - values[k]
            advantage = prediction_error + discount[k] * self.gae_lambda * advantage
            self.advantages[k] = advantage
        self.returns = self.advantages + self.values


def make_ppo(
    pool: WorkerPool,
    network: Callable[[], torch.nn.Module],
    settings: PolicySettings,
    log: Path | None,
    device: str = "cpu",
    remaining: Callable[[], float] = lambda: 1.0,
) -> PPO | RecurrentPPO:
    """Make PPO, or recurrent PPO for a recurrent network.

    Args:
        pool: environments.
        network: makes the network.
        settings: settings of the training.
        log: folder of the TensorBoard logs; None: no logs.
        device: torch device of the network.
        remaining: returns the remaining share of the training, by which the learning rate is multiplied.
    """
    options: dict[str, Any] = {
        "learning_rate": lambda _: settings.lr * remaining(),
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
        "device": device,
    }
    if spec_of(settings.network).recurrent:
        return RecurrentPPO(RecurrentNetworkPolicy, pool, **options)
    return PPO(NetworkPolicy, pool, rollout_buffer_class=TimedBuffer, **options)  # type: ignore[arg-type]


def network_of(ppo: PPO | RecurrentPPO) -> torch.nn.Module:
    """Return the network that is trained."""
    assert isinstance(ppo.policy, _NetworkBase)
    return ppo.policy.network
