"""What a reward is: anything that can be called with a transition and returns a float."""

from typing import Protocol

import numpy as np

from autonerf_lab.types import MapState, Transition


class Reward(Protocol):
    """Called once a step. A reward that counts something over an episode also has ``reset(rng)``."""

    def __call__(self, transition: Transition) -> float:
        """The reward of one step, in the unit that its docstring names."""


def growth(before: np.ndarray, after: np.ndarray, map: MapState) -> float:
    """Area by which the set cells of a map have grown, summed over its channels, square metres."""
    return float(np.count_nonzero(after) - np.count_nonzero(before)) * map.cell**2
