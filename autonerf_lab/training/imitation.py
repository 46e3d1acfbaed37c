"""Imitation of frontier exploration, before PPO.

An untrained network chooses random waypoints. A few minutes of behaviour cloning of ``frontier`` in the training scenes
teach it that waypoints at the border of the explored area pay off, and initialise the value estimate. PPO then
optimises the reward.

The observations of the demonstrations do not contain previous waypoints. Frontier exploration mostly keeps its
waypoint, so a network that saw them would learn to repeat its own.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from tqdm import tqdm

from autonerf_lab.envs.explore import ExploreEnv
from autonerf_lab.errors import DataError
from autonerf_lab.policies.frontier import Frontier
from autonerf_lab.policies.interfaces import WINDOW_METRES, PolicyInterface, waypoint_finished, waypoint_reached
from autonerf_lab.policies.spec import spec_of
from autonerf_lab.policies.symmetry import SquareSymmetry
from autonerf_lab.rewards import Reward
from autonerf_lab.training.settings import PolicySettings, Scenes

EPOCHS, BATCH, LR = 8, 64, 3e-3


@dataclass(frozen=True)
class Demonstrations:
    """N decisions of the teacher."""

    observations: dict[str, np.ndarray]  # of the policy interface, each (N, ...)
    actions: np.ndarray  # (N, ...), action of the policy interface nearest to the teacher's waypoint
    returns: np.ndarray  # (N,) float32, discounted sum of the scaled rewards after the decision
    symmetric: bool = False  # observations and actions can be transformed by the symmetries of the square

    def __len__(self) -> int:
        return len(self.returns)


def demonstrate(
    interface: PolicyInterface,
    settings: PolicySettings,
    reward: str | Reward,
    progress: bool = False,
    scenes: Scenes = None,
) -> Demonstrations:
    """Record ``settings.demonstrations`` episodes of frontier exploration, in ``scenes`` or those of the settings.

    Example:
        >>> from autonerf_lab.policies.interfaces import CompactInterface
        >>> from autonerf_lab.training.settings import settings_of
        >>> short = settings_of("modular-cov", demonstrations=1, episode=4, sensor=16)
        >>> decisions = demonstrate(CompactInterface(), short, "cov")
        >>> decisions.observations["map"].shape[1:], len(decisions) == len(decisions.actions)
        ((19, 32, 32), True)
    """
    env = ExploreEnv(
        scene=scenes or settings.scenes or None,
        reward=reward,
        size=settings.sensor,
        rgb=False,
        max_steps=settings.episode * interface.follow,
        window=round(WINDOW_METRES / interface.cell),
    )
    observations: list[dict[str, Any]] = []
    actions, returns = [], []  # of all episodes
    for episode in tqdm(range(settings.demonstrations), "demonstrate", unit="episode", disable=not progress):
        seed = int(np.random.SeedSequence([settings.seed, episode, 71]).generate_state(1)[0])
        env.reset(seed=seed)
        teacher = Frontier()
        teacher.reset(np.random.default_rng(seed))
        rewards: list[float] = []
        durations: list[float] = []  # in decisions of maximum duration
        chosen: list[int] = []  # indices of the decisions with a waypoint
        over = False
        while not over:
            interface.reset()
            obs = interface.observe(env.map)
            action = teacher.act(env.map, env.observation)
            waypoint = teacher.waypoint
            choice = None
            # While the teacher looks around at its waypoint, no action of the interface corresponds to what it does.
            if waypoint is not None and not waypoint_reached(interface, waypoint, env.map):
                choice = interface.to_action(waypoint, env.map)
            rewards.append(0.0)
            steps = 0
            while not (over or waypoint_finished(interface, waypoint, env.map, steps)):
                if steps:
                    action = teacher.act(env.map, env.observation)
                _, value, _, over, _ = env.step(np.int64(action))
                rewards[-1] += value * settings.scale
                steps += 1
            durations.append(steps / interface.follow)
            if choice is not None:
                chosen.append(len(rewards) - 1)
                observations.append(obs)
                actions.append(choice)
        sums = np.append(rewards, 0.0)
        for k in reversed(range(len(rewards))):
            sums[k] += settings.gamma ** durations[k] * sums[k + 1]
        returns += [sums[k] for k in chosen]
    if not observations:
        raise DataError("no decision of the demonstrations had an action; set demonstrations=0, or use more of them")
    stacked = {name: np.stack([obs[name] for obs in observations]) for name in observations[0]}
    symmetric = spec_of(settings.network).symmetric
    return Demonstrations(stacked, np.array(actions), np.array(returns, np.float32), symmetric)


def imitate(
    network: nn.Module, demonstrations: Demonstrations, settings: PolicySettings, progress: bool = False
) -> None:
    """Train a network by behaviour cloning: log-likelihood of the actions, squared error of the values."""
    rng = np.random.default_rng([settings.seed, 72])
    steps = max(1, EPOCHS * len(demonstrations) // BATCH)
    optimizer = torch.optim.Adam(network.parameters(), lr=LR)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, LR, total_steps=steps + 1)
    for _ in tqdm(range(steps), "imitate", unit="step", disable=not progress):
        obs, actions, returns = _batch(demonstrations, rng)
        distribution, value = network(obs)
        loss = settings.value * ((value - returns) ** 2).mean() - distribution.log_prob(actions).mean()
        optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), settings.max_grad_norm)
        optimizer.step()
        schedule.step()


def _batch(demonstrations: Demonstrations, rng: np.random.Generator) -> tuple[dict[str, Tensor], Tensor, Tensor]:
    """Sample a batch of decisions, transformed by one random symmetry if the interface allows it."""
    rows = rng.integers(len(demonstrations), size=BATCH)
    obs = {name: values[rows] for name, values in demonstrations.observations.items()}
    actions = demonstrations.actions[rows]
    if demonstrations.symmetric:
        symmetry = SquareSymmetry.sample(rng)
        obs, actions = symmetry.transform_observation(obs), symmetry.transform_action(actions)
    tensors = {name: torch.from_numpy(values) for name, values in obs.items()}
    return tensors, torch.from_numpy(actions), torch.from_numpy(demonstrations.returns[rows])
