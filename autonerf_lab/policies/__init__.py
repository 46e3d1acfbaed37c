"""Exploration policies, by name.

A package registers its own policy, a class or function that is called without arguments, in its ``pyproject.toml``::

    [project.entry-points."autonerf_lab.policies"]
    my-policy = "my_package:MyPolicy"

``examples/policy_plugin`` is such a package.
"""

import hashlib
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from autonerf_lab.errors import DataError, UnknownNameError, WrongTypeError
from autonerf_lab.policies.base import Policy, PrivilegedPolicy
from autonerf_lab.policies.conformance import check_members, check_policy
from autonerf_lab.policies.frontier import Frontier
from autonerf_lab.policies.frontier_classic import FrontierClassic
from autonerf_lab.policies.oracle import COUNTED, Oracle
from autonerf_lab.policies.random_policies import RandomActions, RandomWaypoints
from autonerf_lab.utils.plugins import load_plugins, with_members

WEIGHTS = Path(__file__).parent / "weights"


def weights_path(policy: str) -> Path:
    """Return the path of a policy's weights: in the package for a name, the path itself for ``.safetensors``.

    The file need not exist.

    Example:
        >>> weights_path("frontier").exists(), weights_path("mine/policy.safetensors").as_posix()
        (False, 'mine/policy.safetensors')
    """
    return Path(policy) if policy.endswith(".safetensors") else WEIGHTS / f"{policy}.safetensors"


def weights_sha256(policy: str) -> str | None:
    """Return the SHA-256 of a policy's weights, in hexadecimal; None for a policy without weights."""
    path = weights_path(policy)
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.exists() else None


def load_policy(path: str | Path, trained: bool = True) -> Policy:
    """Load a trained policy from ``path``.safetensors and ``path``.json.

    Args:
        path: path of both files, without suffix or with one of theirs.
        trained: False for the untrained network, the baseline of a training.

    Raises:
        DataError: a file is missing, damaged or made for another network, or the policy does not explore.
    """
    # These modules import torch, which the other policies do not need.
    from autonerf_lab.policies.spec import make_network, spec_of
    from autonerf_lab.policies.weights import load_weights, read_meta

    settings = read_meta(path)["network"]
    spec = spec_of(settings)
    if spec.policy is None:
        raise DataError(f"{path} contains a {spec.name} policy, which goes to a given goal and does not explore")
    interface, network = make_network(settings)
    if trained:
        load_weights(path, network)
    return spec.policy(interface, network)


POLICIES: dict[str, Callable[[], Policy]] = {
    "random": RandomActions,
    "random-waypoints": RandomWaypoints,
    "frontier": Frontier,
    "frontier-classic": FrontierClassic,
    **{path.stem: partial(load_policy, path) for path in sorted(WEIGHTS.glob("*.safetensors"))},
    **{f"oracle-{reward}": partial(Oracle, reward) for reward in COUNTED},
}


def available() -> dict[str, Callable[[], Policy]]:
    """Return the built-in policies and those of installed packages, as in :data:`POLICIES`.

    A policy that cannot be imported, does not pass :func:`~autonerf_lab.policies.conformance.check_policy` or uses a
    built-in name is left out with a :class:`~autonerf_lab.utils.plugins.PluginWarning`.
    """
    return load_plugins("policies", POLICIES, object, check_policy)


def make_policy(policy: str | Policy) -> Policy:
    """Make a policy.

    Args:
        policy: a name in :func:`available`, the path of ``.safetensors`` weights, ``module:Class`` for an importable
            class without constructor arguments, or a policy, which is returned as it is.

    Raises:
        UnknownNameError: unknown name; lists the valid names.
        DataError: the weights are missing or damaged, or ``module:Class`` cannot be imported or created.
        WrongTypeError: the object has not the members of a :class:`Policy`.

    Example:
        >>> make_policy("random").waypoint is None
        True
        >>> type(make_policy("autonerf_lab.policies.frontier:Frontier")).__name__
        'Frontier'
    """
    if not isinstance(policy, str):
        return with_members(policy, type(policy).__name__, "policy", check_members)
    if policy.endswith(".safetensors"):
        return load_policy(policy)
    if policy in POLICIES:
        return POLICIES[policy]()
    if ":" in policy:
        return with_members(_import(policy), policy, "policy", check_members)
    found = available()
    if policy not in found:
        raise UnknownNameError("policy", policy, found)
    return found[policy]()


def _import(path: str) -> Any:
    """Create the object of ``module:Class``."""
    module, _, name = path.partition(":")
    try:
        make = getattr(import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise DataError(
            f"policy {path!r} cannot be imported: {error}; write module:Class, and install the module or add its "
            "folder to PYTHONPATH"
        ) from error
    except (Exception, SystemExit) as error:  # any other error of the module itself
        raise DataError(f"policy {path!r} cannot be imported: {error!r}; correct its module") from error
    if not callable(make):
        raise WrongTypeError(f"policy {path!r} is a {type(make).__name__}, not a class")
    try:
        return make()
    except Exception as error:  # any error of the class itself
        raise DataError(f"policy {path!r} cannot be created without arguments: {error!r}") from error


__all__ = [
    "POLICIES",
    "WEIGHTS",
    "Frontier",
    "FrontierClassic",
    "Oracle",
    "Policy",
    "PrivilegedPolicy",
    "RandomActions",
    "RandomWaypoints",
    "available",
    "check_policy",
    "load_policy",
    "make_policy",
    "weights_path",
    "weights_sha256",
]
