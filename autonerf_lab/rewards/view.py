"""Viewpoint coverage, the ``view.`` of AutoNeRF (Marza et al., section 4.1)."""

from autonerf_lab.rewards.base import newly_set_area
from autonerf_lab.types import Transition


def view(transition: Transition) -> float:
    """Area newly seen from one of 12 directions, square metres: ``sum_ijk m_view[t] - m_view[t-1]``.

    A cell that is seen from all directions counts twelve times.

    Example:
        >>> from autonerf_lab.rewards.conformance import blank_transition
        >>> step = blank_transition(cell=0.5)
        >>> step.after.viewpoints[:, 3, 4] = True
        >>> view(step)
        3.0
    """
    return newly_set_area(transition.before.viewpoints, transition.after.viewpoints, transition.after)
