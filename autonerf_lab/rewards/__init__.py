"""Rewards for exploration, one file per reward.

``cov``, ``obs``, ``sem`` and ``view`` are the rewards of AutoNeRF (Marza et al.); ``nov``, ``cur`` and ``rec`` those of
Ramakrishnan et al. 2021. An entry of :data:`REWARDS` is either a function of a transition, or a class or function
without arguments that makes a reward with state, a new one for each environment. A package registers its own reward in
its ``pyproject.toml``::

    [project.entry-points."autonerf_lab.rewards"]
    my-reward = "my_package:MyReward"
"""

import re
from collections.abc import Callable, Mapping
from typing import Any

from autonerf_lab.errors import RewardError, UnknownNameError, WrongTypeError
from autonerf_lab.rewards.base import (
    LearnedReward,
    PrivilegedReward,
    Reward,
    evaluate,
    instantiate,
    name_of,
    reset_reward,
    unit_of,
)
from autonerf_lab.rewards.conformance import check_reward
from autonerf_lab.rewards.cov import cov
from autonerf_lab.rewards.nov import Novelty
from autonerf_lab.rewards.obs import obs
from autonerf_lab.rewards.sem import sem
from autonerf_lab.rewards.view import view
from autonerf_lab.rewards.weighted_sum import WeightedSum
from autonerf_lab.utils.plugins import load_plugins


def curiosity() -> LearnedReward:
    """Make the reward ``cur``; torch is imported here and not with the package."""
    from autonerf_lab.rewards.cur import Curiosity

    return Curiosity()


def reconstruction() -> LearnedReward:
    """Make the reward ``rec``; torch is imported here and not with the package."""
    from autonerf_lab.rewards.rec import Reconstruction

    return Reconstruction()


REWARDS: dict[str, Callable[..., Any]] = {
    "cov": cov,
    "obs": obs,
    "sem": sem,
    "view": view,
    "nov": Novelty,
    "cur": curiosity,
    "rec": reconstruction,
}


def available() -> dict[str, Callable[..., Any]]:
    """Return the built-in rewards and those of installed packages, as in :data:`REWARDS`.

    A reward that cannot be imported, does not pass :func:`~autonerf_lab.rewards.conformance.check_reward` or uses a
    built-in name is left out with a :class:`~autonerf_lab.utils.plugins.PluginWarning`.
    """
    return load_plugins("rewards", REWARDS, object, check_reward)


def make_reward(reward: str | Callable[..., Any]) -> Reward:
    """Make a reward.

    Args:
        reward: a name in :func:`available`, a weighted sum such as ``"cov+0.1*nov"``, or a reward (or a class of
            rewards) of your own. A class is instantiated at each call; an object is returned unchanged.

    Raises:
        UnknownNameError: unknown name; lists the valid names.
        RewardError: a weighted sum that cannot be parsed; names the term.
        WrongTypeError: neither a name nor callable.

    Example:
        >>> make_reward("cov") is cov
        True
        >>> make_reward("cov+0.1*nov").terms()
        {'cov': 0.0, 'nov': 0.0}
    """
    if not isinstance(reward, str):
        if not callable(reward):
            raise WrongTypeError(f"a reward must be a name or a callable, not a {type(reward).__name__}")
        return instantiate(reward)
    if reward in REWARDS:
        return instantiate(REWARDS[reward])
    if re.search(r"[+*]", reward):
        return weighted(_read_sum(reward))
    found = available()
    if reward not in found:
        raise UnknownNameError("reward", reward, found)
    return instantiate(found[reward])


def weighted(terms: Mapping[str | Callable[..., Any], float]) -> WeightedSum:
    """Make a weighted sum of rewards.

    Args:
        terms: weight of each reward; a key is a name or a reward.

    Raises:
        UnknownNameError: unknown name; lists the valid names.
        RewardError: a weight is not a finite number, or two terms have the same name.

    Example:
        >>> weighted({"cov": 1.0, "nov": 0.1}).terms()
        {'cov': 0.0, 'nov': 0.0}
    """
    made: dict[str, tuple[float, Reward]] = {}
    for term, weight in terms.items():
        name = name_of(term)
        if name in made:
            raise RewardError(f"two terms of the weighted sum have the name {name!r}; add up their weights")
        made[name] = weight, make_reward(term)
    return WeightedSum(made)


def _read_sum(text: str) -> dict[str | Callable[..., Any], float]:
    """Parse a weighted sum: ``"cov+0.1*nov"`` -> {"cov": 1.0, "nov": 0.1}."""
    terms: dict[str | Callable[..., Any], float] = {}
    for term in text.split("+"):
        weight, star, name = term.rpartition("*")
        name = name.strip()
        try:
            value = float(weight) if star else 1.0
        except ValueError:
            raise RewardError(f"{text!r} is not a weighted sum: {term!r} is neither NAME nor WEIGHT*NAME") from None
        if name in terms:
            raise RewardError(f"{text!r} contains the term {name!r} twice; add up their weights")
        terms[name] = value
    return terms


__all__ = [
    "REWARDS",
    "LearnedReward",
    "PrivilegedReward",
    "Reward",
    "WeightedSum",
    "available",
    "cov",
    "evaluate",
    "make_reward",
    "name_of",
    "obs",
    "reset_reward",
    "sem",
    "unit_of",
    "view",
    "weighted",
]
