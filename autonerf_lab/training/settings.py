"""Settings of policy training, with defaults for each policy."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from autonerf_lab.errors import DataError, UnknownNameError
from autonerf_lab.policies.spec import SPECS, spec_of
from autonerf_lab.scenes import Scene

POINTGOAL = "pointgoal"  # name of the PointGoal policy
Scenes = Sequence[str | Scene] | None  # of a training; None for those of the settings


@dataclass(frozen=True)
class PolicySettings:
    """Settings of a training by PPO. A decision is a waypoint or a single action."""

    frames: int = 1_000_000  # robot actions, rounded up to whole rollouts
    seed: int = 0
    demonstrations: int = 80  # episodes of the teacher before PPO
    environments: int = 16  # divided among the worker processes
    episode: int = 100  # decisions per episode
    rollout: int = 100  # decisions of each environment per update; whole episodes, so that updates see all their phases
    epochs: int = 4
    batch: int = 200
    lr: float = 3e-4  # decreases linearly to zero
    gamma: float = 0.98  # discount of a decision of maximum duration
    gae: float = 0.95
    clip: float = 0.2
    entropy: float = 0.001
    value: float = 0.5
    target_kl: float | None = 0.02  # an update ends early at this approximate KL divergence
    max_grad_norm: float = 0.5
    scale: float = 1.0  # factor of the reward
    sensor: int = 64  # pixels a side of the robot's images
    scenes: tuple[str, ...] = ()  # names; empty for the training scenes
    network: dict[str, Any] = field(default_factory=lambda: {"kind": "compact"})  # see autonerf_lab.policies.spec

    def __post_init__(self) -> None:
        spec = spec_of(self.network)
        if self.demonstrations and spec.teacher is None:
            raise DataError(f"{spec.name} policies have no teacher for demonstrations; set demonstrations to 0")


def settings_of(policy: str, **overrides: Any) -> PolicySettings:
    """Return the default settings of a policy.

    Args:
        policy: ``modular-<reward>``, ``paper-<reward>``, ``e2e-<reward>`` or ``pointgoal``; the reward may be your own.
        overrides: settings that replace the defaults.

    Raises:
        UnknownNameError: not the name of a policy that can be trained; lists the valid names.

    Example:
        >>> settings_of("modular-cov", frames=1000).scale
        0.1
    """
    family, _, reward = policy.partition("-")
    for spec in SPECS.values():
        if spec.name == family and bool(reward) == (spec.rewards is not None):
            own = (spec.rewards or {}).get(reward, {})
            return PolicySettings(**{**spec.settings, **own, **overrides})
    specs = {spec.name: spec for spec in SPECS.values()}
    names = [f"{name}-{reward}" for name, spec in specs.items() for reward in spec.rewards or ()]
    raise UnknownNameError("policy to train", policy, [*names, POINTGOAL])


def command_of(
    policy: str, settings: PolicySettings, start: str | Path | None = None, device: str = "cpu"
) -> str | None:
    """Return the command line of a training; None if it has settings without a command-line option.

    Example:
        >>> command_of("modular-obs", settings_of("modular-obs", seed=3))
        'autonerf-lab train-policy --policy modular-obs --frames 1000000 --seed 3'
    """
    named = settings_of(policy, frames=settings.frames, seed=settings.seed, demonstrations=settings.demonstrations)
    command = f"autonerf-lab train-policy --policy {policy} --frames {settings.frames} --seed {settings.seed}"
    if settings.demonstrations != settings_of(policy).demonstrations:
        command += f" --demonstrations {settings.demonstrations}"
    command += f" --start {start}" if start else ""
    command += f" --device {device}" if device != "cpu" else ""
    return command if settings == named else None
