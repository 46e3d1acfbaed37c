"""Probe of a trained policy: what its network gets and answers at the start of an episode and later.

It is stored beside the weights. If code that the inputs depend on changes, or the weights do, the stored probe differs
from a new one.
"""

from collections.abc import Callable

import gymnasium
import torch
from torch import nn

from autonerf_lab.policies.networks import RecurrentNetwork, batched

ACTIONS = (0, 25, 50)  # random actions before each observation: early in an episode, some channels are empty
Probe = list[dict[str, float]]


def probe(network: nn.Module, make: Callable[[], gymnasium.Env]) -> Probe:
    """Evaluate a network on an observation of each of three episodes, after :data:`ACTIONS` random actions.

    Args:
        network: network on the CPU, unchanged.
        make: makes the training environment of the policy.

    Returns:
        For each episode the mean of every channel of the observation (``map 0``, ``map 1``, ...), the ``entropy`` of
        the actions in nats, and the ``value``.

    Example:
        >>> from autonerf_lab.policies.spec import make_network
        >>> from autonerf_lab.training.settings import settings_of
        >>> from autonerf_lab.training.train import make_env
        >>> settings = settings_of("e2e-cov", scenes=("dev-0",))
        >>> network = make_network(settings.network)[1]
        >>> rows = probe(network, lambda: make_env(settings, "cov"))
        >>> len(rows), round(rows[0]["entropy"], 3)  # three actions, equally likely before training
        (3, 1.099)
    """
    env, rows = make(), []
    for seed, actions in enumerate(ACTIONS):
        obs = env.reset(seed=seed)[0]
        env.action_space.seed(seed)
        for _ in range(actions):
            obs, _, terminated, truncated, _ = env.step(env.action_space.sample())
            if terminated or truncated:
                obs = env.reset()[0]
        batch = batched([obs])
        with torch.inference_mode():
            if isinstance(network, RecurrentNetwork):
                distribution, value, _ = network(batch, network.initial_state(1), torch.ones(1))
            else:
                distribution, value = network(batch)
        row: dict[str, float] = {}
        for name, values in batch.items():
            channels = values.double().reshape(values.shape[1] if values.ndim > 1 else 1, -1).mean(dim=1)
            row |= {f"{name} {k}": round(float(mean), 6) for k, mean in enumerate(channels)}
        row |= {"entropy": round(float(distribution.entropy()), 4), "value": round(float(value), 4)}
        rows.append(row)
    return rows
