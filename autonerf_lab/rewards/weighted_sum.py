"""Several rewards as one."""

import math
from collections.abc import Mapping

import numpy as np

from autonerf_lab.errors import DataError, RewardError
from autonerf_lab.rewards.base import LearnedReward, PrivilegedReward, Reward, evaluate
from autonerf_lab.types import Observation, Transition

Arrays = dict[str, np.ndarray]


class WeightedSum:
    """A weighted sum of rewards, unit of the sum: each term in its own times its weight.

    It passes on whatever a term has beside being called; arrays and losses of a term are ``term/name``.

    Args:
        terms: name -> weight and reward.

    Raises:
        RewardError: there is no term, or a weight is not finite.

    Example:
        >>> from autonerf_lab.rewards.conformance import blank_transition
        >>> both = WeightedSum({"one": (1.0, lambda transition: 1.0), "two": (0.5, lambda transition: 2.0)})
        >>> both(blank_transition()), both.terms()
        (2.0, {'one': 1.0, 'two': 2.0})
    """

    def __init__(self, terms: Mapping[str, tuple[float, Reward]]) -> None:
        if not terms:
            raise RewardError("a weighted sum needs at least one term")
        for name, (weight, _) in terms.items():
            if not isinstance(weight, int | float) or not math.isfinite(weight):
                raise RewardError(f"the weight of the reward {name!r} is {weight!r}, not a finite number")
        self._terms = dict(terms)
        self._values = dict.fromkeys(self._terms, 0.0)
        self._learned = {k: term for k, (_, term) in terms.items() if isinstance(term, LearnedReward)}
        self._privileged = [term for _, term in terms.values() if isinstance(term, PrivilegedReward)]

    def __call__(self, transition: Transition) -> float:
        self._values = {name: evaluate(term, transition, name) for name, (_, term) in self._terms.items()}
        return float(sum(weight * self._values[name] for name, (weight, _) in self._terms.items()))

    def terms(self) -> dict[str, float]:
        """What each term was at the last step, before its weight; 0 at the start of an episode."""
        return dict(self._values)

    def reset(self, rng: np.random.Generator) -> None:
        """An episode begins."""
        self._values = dict.fromkeys(self._terms, 0.0)
        for _, term in self._terms.values():
            forget = getattr(term, "reset", None)
            if forget is not None:
                forget(rng)

    @property
    def references(self) -> int:
        """As many places as the term that wants most."""
        return max((term.references for term in self._privileged), default=0)

    def show(self, observations: list[Observation]) -> None:
        """To each term as many places as it wants."""
        for term in self._privileged:
            term.show(observations[: term.references])

    def collect(self) -> Arrays:
        """What the learned terms have seen."""
        return {f"{name}/{k}": v for name, term in self._learned.items() for k, v in term.collect().items()}

    def update(self, batch: Arrays) -> dict[str, float]:
        """One pass of each learned term."""
        learned = self._learned.items()
        return {f"{name}/{k}": v for name, term in learned for k, v in term.update(_of(name, batch)).items()}

    def state_dict(self) -> Arrays:
        """Of the learned terms."""
        return {f"{name}/{k}": v for name, term in self._learned.items() for k, v in term.state_dict().items()}

    def load_state_dict(self, state: Arrays) -> None:
        """Go on from there.

        Raises:
            DataError: it is the state of something else.
        """
        for key in state:
            if not any(key.startswith(f"{name}/") for name in self._learned):
                raise DataError(f"this is not the state of this reward: none of its learned terms has {key!r}")
        for name, term in self._learned.items():
            term.load_state_dict(_of(name, state))


def _of(name: str, arrays: Arrays) -> Arrays:
    return {k.removeprefix(f"{name}/"): v for k, v in arrays.items() if k.startswith(f"{name}/")}
