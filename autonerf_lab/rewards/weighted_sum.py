"""Weighted sum of rewards."""

import math
import reprlib
from collections.abc import Mapping

import numpy as np

from autonerf_lab.errors import DataError, RewardError
from autonerf_lab.rewards.base import LearnedReward, PrivilegedReward, Reward, evaluate, reset_reward, to_float
from autonerf_lab.types import Observation, Transition

Arrays = dict[str, np.ndarray]


class WeightedSum:
    """Weighted sum of rewards, mixed units: the unit of each term times its weight.

    Every optional method of the terms is forwarded; arrays and losses of a term get the prefix ``term/``.

    Args:
        terms: weight and reward of each name.

    Raises:
        RewardError: no term, or a weight that is not finite.

    Example:
        >>> from autonerf_lab.rewards.conformance import blank_transition
        >>> both = WeightedSum({"one": (1.0, lambda transition: 1.0), "two": (0.5, lambda transition: 2.0)})
        >>> both(blank_transition()), both.terms()
        (2.0, {'one': 1.0, 'two': 2.0})
    """

    def __init__(self, terms: Mapping[str, tuple[float, Reward]]) -> None:
        if not terms:
            raise RewardError("a weighted sum needs at least one term")
        self._terms: dict[str, tuple[float, Reward]] = {}
        for name, (weight, term) in terms.items():
            number = to_float(weight)
            if number is None or not math.isfinite(number):
                raise RewardError(f"the weight of reward {name!r} is {reprlib.repr(weight)}, not a finite number")
            self._terms[name] = number, term
        self._values = dict.fromkeys(self._terms, 0.0)
        self._learners = {k: term for k, (_, term) in terms.items() if isinstance(term, LearnedReward)}
        self._privileged = [term for _, term in terms.values() if isinstance(term, PrivilegedReward)]

    def __call__(self, transition: Transition) -> float:
        """Return the weighted sum of the rewards of one step."""
        self._values = {name: evaluate(term, transition, name) for name, (_, term) in self._terms.items()}
        return float(sum(weight * self._values[name] for name, (weight, _) in self._terms.items()))

    def terms(self) -> dict[str, float]:
        """Return the unweighted value of each term at the last step; 0 at the start of an episode."""
        return dict(self._values)

    def reset(self, rng: np.random.Generator) -> None:
        """Reset all terms."""
        self._values = dict.fromkeys(self._terms, 0.0)
        for name, (_, term) in self._terms.items():
            reset_reward(term, rng, name)

    @property
    def references(self) -> int:
        """Largest number of references of any term."""
        return max((term.references for term in self._privileged), default=0)

    def set_references(self, observations: list[Observation]) -> None:
        """Pass each privileged term its number of references."""
        for term in self._privileged:
            term.set_references(observations[: term.references])

    def collect(self) -> Arrays:
        """Collect the samples of the learned terms."""
        return {f"{name}/{k}": v for name, term in self._learners.items() for k, v in term.collect().items()}

    def update(self, batch: Arrays) -> dict[str, float]:
        """Train each learned term for one pass."""
        learned = self._learners.items()
        return {f"{name}/{k}": v for name, term in learned for k, v in term.update(_of(name, batch)).items()}

    def state_dict(self) -> Arrays:
        """Return the states of the learned terms."""
        return {f"{name}/{k}": v for name, term in self._learners.items() for k, v in term.state_dict().items()}

    def load_state_dict(self, state: Arrays) -> None:
        """Load a state of :meth:`state_dict`.

        Raises:
            DataError: the state belongs to another reward.
        """
        for key in state:
            if not any(key.startswith(f"{name}/") for name in self._learners):
                raise DataError(f"the state belongs to another reward: no learned term of this sum has {key!r}")
        for name, term in self._learners.items():
            term.load_state_dict(_of(name, state))


def _of(name: str, arrays: Arrays) -> Arrays:
    return {k.removeprefix(f"{name}/"): v for k, v in arrays.items() if k.startswith(f"{name}/")}
