"""Explored area coverage, the ``cov.`` of AutoNeRF (Marza et al., section 4.1)."""

from autonerf_lab.rewards.base import newly_set_area
from autonerf_lab.types import Transition


def cov(transition: Transition) -> float:
    """Newly explored area, square metres: ``sum_ij m_exp[t] - m_exp[t-1]``.

    Example:
        >>> from autonerf_lab.rewards.conformance import blank_transition
        >>> step = blank_transition(cell=0.5)
        >>> step.after.explored[3, 4] = True
        >>> cov(step)
        0.25
    """
    return newly_set_area(transition.before.explored, transition.after.explored, transition.after)
