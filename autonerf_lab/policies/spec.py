"""Families of learned policies: how a policy is built from its weights, and how it is trained.

The JSON file beside the weights contains ``network``: the ``kind``, a key of :data:`SPECS`, and options of the policy
interface or of the network.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from torch import nn

from autonerf_lab.errors import AutoNerfError, DataError, UnknownNameError
from autonerf_lab.policies.base import Policy
from autonerf_lab.policies.egocentric import EgocentricInterface
from autonerf_lab.policies.end_to_end import EndToEnd
from autonerf_lab.policies.interfaces import CompactInterface, PaperInterface
from autonerf_lab.policies.modular import Modular
from autonerf_lab.policies.networks import CompactNetwork, EgocentricNetwork, GoalNetwork, PaperNetwork
from autonerf_lab.policies.pointgoal import GoalInterface
from autonerf_lab.policies.symmetry import SymmetryAveraged


@dataclass(frozen=True)
class PolicySpec:
    """Family of learned policies."""

    name: str  # first part of a policy's name: "modular" in "modular-cov"
    environment: str  # Gymnasium ID of the training environment
    interface: Callable[..., Any]  # called with the options: makes the policy interface
    network: Callable[..., nn.Module]  # called with the interface and the options: makes the untrained network
    policy: Callable[[Any, Any], Policy] | None  # called with interface and network; None: it does not explore
    teacher: str | None  # imitated before PPO: a key of ``autonerf_lab.training.train.TEACHERS``
    settings: Mapping[str, Any]  # training settings that differ from the defaults of ``PolicySettings``
    rewards: Mapping[str, Mapping[str, Any]] | None  # further settings by reward; None: the environment has its own
    recurrent: bool = False  # the network has a recurrent state
    symmetric: bool = False  # observations and actions can be transformed by the symmetries of the square
    waypoints: bool = False  # a decision is a waypoint that several actions follow, not a single action
    fixed_length: bool = True  # all episodes have the same number of decisions


# ``scale`` brings the sum of the rewards of a good episode to about ten.
_REWARDS: dict[str, dict[str, Any]] = {
    "cov": {"scale": 0.1},
    "obs": {"scale": 0.4},
    "sem": {"scale": 0.4},
    "view": {"scale": 0.02},
}
_MODULAR = PolicySpec(
    name="modular",
    environment="AutoNeRF/Waypoint-v0",
    interface=CompactInterface,
    network=lambda interface, **options: CompactNetwork(),
    policy=lambda interface, network: Modular(interface, SymmetryAveraged(network)),
    teacher="frontier",
    settings={
        "demonstrations": 60,
        "epochs": 3,
        "batch": 64,
        "lr": 1e-3,
        "gamma": 0.97,  # the weights of the rewards are then nearly those of the area under a curve of 1500 actions
        "gae": 0.9,
        "entropy": 0.0,
        "target_kl": 0.06,
    },
    rewards=_REWARDS,
    symmetric=True,
    waypoints=True,
)
_END_TO_END = PolicySpec(
    name="e2e",
    environment="AutoNeRF/Egocentric-v0",
    interface=lambda **options: EgocentricInterface(),
    network=lambda interface, **options: EgocentricNetwork(**options),
    policy=EndToEnd,
    teacher=None,
    # Ramakrishnan et al. 2021, appendix, reduced for two CPU cores.
    settings={
        "demonstrations": 0,
        "environments": 8,
        "rollout": 256,
        "batch": 1024,
        "lr": 5e-4,
        "gamma": 0.99,
        "entropy": 0.01,
        "target_kl": None,
        "episode": 1024,
        "sensor": 84,
        "network": {"kind": "egocentric"},
    },
    rewards={
        "cov": {"scale": 0.1},
        "cur": {"scale": 0.3},
        "nov": {"scale": 0.03},
        "rec": {"scale": 5.0},
    },
    recurrent=True,
)
_POINTGOAL = PolicySpec(
    name="pointgoal",
    environment="AutoNeRF/PointGoal-v0",
    interface=lambda **options: GoalInterface(),
    network=lambda interface, **options: GoalNetwork(**options),
    policy=None,
    teacher="shortest-path",
    # As the PointGoal agents of Habitat (Savva et al. 2019), after imitation of shortest paths.
    settings={
        "frames": 2_000_000,
        "demonstrations": 10_000,
        "rollout": 128,
        "batch": 1024,
        "lr": 2.5e-4,
        "gamma": 0.99,
        "entropy": 0.01,
        "episode": 500,
        "network": {"kind": "goal"},
    },
    rewards=None,
    recurrent=True,
    fixed_length=False,
)
_PAPER_NETWORK = {"kind": "paper", "window": 120}  # cells of 10 cm; the paper has 240 of 5 cm
# Modular policies whose network has no inputs but the paper's map. Other settings are equal.
_PAPER = replace(
    _MODULAR,
    name="paper",
    interface=PaperInterface,
    network=lambda interface, **options: PaperNetwork(interface.window, interface.channels),
    policy=Modular,
    settings={**_MODULAR.settings, "network": _PAPER_NETWORK},
    rewards={**_REWARDS, "view": {**_REWARDS["view"], "network": {**_PAPER_NETWORK, "viewpoints": True}}},
    symmetric=False,
)
SPECS: dict[str, PolicySpec] = {  # by kind of network
    "compact": _MODULAR,
    "paper": _PAPER,
    "egocentric": _END_TO_END,
    "goal": _POINTGOAL,
}


def spec_of(network: Mapping[str, Any]) -> PolicySpec:
    """Return the spec that network settings name by their ``kind``.

    Raises:
        UnknownNameError: the kind is missing or unknown; lists the valid kinds.
    """
    kind = network.get("kind", "")
    if kind not in SPECS:
        raise UnknownNameError("kind of network", kind, SPECS)
    return SPECS[kind]


def make_interface(network: Mapping[str, Any]) -> Any:
    """Make the policy interface of network settings.

    Example:
        >>> make_interface({"kind": "compact", "follow": 25}).follow
        25
    """
    return spec_of(network).interface(**_options(network))


def make_network(network: Mapping[str, Any]) -> tuple[Any, nn.Module]:
    """Make the policy interface and the untrained network of network settings.

    Example:
        >>> interface, network = make_network({"kind": "paper", "window": 48, "viewpoints": True})
        >>> interface.channels
        48
    """
    try:
        interface = make_interface(network)
        return interface, spec_of(network).network(interface, **_options(network))
    except AutoNerfError:
        raise
    except (TypeError, ValueError, AttributeError, ArithmeticError, RuntimeError) as error:
        raise DataError(f"the options {str(dict(network))[:200]} fit no network: {error}") from error


def _options(network: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in network.items() if name != "kind"}
