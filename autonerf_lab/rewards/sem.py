"""Semantic object coverage, the ``sem.`` of AutoNeRF (Marza et al., section 4.1)."""

from autonerf_lab.rewards.base import newly_set_area
from autonerf_lab.types import Transition


def sem(transition: Transition) -> float:
    """Newly mapped area of the 15 object classes, square metres: ``sum_ijk m_sem[t] - m_sem[t-1]``.

    A cell with two classes counts twice.

    Example:
        >>> from autonerf_lab.rewards.conformance import blank_transition
        >>> step = blank_transition(cell=0.5)
        >>> step.after.semantics[0, 3, 4] = step.after.semantics[7, 3, 4] = True
        >>> sem(step)
        0.5
    """
    return newly_set_area(transition.before.semantics, transition.after.semantics, transition.after)
