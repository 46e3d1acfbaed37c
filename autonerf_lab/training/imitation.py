"""What a global policy learns before PPO: to choose as frontier exploration does.

A fresh network names places at random, and most of a million frames would go into finding out that one gets on by
walking to where the known ends. A few minutes of watching ``frontier`` in the training apartments teach that, and how
much reward is still to come; what the reward asks for beyond it is left to PPO.

What was tried before is not shown: a pupil that sees it learns that its teacher mostly repeats himself, and repeats
itself.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from tqdm import tqdm

from autonerf_lab.envs.explore import ExploreEnv
from autonerf_lab.policies.frontier import Frontier
from autonerf_lab.policies.interfaces import WINDOW_METRES, View, done
from autonerf_lab.policies.symmetry import Turn
from autonerf_lab.rewards import Reward
from autonerf_lab.training.settings import PolicySettings

EPOCHS, BATCH, LR = 4, 64, 3e-3


@dataclass(frozen=True)
class Decisions:
    """N moments at which a waypoint was due."""

    seen: dict[str, np.ndarray]  # of the view, each (N, ...)
    actions: np.ndarray  # (N, ...) that of the view which leads nearest to the teacher's waypoint
    returns: np.ndarray  # (N,) float32, discounted sum of the scaled rewards that followed

    def __len__(self) -> int:
        return len(self.returns)


def demonstrate(view: View, settings: PolicySettings, reward: str | Reward, progress: bool = False) -> Decisions:
    """Watch frontier exploration for ``settings.demonstrations`` episodes.

    Example:
        >>> from autonerf_lab.policies.interfaces import CompactView
        >>> from autonerf_lab.training.settings import settings_of
        >>> short = settings_of("modular-cov", demonstrations=1, episode=4, sensor=16)
        >>> decisions = demonstrate(CompactView(), short, "cov")
        >>> decisions.seen["map"].shape[1:], len(decisions) == len(decisions.actions)
        ((19, 32, 32), True)
    """
    env = ExploreEnv(
        scene=settings.scenes or None,
        reward=reward,
        size=settings.sensor,
        rgb=False,
        max_steps=settings.episode * view.follow,
        window=round(WINDOW_METRES / view.cell),
    )
    seen: list[dict[str, Any]] = []
    actions, returns = [], []  # of all episodes
    for episode in tqdm(range(settings.demonstrations), "watch frontier", unit="episode", disable=not progress):
        seed = int(np.random.SeedSequence([settings.seed, episode, 71]).generate_state(1)[0])
        env.reset(seed=seed)
        teacher = Frontier()
        teacher.reset(np.random.default_rng(seed))
        rewards: list[float] = []
        lasted: list[float] = []  # in decisions of full length
        chosen: list[int] = []  # at which of the decisions the teacher had a waypoint
        over = False
        while not over:
            view.reset()
            shown = view.see(env.map)
            action = teacher.act(env.map, env.observation)
            waypoint = teacher.waypoint
            choice = None if waypoint is None else view.action(waypoint, env.map)
            rewards.append(0.0)
            steps = 0
            while not (over or done(view, waypoint, env.map, steps)):
                if steps:
                    action = teacher.act(env.map, env.observation)
                _, gained, _, over, _ = env.step(np.int64(action))
                rewards[-1] += gained * settings.scale
                steps += 1
            lasted.append(steps / view.follow)
            if choice is not None:
                chosen.append(len(rewards) - 1)
                seen.append(shown)
                actions.append(choice)
        following = np.append(rewards, 0.0)
        for k in reversed(range(len(rewards))):
            following[k] += settings.gamma ** lasted[k] * following[k + 1]
        returns += [following[k] for k in chosen]
    stacked = {name: np.stack([one[name] for one in seen]) for name in seen[0]}
    return Decisions(stacked, np.array(actions), np.array(returns, np.float32))


def imitate(network: nn.Module, decisions: Decisions, settings: PolicySettings, progress: bool = False) -> None:
    """Train a network's choices and values on decisions: log-likelihood, and squared error of the returns."""
    rng = np.random.default_rng([settings.seed, 72])
    steps = max(1, EPOCHS * len(decisions) // BATCH)
    optimizer = torch.optim.Adam(network.parameters(), lr=LR)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, LR, total_steps=steps + 1)
    for _ in tqdm(range(steps), "imitate", unit="step", disable=not progress):
        seen, actions, returns = _batch(decisions, rng)
        chances, value = network(seen)
        loss = settings.value * ((value - returns) ** 2).mean() - chances.log_prob(actions).mean()
        optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), settings.max_grad_norm)
        optimizer.step()
        schedule.step()


def _batch(decisions: Decisions, rng: np.random.Generator) -> tuple[dict[str, Tensor], Tensor, Tensor]:
    """Some decisions, all in one of the symmetries of the square where the view has them."""
    drawn = rng.integers(len(decisions), size=BATCH)
    seen = {name: values[drawn] for name, values in decisions.seen.items()}
    actions = decisions.actions[drawn]
    if "reach" in seen:
        turn = Turn.drawn(rng)
        seen, actions = turn.seen(seen), turn.action(actions)
    tensors = {name: torch.from_numpy(values) for name, values in seen.items()}
    return tensors, torch.from_numpy(actions), torch.from_numpy(decisions.returns[drawn])
