"""The policies, by name."""

from collections.abc import Callable

from autonerf_lab.errors import UnknownNameError
from autonerf_lab.policies.base import Policy
from autonerf_lab.policies.frontier import Frontier
from autonerf_lab.policies.random_walk import RandomWalk, RandomWaypoints

POLICIES: dict[str, Callable[[], Policy]] = {
    "random": RandomWalk,
    "random-waypoints": RandomWaypoints,
    "frontier": Frontier,
}


def make_policy(name: str) -> Policy:
    """A policy by its name.

    Raises:
        UnknownNameError: lists the valid names.

    Example:
        >>> make_policy("frontire")
        Traceback (most recent call last):
        autonerf_lab.errors.UnknownNameError: unknown policy 'frontire'; valid names: frontier, random, random-waypoints
    """
    if name not in POLICIES:
        raise UnknownNameError("policy", name, POLICIES)
    return POLICIES[name]()


__all__ = ["POLICIES", "Frontier", "Policy", "RandomWalk", "RandomWaypoints", "make_policy"]
