"""Novelty, the ``nov.`` of Ramakrishnan et al. 2021, "An Exploration of Embodied Visual Exploration"."""

from collections import Counter

import numpy as np

from autonerf_lab.types import Transition

CELL = 0.5  # metres


class Novelty:
    """Novelty of the robot's position, dimensionless: ``1 / sqrt(N(cell))``.

    N is the number of steps of this episode, this one included, that ended in the same cell of 0.5 m x 0.5 m. Positions
    are those of the odometry.

    Example:
        >>> from autonerf_lab.rewards.conformance import blank_transition
        >>> reward, step = Novelty(), blank_transition()
        >>> [reward(step) for _ in range(4)][::3]
        [1.0, 0.5]
    """

    def __init__(self) -> None:
        self._visits: Counter[tuple[int, int]] = Counter()

    def reset(self, rng: np.random.Generator) -> None:
        """Clear the counts of the last episode."""
        self._visits.clear()

    def __call__(self, transition: Transition) -> float:
        """Return the novelty after one step."""
        x, y = np.floor(transition.observation.pose[:2, 3] / CELL)
        self._visits[int(x), int(y)] += 1
        return float(1 / np.sqrt(self._visits[int(x), int(y)]))
