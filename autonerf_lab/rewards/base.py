"""Interfaces of rewards: a reward is called with a transition and returns a real number."""

import inspect
import math
import re
import reprlib
from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import numpy as np

from autonerf_lab.errors import RewardError
from autonerf_lab.types import MapState, Observation, Transition
from autonerf_lab.utils.plugins import named_errors


class Reward(Protocol):
    """Reward function, called once per step.

    The first line of its docstring names the unit, after a comma and before a full stop or colon:
    ``Newly explored area, square metres.``

    A reward with state also has a method ``reset(rng)``, which is called at the start of each episode. The arrays of a
    transition are read-only and reused by later steps: copy to change or keep them.
    """

    def __call__(self, transition: Transition) -> float:
        """Return the reward of one step: a float, an int, a NumPy number, or an array or tensor without dimensions."""


@runtime_checkable
class PrivilegedReward(Protocol):
    """Reward that also gets observations from random poses of the scene: ground truth that no policy gets."""

    references: int  # number of these observations per episode; their poses are navigable

    def __call__(self, transition: Transition) -> float:
        """Return the reward of one step."""

    def set_references(self, observations: list[Observation]) -> None:
        """Receive the ``references`` observations of a new episode; called after ``reset``."""


@runtime_checkable
class LearnedReward(Protocol):
    """Reward that learns from the observations of the robot.

    In training each environment has a copy that collects samples. One more copy learns from all samples and distributes
    its state to the others. The state contains everything learned, so that a resumed training gives identical results.
    It does not contain the state of a running episode, and loading it leaves a running episode unchanged.
    """

    def __call__(self, transition: Transition) -> float:
        """Return the reward of one step."""

    def collect(self) -> dict[str, np.ndarray]:
        """Return and clear the samples since the last call; the first axis of every array is the sample."""

    def update(self, batch: dict[str, np.ndarray]) -> dict[str, float]:
        """Train for one pass over the samples of all environments, concatenated.

        Returns:
            Losses for the log; empty without samples.

        Raises:
            TrainingError: a loss is not finite.
        """

    def state_dict(self) -> dict[str, np.ndarray]:
        """Return copies of everything learned: parameters, optimiser moments, statistics, seeds and counters."""

    def load_state_dict(self, state: dict[str, np.ndarray]) -> None:
        """Load a state.

        Raises:
            DataError: the state belongs to another reward.
        """


def instantiate(entry: Callable[..., Any]) -> Reward:
    """Make a reward from a registered entry: call it if it needs no argument, else return it.

    Example:
        >>> class Always:
        ...     def __call__(self, transition):
        ...         return 1.0
        >>> isinstance(instantiate(Always), Always), instantiate(len) is len
        (True, True)
    """
    try:
        inspect.signature(entry).bind()
    except (TypeError, ValueError):  # it needs an argument, or has no signature
        return entry
    made: Reward = entry()
    return made


def name_of(reward: object) -> str:
    """Return the name of a reward in messages: the name itself, or that of the function or class."""
    return reward if isinstance(reward, str) else getattr(reward, "__name__", type(reward).__name__)


def unit_of(reward: Reward) -> str:
    """Return the unit in the first line of a docstring, after a comma and before a full stop or colon; else "".

    Example:
        >>> def steps(transition):
        ...     '''Duration, steps: always one.'''
        >>> unit_of(steps)
        'steps'
    """
    found = re.match(r"[^\n]*?, ([^\n,:.]+)[:.]", inspect.getdoc(reward) or "")
    return found[1] if found else ""


def reset_reward(reward: Reward, rng: np.random.Generator, name: str) -> None:
    """Call the method ``reset`` of a reward, if it has one, at the start of an episode.

    Raises:
        RewardError: ``reset`` raised an exception; the message contains ``name``.
    """
    reset = getattr(reward, "reset", None)
    if reset is None:
        return
    with named_errors(f"reward {name!r}", "in reset", RewardError, passed=RewardError):
        reset(rng)


def evaluate(reward: Reward, transition: Transition, name: str) -> float:
    """Call a reward and convert its value to a float.

    Raises:
        RewardError: the reward raised an exception, or its value is not a finite number; the message contains the name,
            the value and the step.
    """
    step = transition.observation.step
    with named_errors(f"reward {name!r}", f"at step {step}", RewardError, passed=RewardError):
        value = reward(transition)
    number = to_float(value)
    if number is None or not math.isfinite(number):
        raise RewardError(f"reward {name!r} returned {reprlib.repr(value)} at step {step}, not a finite number")
    return number


def to_float(value: Any) -> float | None:
    """Convert a real number to a float; None for anything else.

    Numbers are bool, int, float, NumPy numbers, and arrays and tensors without dimensions.

    Example:
        >>> to_float(np.float32(0.5)), to_float(np.array(2)), to_float("1.0"), to_float(np.ones(1))
        (0.5, 2.0, None, None)
    """
    try:
        kind = getattr(getattr(value, "dtype", None), "kind", "f")  # tensors have no kind; complex ones fail below
        dimensions: int = getattr(value, "ndim", 0)
        if isinstance(value, str | bytes | bytearray) or dimensions > 0 or kind not in "biuf":
            return None
        return float(value)
    except Exception:  # third-party code in __float__ may raise anything
        return None


def newly_set_area(before: np.ndarray, after: np.ndarray, map: MapState) -> float:
    """Increase of a map channel over one step, m²; channels are summed."""
    return float(np.count_nonzero(after) - np.count_nonzero(before)) * map.cell**2
