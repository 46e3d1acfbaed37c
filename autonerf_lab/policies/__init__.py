"""The policies, by name."""

import hashlib
from collections.abc import Callable
from functools import partial
from pathlib import Path

from autonerf_lab.errors import DataError, UnknownNameError
from autonerf_lab.policies.base import Policy
from autonerf_lab.policies.frontier import Frontier
from autonerf_lab.policies.random_policies import RandomWalk, RandomWaypoints

WEIGHTS = Path(__file__).parent / "weights"


def weights_path(policy: str) -> Path:
    """Where the weights of a policy would be if it has any: of a name among those that ship, of a path there.

    Example:
        >>> weights_path("frontier").exists(), weights_path("mine/policy.safetensors").as_posix()
        (False, 'mine/policy.safetensors')
    """
    return Path(policy) if policy.endswith(".safetensors") else WEIGHTS / f"{policy}.safetensors"


def weights_sha256(policy: str) -> str | None:
    """What tells the weights of a policy from others, in hexadecimal; None for one without."""
    path = weights_path(policy)
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.exists() else None


def load_policy(path: str | Path, trained: bool = True) -> Policy:
    """A policy that was trained: the files ``path``.safetensors and ``path``.json.

    Args:
        path: of both, without suffix or with one of theirs.
        trained: False for the same network as it was before training, what a training has to beat.

    Raises:
        DataError: missing, damaged, made for another network, or a policy that goes to places and does not explore.
    """
    # torch: not for those who walk without it
    from autonerf_lab.policies.end_to_end import EndToEnd
    from autonerf_lab.policies.modular import Modular
    from autonerf_lab.policies.networks import CompactNetwork, EgocentricNetwork, GoalNetwork, make_network
    from autonerf_lab.policies.symmetry import Symmetric
    from autonerf_lab.policies.weights import load_weights, read_meta

    view, network = make_network(read_meta(path)["network"])
    if isinstance(network, GoalNetwork):
        raise DataError(f"{path} holds a policy that goes to a place it is told; it does not explore")
    if trained:
        load_weights(path, network)
    if isinstance(network, EgocentricNetwork):
        return EndToEnd(view, network)
    return Modular(view, Symmetric(network) if isinstance(network, CompactNetwork) else network)


POLICIES: dict[str, Callable[[], Policy]] = {
    "random": RandomWalk,
    "random-waypoints": RandomWaypoints,
    "frontier": Frontier,
    **{path.stem: partial(load_policy, path) for path in sorted(WEIGHTS.glob("*.safetensors"))},
}


def make_policy(name: str) -> Policy:
    """A policy by its name, or one of your own training by the path of its weights.

    Raises:
        UnknownNameError: lists the valid names.
        DataError: the weights are missing or damaged.

    Example:
        >>> make_policy("random").waypoint is None
        True
    """
    if name.endswith(".safetensors"):
        return load_policy(name)
    if name not in POLICIES:
        raise UnknownNameError("policy", name, POLICIES)
    return POLICIES[name]()


__all__ = [
    "POLICIES",
    "WEIGHTS",
    "Frontier",
    "Policy",
    "RandomWalk",
    "RandomWaypoints",
    "load_policy",
    "make_policy",
    "weights_path",
    "weights_sha256",
]
