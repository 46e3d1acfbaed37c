"""What a reward is: anything that can be called with a transition and returns a float."""

import inspect
import math
import re
import reprlib
from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import numpy as np

from autonerf_lab.errors import RewardError
from autonerf_lab.types import MapState, Observation, Transition


class Reward(Protocol):
    """Called once a step.

    The first line of its docstring names the unit, after a comma and before a full stop or colon:
    ``Newly explored area, square metres.``

    A reward that remembers something over an episode also has ``reset(rng)``, called when one begins.
    """

    def __call__(self, transition: Transition) -> float:
        """The reward of one step, in the unit that its docstring names."""


@runtime_checkable
class PrivilegedReward(Protocol):
    """A reward that is shown places of the scene which the robot has not seen: ground truth that no policy gets."""

    references: int  # how many it wants to be shown, at poses drawn uniformly over the navigable ground

    def __call__(self, transition: Transition) -> float:
        """The reward of one step."""

    def show(self, observations: list[Observation]) -> None:
        """The places of this episode, after ``reset``."""


@runtime_checkable
class LearnedReward(Protocol):
    """A reward that learns from what the robot sees. Many may see, each in its environment; one of them learns.

    The one that learns hands its state to the others. The state is all that was learned, so that training goes on bit
    for bit; what a reward remembers of a running episode is not part of it, and is not touched by loading one.
    """

    def __call__(self, transition: Transition) -> float:
        """The reward of one step."""

    def collect(self) -> dict[str, np.ndarray]:
        """What was seen since the last call, and forgets it. The first axis of every array counts samples."""

    def update(self, batch: dict[str, np.ndarray]) -> dict[str, float]:
        """One pass over what was collected, each array the concatenation of those of all environments.

        Returns:
            Losses, to be logged; none where nothing was collected.

        Raises:
            TrainingError: a loss is not finite.
        """

    def state_dict(self) -> dict[str, np.ndarray]:
        """Parameters, moments of the optimiser, statistics, seeds and counters. The arrays are copies."""

    def load_state_dict(self, state: dict[str, np.ndarray]) -> None:
        """Go on from there.

        Raises:
            DataError: it is the state of something else.
        """


def fresh(entry: Callable[..., Any]) -> Reward:
    """A reward out of what is registered: what can be called with nothing makes one, anything else is one.

    Example:
        >>> class Always:
        ...     def __call__(self, transition):
        ...         return 1.0
        >>> isinstance(fresh(Always), Always), fresh(len) is len
        (True, True)
    """
    try:
        inspect.signature(entry).bind()
    except (TypeError, ValueError):  # it needs an argument, or is written in C and does not say
        return entry
    made: Reward = entry()
    return made


def name_of(reward: object) -> str:
    """What a reward is called in messages: its name, or that of its function or class."""
    return reward if isinstance(reward, str) else getattr(reward, "__name__", type(reward).__name__)


def unit_of(reward: Reward) -> str:
    """The unit that the first line of a docstring names, after a comma and before a full stop or colon; or nothing.

    Example:
        >>> def steps(transition):
        ...     '''The time that passed, steps: always one.'''
        >>> unit_of(steps)
        'steps'
    """
    found = re.match(r"[^\n]*?, ([^\n,:.]+)[:.]", inspect.getdoc(reward) or "")
    return found[1] if found else ""


def evaluate(reward: Reward, transition: Transition, name: str) -> float:
    """The reward of one step, checked.

    Raises:
        RewardError: it failed, or is not a finite float; names the reward, the value and the step.
    """
    step = transition.observation.step
    try:
        value = reward(transition)
    except RewardError:
        raise
    except Exception as error:
        raise RewardError(f"reward {name!r} failed at step {step}: {type(error).__name__}: {error}") from error
    if not isinstance(value, float) or not math.isfinite(value):
        raise RewardError(f"reward {name!r} returned {reprlib.repr(value)} at step {step}, not a finite float")
    return float(value)


def growth(before: np.ndarray, after: np.ndarray, map: MapState) -> float:
    """Area by which the set cells of a map have grown, summed over its channels, square metres."""
    return float(np.count_nonzero(after) - np.count_nonzero(before)) * map.cell**2
