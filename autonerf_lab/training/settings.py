"""What is learned, and how."""

from dataclasses import dataclass, field
from typing import Any

from autonerf_lab.errors import UnknownNameError
from autonerf_lab.policies.views import FOLLOW_STEPS

# Rewards come in units of their own; ``scale`` brings a good episode's sum to about ten. An episode is as long as there
# is something to find: area is seen in a quarter of a walk.
_MODULAR: dict[str, dict[str, Any]] = {
    "cov": {"scale": 0.1, "max_steps": 400, "rollout": 16},
    "obs": {"scale": 0.4},
    "sem": {"scale": 0.4},
    "view": {"scale": 0.02},
}
_END_TO_END: dict[str, dict[str, Any]] = {
    "cov": {"scale": 0.1},
    "cur": {"scale": 0.3},
    "nov": {"scale": 0.03},
    "rec": {"scale": 5.0},
}
# Ramakrishnan et al. 2021, appendix, where two cores allow it.
_OF_END_TO_END: dict[str, Any] = {
    "frames": 500_000,
    "rollout": 128,
    "batch": 512,
    "lr": 5e-4,
    "gamma": 0.99,
    "entropy": 0.01,
    "max_steps": 512,
    "sensor": 84,
    "network": {"kind": "egocentric"},
}
NETWORKS = ("compact", "paper")


@dataclass(frozen=True)
class PolicySettings:
    """A run of PPO. A decision is a waypoint or an action."""

    frames: int = 1_000_000  # actions of the robots
    seed: int = 0
    environments: int = 8  # divided among the workers
    rollout: int = 20  # decisions of every environment between two updates; divides those of an episode
    epochs: int = 4
    batch: int = 32
    lr: float = 1e-3  # falls linearly to zero
    gamma: float = 0.97
    gae: float = 0.95
    clip: float = 0.2
    entropy: float = 0.001
    value: float = 0.5
    target_kl: float | None = None  # epochs end early when the policy has moved so far
    max_grad_norm: float = 0.5
    scale: float = 1.0  # of the reward
    max_steps: int = 1000  # of an episode
    sensor: int = 64  # pixels a side
    network: dict[str, Any] = field(default_factory=lambda: {"kind": "compact"})

    @property
    def actions(self) -> int:
        """Of the robot, a decision."""
        return 1 if self.network["kind"] == "egocentric" else int(self.network.get("follow", FOLLOW_STEPS))


def settings_of(policy: str, **chosen: Any) -> PolicySettings:
    """The settings of a policy by its name, ``modular-<reward>`` or ``e2e-<reward>``; a reward of your own is welcome.

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
    if kind not in ("modular", "e2e") or not reward:
        names = [f"modular-{name}" for name in _MODULAR] + [f"e2e-{name}" for name in _END_TO_END]
        raise UnknownNameError("policy to train", policy, names)
    own = _MODULAR.get(reward, {}) if kind == "modular" else _OF_END_TO_END | _END_TO_END.get(reward, {})
    return PolicySettings(**{**own, **chosen})


def command_of(policy: str, settings: PolicySettings) -> str | None:
    """The command line that trains it; None where the settings are others than a command can name.

    Example:
        >>> command_of("modular-obs", settings_of("modular-obs", seed=3))
        'autonerf-lab train-policy --policy modular-obs --frames 1000000 --seed 3'
    """
    named = settings_of(policy, frames=settings.frames, seed=settings.seed)
    command = f"autonerf-lab train-policy --policy {policy} --frames {settings.frames} --seed {settings.seed}"
    return command if settings == named else None
