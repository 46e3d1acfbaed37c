"""Probe of a trained policy: what its network gets and answers at the start of three episodes.

It is stored beside the weights. If code that the inputs depend on changes, or the weights do, the stored probe differs
from a new one.
"""

from collections.abc import Callable

import gymnasium
import torch
from torch import nn

from autonerf_lab.policies.networks import RecurrentNetwork, batched

SEEDS = (0, 1, 2)
Probe = list[dict[str, float]]


def probe(network: nn.Module, make: Callable[[], gymnasium.Env]) -> Probe:
    """Evaluate a network on the first observations of three episodes.

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
    for seed in SEEDS:
        obs = env.reset(seed=seed)[0]
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
