"""Obstacle coverage, the ``obs.`` of AutoNeRF (Marza et al., section 4.1)."""

from autonerf_lab.rewards.base import newly_set_area
from autonerf_lab.types import Transition


def obs(transition: Transition) -> float:
    """Area of newly mapped obstacles, square metres: ``sum_ij m_occ[t] - m_occ[t-1]``.

    Example:
        >>> from autonerf_lab.rewards.conformance import blank_transition
        >>> step = blank_transition(cell=0.5)
        >>> step.after.occupied[3, 4] = True
        >>> obs(step)
        0.25
    """
    return newly_set_area(transition.before.occupied, transition.after.occupied, transition.after)
