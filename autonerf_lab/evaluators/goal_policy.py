"""PointGoal policies in episodes, for the fine-tuning task."""

from pathlib import Path
from typing import Any

import numpy as np
import torch

from autonerf_lab.envs.pointgoal import PointGoalEnv
from autonerf_lab.errors import DataError
from autonerf_lab.policies.networks import RecurrentNetwork, batched, sample_action
from autonerf_lab.policies.spec import make_network
from autonerf_lab.policies.weights import load_weights, read_meta
from autonerf_lab.scenes.scene import Scene

_AT_ONCE = 25  # episodes in parallel: batch size of the network


def load_goal_policy(path: str | Path) -> RecurrentNetwork:
    """Load the network of a PointGoal policy.

    Raises:
        DataError: the file is missing or damaged, or holds another kind of policy.
    """
    settings = read_meta(path)["network"]
    if settings["kind"] != "goal":
        raise DataError(f"{path} holds an exploration policy, not a PointGoal policy")
    network = make_network(settings)[1]
    assert isinstance(network, RecurrentNetwork)
    load_weights(path, network)
    return network.eval()


def reach_goals(network: RecurrentNetwork, scene: Scene, count: int, seed: int = 0) -> list[dict[str, Any]]:
    """Run seeded PointGoal episodes of a policy; actions are sampled, as in training.

    Args:
        network: of the policy.
        scene: scene of the episodes.
        count: number of episodes.
        seed: random seed of starts, goals and actions.

    Returns:
        The last ``info`` of the environment in each episode: ``success``, ``spl``, ``distance_to_goal`` (metres).
    """
    seeds = np.random.SeedSequence([seed, 8]).generate_state(count)
    rngs = [np.random.default_rng([seed, 9, episode]) for episode in range(count)]
    results: list[dict[str, Any]] = [{}] * count
    for first in range(0, count, _AT_ONCE):
        live = list(range(first, min(first + _AT_ONCE, count)))
        envs = {k: PointGoalEnv(scene=scene) for k in live}
        seen = {k: env.reset(seed=int(seeds[k]))[0] for k, env in envs.items()}
        memory, starts = network.initial_state(len(live)), torch.ones(len(live))
        while live:
            with torch.inference_mode():
                distribution, _, memory = network(batched([seen[k] for k in live]), memory, starts)
            running = []
            for row, k in enumerate(live):
                seen[k], _, terminated, truncated, results[k] = envs[k].step(sample_action(distribution, rngs[k], row))
                if not (terminated or truncated):
                    running.append(row)
            live, starts = [live[row] for row in running], torch.zeros(len(running))
            memory = (memory[0][:, running], memory[1][:, running])
    return results
