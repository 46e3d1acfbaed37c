"""What is learned, and how."""

from dataclasses import dataclass, field
from typing import Any

from autonerf_lab.errors import UnknownNameError

# Rewards come in units of their own; these bring a good episode's sum to about ten. An episode is as long as there is
# something to find: area is seen in a quarter of a walk.
_REWARDS = {
    "cov": {"scale": 0.1, "max_steps": 400, "rollout": 16},
    "obs": {"scale": 0.4, "max_steps": 1000},
    "sem": {"scale": 0.4, "max_steps": 1000},
    "view": {"scale": 0.02, "max_steps": 1000},
}
NETWORKS = ("compact", "paper")


@dataclass(frozen=True)
class PolicySettings:
    """A run of PPO."""

    frames: int = 1_000_000  # actions of the robots
    seed: int = 0
    environments: int = 8  # divided among the workers
    rollout: int = 20  # waypoints of every environment between two updates; divides those of an episode
    epochs: int = 4
    batch: int = 32
    lr: float = 1e-3  # falls linearly to zero
    gamma: float = 0.97
    gae: float = 0.95
    clip: float = 0.2
    entropy: float = 0.001
    value: float = 0.5
    max_grad_norm: float = 0.5
    scale: float = 1.0  # of the reward
    max_steps: int = 1000  # of an episode
    sensor: int = 64  # pixels a side
    network: dict[str, Any] = field(default_factory=lambda: {"kind": "compact"})


def settings_of(policy: str, **chosen: Any) -> PolicySettings:
    """The settings of a policy by its name, ``modular-<reward>``; for a reward of your own, the defaults.

    Args:
        policy: its name.
        chosen: settings that replace them.

    Raises:
        UnknownNameError: not the name of a policy that is trained.

    Example:
        >>> settings_of("modular-cov", frames=1000).max_steps
        400
    """
    kind, _, reward = policy.partition("-")
    if kind != "modular" or not reward:
        raise UnknownNameError("policy to train", policy, [f"modular-{name}" for name in _REWARDS])
    return PolicySettings(**{**_REWARDS.get(reward, {}), **chosen})
