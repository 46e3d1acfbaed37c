"""What a PointGoal policy learns before PPO: to go as one who knows the apartment.

The policy walks, and at every step it is told what the robot on the shortest way would do there (DAgger: Ross et al.
2011). At first that robot's actions are taken, so that goals are reached; soon the policy's own, so that it learns to
get out of where they lead.
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

STEPS, PASSES, LR = 32, 2, 1e-3  # steps are learned from together: so far back the gradient goes in time
ALONE = 0.25  # share of the episodes after which the teacher no longer acts


def learn_the_way(
    network: RecurrentNetwork, make: Callable[[], gymnasium.Env], settings: PolicySettings, progress: bool = False
) -> None:
    """Train choices and values until ``settings.demonstrations`` episodes have ended.

    Args:
        network: trained in place.
        make: makes a :class:`~autonerf_lab.envs.pointgoal.PointGoalEnv`, perhaps in a wrapper.
        settings: of the training.
        progress: show a bar.
    """
    count = settings.environments
    rng = np.random.default_rng([settings.seed, 73])
    torch.manual_seed(int(rng.integers(2**31)))
    envs = [make() for _ in range(count)]
    seen = [env.reset(seed=int(rng.integers(2**31)))[0] for env in envs]
    starts, memory = torch.ones(count), network.nothing(count)
    optimizer = torch.optim.Adam(network.parameters(), lr=LR)
    ended = 0
    with tqdm(total=settings.demonstrations, desc="learn the way", unit="episode", disable=not progress) as bar:
        while ended < settings.demonstrations:
            share = ended / settings.demonstrations
            before, kept = memory, []
            for _ in range(STEPS):
                batch = batched(seen)
                with torch.inference_mode():
                    chances, _, memory = network(batch, memory, starts)
                told = np.array([env.unwrapped.shortest_way() for env in envs])  # type: ignore[attr-defined]
                actions = chances.sample().numpy()
                # when to stop it is told, not tried: one who stops on the way would see its beginnings only
                guided = (rng.random(count) < 1 - share / ALONE) | (told == STOP) | (actions == STOP)
                actions = np.where(guided, told, actions)
                rewards, over = np.zeros(count, np.float32), np.zeros(count, np.float32)
                for k, env in enumerate(envs):
                    seen[k], rewards[k], terminated, truncated, _ = env.step(actions[k])
                    if terminated or truncated:
                        over[k] = 1
                        seen[k] = env.reset(seed=int(rng.integers(2**31)))[0]
                kept.append((batch, starts, torch.from_numpy(told), torch.from_numpy(rewards), torch.from_numpy(over)))
                starts = torch.from_numpy(over)
            with torch.inference_mode():
                following = network(batched(seen), memory, starts)[1]
            for _ in range(PASSES):
                _learn(network, optimizer, LR * (1 - share), before, kept, following, settings)
            done = int(sum(float(step[4].sum()) for step in kept))
            ended += done
            bar.update(done)


def _learn(
    network: RecurrentNetwork,
    optimizer: torch.optim.Optimizer,
    lr: float,
    before: tuple[Tensor, Tensor],
    kept: list[tuple[dict[str, Tensor], Tensor, Tensor, Tensor, Tensor]],
    following: Tensor,
    settings: PolicySettings,
) -> None:
    """One update: log-likelihood of what was told, squared error of the returns."""
    batches, starts, told, rewards, over = zip(*kept, strict=True)
    returns = []
    for reward, end in zip(reversed(rewards), reversed(over), strict=True):
        following = reward + settings.gamma * (1 - end) * following
        returns.append(following)
    # one sequence after the other, as the network wants them
    seen = {name: torch.stack([batch[name] for batch in batches], dim=1).flatten(0, 1) for name in batches[0]}
    flat = [torch.stack(part, dim=1).flatten() for part in (starts, told, returns[::-1])]
    chances, value, _ = network(seen, before, flat[0])
    loss = settings.value * ((value - flat[2]) ** 2).mean() - chances.log_prob(flat[1]).mean()
    for group in optimizer.param_groups:
        group["lr"] = lr
    optimizer.zero_grad()
    loss.backward()
    nn.utils.clip_grad_norm_(network.parameters(), settings.max_grad_norm)
    optimizer.step()
