"""What a walk is rewarded for. One file a reward; this is the table of contents.

``cov``, ``obs``, ``sem`` and ``view`` are those of AutoNeRF (Marza et al.); ``nov``, ``cur`` and ``rec`` those of
Ramakrishnan et al. 2021. What stands in :data:`REWARDS` is a reward if it is called with a transition, and makes one if
it is called with nothing: what remembers or learns is made anew for each environment. A package of yours registers::

    [project.entry-points."autonerf_lab.rewards"]
    my-reward = "my_package:MyReward"
"""

import re
from collections.abc import Callable, Mapping
from typing import Any

from autonerf_lab.errors import RewardError, UnknownNameError, WrongTypeError
from autonerf_lab.rewards.base import LearnedReward, PrivilegedReward, Reward, evaluate, fresh, name_of, unit_of
from autonerf_lab.rewards.conformance import check_reward
from autonerf_lab.rewards.cov import cov
from autonerf_lab.rewards.nov import Novelty
from autonerf_lab.rewards.obs import obs
from autonerf_lab.rewards.sem import sem
from autonerf_lab.rewards.view import view
from autonerf_lab.rewards.weighted_sum import WeightedSum
from autonerf_lab.utils.plugins import installed


def curiosity() -> LearnedReward:
    """Makes ``cur``. Only this imports torch."""
    from autonerf_lab.rewards.cur import Curiosity

    return Curiosity()


def reconstruction() -> LearnedReward:
    """Makes ``rec``. Only this imports torch."""
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
    """Built-in rewards and those of installed packages, as in :data:`REWARDS`.

    One that does not import, is no reward, fails on a made-up step, or takes a name that exists is left out with a
    :class:`~autonerf_lab.utils.plugins.PluginWarning`.
    """
    return installed("rewards", REWARDS, object, check_reward)


def make_reward(reward: str | Callable[..., Any]) -> Reward:
    """A reward by its name, or a weighted sum of names; a reward of one's own is returned as it is.

    Whatever remembers something is made anew at each call, unless it is handed in as an object.

    Raises:
        UnknownNameError: lists the valid names.
        RewardError: a sum that cannot be read; names the term.
        WrongTypeError: neither a name nor anything that can be called.

    Example:
        >>> make_reward("cov") is cov
        True
        >>> make_reward("cov+0.1*nov").terms()
        {'cov': 0.0, 'nov': 0.0}
    """
    if not isinstance(reward, str):
        if not callable(reward):
            raise WrongTypeError(f"a reward is a name or is called with a transition, not a {type(reward).__name__}")
        return fresh(reward)
    if reward in REWARDS:
        return fresh(REWARDS[reward])
    if re.search(r"[+*]", reward):
        return weighted(_read_sum(reward))
    found = available()
    if reward not in found:
        raise UnknownNameError("reward", reward, found)
    return fresh(found[reward])


def weighted(terms: Mapping[str | Callable[..., Any], float]) -> WeightedSum:
    """A weighted sum of rewards, given by names or as they are.

    Raises:
        UnknownNameError: lists the valid names.
        RewardError: a weight is not a finite number, or two terms have the same name.

    Example:
        >>> weighted({"cov": 1.0, "nov": 0.1}).terms()
        {'cov': 0.0, 'nov': 0.0}
    """
    made: dict[str, tuple[float, Reward]] = {}
    for term, weight in terms.items():
        name = name_of(term)
        if name in made:
            raise RewardError(f"two terms of a weighted sum have the name {name!r}")
        made[name] = weight, make_reward(term)
    return WeightedSum(made)


def _read_sum(text: str) -> dict[str | Callable[..., Any], float]:
    """``"cov+0.1*nov"`` -> {"cov": 1.0, "nov": 0.1}."""
    terms: dict[str | Callable[..., Any], float] = {}
    for term in text.split("+"):
        weight, star, name = term.rpartition("*")
        name = name.strip()
        try:
            value = float(weight) if star else 1.0
        except ValueError:
            raise RewardError(f"{text!r} is no weighted sum: {term!r} is neither NAME nor WEIGHT*NAME") from None
        if name in terms:
            raise RewardError(f"{text!r} has the term {name!r} twice")
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
    "sem",
    "unit_of",
    "view",
    "weighted",
]
