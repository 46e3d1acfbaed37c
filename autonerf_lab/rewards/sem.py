"""Semantic object coverage, the ``sem.`` of AutoNeRF (Marza et al., section 4.1)."""

from autonerf_lab.rewards.base import growth
from autonerf_lab.types import Transition


def sem(transition: Transition) -> float:
    """Newly mapped area of the 15 object classes, square metres: ``sum_ijk m_sem[t] - m_sem[t-1]``.

    Where two classes share a cell, both count.

    Example:
        >>> from autonerf_lab.rewards.conformance import blank_transition
        >>> step = blank_transition(cell=0.5)
        >>> step.after.semantics[0, 3, 4] = step.after.semantics[7, 3, 4] = True
        >>> sem(step)
        0.5
    """
    return growth(transition.before.semantics, transition.after.semantics, transition.after)
