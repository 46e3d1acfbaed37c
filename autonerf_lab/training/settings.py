"""What is learned, and how."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from autonerf_lab.errors import UnknownNameError

# Rewards come in units of their own; ``scale`` brings a good episode's sum to about ten.
_MODULAR: dict[str, dict[str, Any]] = {
    # All area is found in 500 steps, so that is what it trains on; and twelve steps lead past a quarter of a room.
    "cov": {
        "scale": 0.1,
        "demonstrations": 200,
        "episode": 80,
        "rollout": 80,
        "gamma": 0.99,
        "network": {"kind": "compact", "follow": 6},
    },
    "obs": {"scale": 0.4},
    "sem": {"scale": 0.4},
    "view": {"scale": 0.02},
}
_END_TO_END: dict[str, dict[str, Any]] = {
    "cov": {"scale": 0.1, "episode": 512},
    "cur": {"scale": 0.3},
    "nov": {"scale": 0.03, "episode": 512},
    "rec": {"scale": 5.0},
}
# Ramakrishnan et al. 2021, appendix, where two cores allow it.
_OF_END_TO_END: dict[str, Any] = {
    "frames": 500_000,
    "demonstrations": 0,
    "environments": 8,
    "rollout": 256,
    "batch": 1024,
    "lr": 5e-4,
    "gamma": 0.99,
    "entropy": 0.01,
    "target_kl": None,
    "episode": 1024,  # who has trained on shorter ones walks in circles where all around is known
    "sensor": 84,
    "network": {"kind": "egocentric"},
}
POINTGOAL = "pointgoal"  # the policy that goes to a place
# As the PointGoal agents of Habitat (Savva et al. 2019), after learning the way.
_OF_POINTGOAL: dict[str, Any] = {
    "frames": 2_000_000,
    "demonstrations": 10_000,
    "rollout": 128,
    "batch": 1024,
    "lr": 2.5e-4,
    "gamma": 0.99,
    "entropy": 0.01,
    "episode": 500,
    "network": {"kind": "goal"},
}


@dataclass(frozen=True)
class PolicySettings:
    """A run of PPO. A decision is a waypoint or an action."""

    frames: int = 1_500_000  # actions of the robots, at most: a waypoint that is reached early takes fewer
    seed: int = 0
    demonstrations: int = 80  # episodes with a teacher before PPO: frontier exploration, or who knows the shortest way
    environments: int = 16  # divided among the workers
    episode: int = 100  # decisions
    rollout: int = 100  # decisions of every environment between two updates: whole episodes, or all see the same phase
    epochs: int = 4
    batch: int = 200
    lr: float = 3e-4  # falls linearly to zero
    gamma: float = 0.98  # a decision of full length
    gae: float = 0.95
    clip: float = 0.2
    entropy: float = 0.001
    value: float = 0.5
    target_kl: float | None = 0.02  # epochs end early when the policy has moved so far
    max_grad_norm: float = 0.5
    scale: float = 1.0  # of the reward
    sensor: int = 64  # pixels a side
    scenes: tuple[str, ...] = ()  # names; the training apartments without
    network: dict[str, Any] = field(default_factory=lambda: {"kind": "compact"})

    def __post_init__(self) -> None:
        if self.demonstrations and self.network["kind"] == "egocentric":
            raise ValueError("demonstrations are waypoints, which an end-to-end policy does not choose; set them to 0")


def settings_of(policy: str, **chosen: Any) -> PolicySettings:
    """The settings of a policy by its name, ``modular-<reward>``, ``e2e-<reward>`` or ``pointgoal``.

    A reward of your own is welcome.

    Args:
        policy: its name.
        chosen: settings that replace them.

    Raises:
        UnknownNameError: not the name of a policy that is trained.

    Example:
        >>> settings_of("modular-cov", frames=1000).scale
        0.1
    """
    if policy == POINTGOAL:
        return PolicySettings(**{**_OF_POINTGOAL, **chosen})
    kind, _, reward = policy.partition("-")
    if kind not in ("modular", "e2e") or not reward:
        names = [f"modular-{name}" for name in _MODULAR] + [f"e2e-{name}" for name in _END_TO_END]
        raise UnknownNameError("policy to train", policy, [*names, POINTGOAL])
    own = _MODULAR.get(reward, {}) if kind == "modular" else _OF_END_TO_END | _END_TO_END.get(reward, {})
    return PolicySettings(**{**own, **chosen})


def command_of(policy: str, settings: PolicySettings, start: str | Path | None = None) -> str | None:
    """The command line that trains it; None where the settings are others than a command can name.

    Example:
        >>> command_of("modular-obs", settings_of("modular-obs", seed=3))
        'autonerf-lab train-policy --policy modular-obs --frames 1500000 --seed 3'
    """
    named = settings_of(policy, frames=settings.frames, seed=settings.seed)
    command = f"autonerf-lab train-policy --policy {policy} --frames {settings.frames} --seed {settings.seed}"
    command += f" --start {start}" if start else ""
    return command if settings == named else None
