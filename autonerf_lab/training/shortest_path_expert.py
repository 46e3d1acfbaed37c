"""Imitation of shortest paths by a PointGoal policy, before PPO.

The policy is trained on the expert action of every step (DAgger: Ross et al. 2011). At first the environments execute
the expert's actions, so that goals are reached; then increasingly the policy's own, so that it learns to recover from
its errors.
"""

from collections.abc import Callable

import gymnasium
import numpy as np
import torch
from torch import Tensor, nn
from tqdm import tqdm

from autonerf_lab.policies.networks import RecurrentNetwork, batched
from autonerf_lab.policies.pointgoal import STOP
from autonerf_lab.training.settings import PolicySettings

STEPS, PASSES, LR = 32, 2, 1e-3  # STEPS is the length of backpropagation through time
GUIDED = 0.25  # share of the episodes after which the expert no longer acts


def imitate_shortest_paths(
    network: RecurrentNetwork, make: Callable[[], gymnasium.Env], settings: PolicySettings, progress: bool = False
) -> None:
    """Train actor and critic until ``settings.demonstrations`` episodes have ended.

    Args:
        network: network, trained in place.
        make: makes a :class:`~autonerf_lab.envs.pointgoal.PointGoalEnv`, with or without wrappers.
        settings: settings of the training.
        progress: show a progress bar.
    """
    count = settings.environments
    rng = np.random.default_rng([settings.seed, 73])
    torch.manual_seed(int(rng.integers(2**31)))
    envs = [make() for _ in range(count)]
    observations = [env.reset(seed=int(rng.integers(2**31)))[0] for env in envs]
    starts, memory = torch.ones(count), network.initial_state(count)
    optimizer = torch.optim.Adam(network.parameters(), lr=LR)
    ended = 0
    with tqdm(
        total=settings.demonstrations, desc="imitate shortest paths", unit="episode", disable=not progress
    ) as bar:
        while ended < settings.demonstrations:
            share = ended / settings.demonstrations
            initial, steps = memory, []
            for _ in range(STEPS):
                batch = batched(observations)
                with torch.inference_mode():
                    distribution, _, memory = network(batch, memory, starts)
                expert = np.array([env.unwrapped.expert_action() for env in envs])  # type: ignore[attr-defined]
                actions = distribution.sample().numpy()
                # The expert decides about *stop*: a wrong stop would end the episode early.
                guided = (rng.random(count) < 1 - share / GUIDED) | (expert == STOP) | (actions == STOP)
                actions = np.where(guided, expert, actions)
                rewards, over = np.zeros(count, np.float32), np.zeros(count, np.float32)
                for k, env in enumerate(envs):
                    observations[k], rewards[k], terminated, truncated, _ = env.step(actions[k])
                    if terminated or truncated:
                        over[k] = 1
                        observations[k] = env.reset(seed=int(rng.integers(2**31)))[0]
                arrays = torch.from_numpy(expert), torch.from_numpy(rewards), torch.from_numpy(over)
                steps.append((batch, starts, *arrays))
                starts = torch.from_numpy(over)
            with torch.inference_mode():
                next_value = network(batched(observations), memory, starts)[1]
            for _ in range(PASSES):
                _update(network, optimizer, LR * (1 - share), initial, steps, next_value, settings)
            done = int(sum(float(step[4].sum()) for step in steps))
            ended += done
            bar.update(done)


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
