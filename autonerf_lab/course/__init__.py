"""Exercises of the notebooks with a checker that gives hints, and interactive widgets.

Each module of ``exercises`` belongs to one notebook. In a notebook::

    from autonerf_lab import course

    course.check("01-heading", my_function)  # verdict with a hint
    course.solution("01-heading")  # hidden until it is clicked
"""

from typing import Any

from autonerf_lab.course.checker import Exercise, Solution, Verdict
from autonerf_lab.course.exercises import (
    apartments,
    exploration,
    hash_encoding,
    image_metrics,
    mapping,
    meshes,
    photographs,
    planning,
    pose_refinement,
    ppo,
    rewards,
    statistics,
    tour,
    volume_rendering,
)
from autonerf_lab.errors import UnknownNameError

_NOTEBOOKS = (
    *(tour, apartments, mapping, exploration, rewards, ppo, volume_rendering, hash_encoding),
    *(image_metrics, planning, pose_refinement, meshes, statistics, photographs),
)

EXERCISES: dict[str, Exercise] = {exercise.name: exercise for module in _NOTEBOOKS for exercise in module.EXERCISES}


def check(name: str, answer: Any) -> Verdict:
    """Check the answer to an exercise.

    Args:
        name: of the exercise.
        answer: function, class or value that the exercise asks for; ``None`` and ``...`` count as not attempted.

    Returns:
        The verdict: right, not attempted, or the first failed case with a hint.

    Raises:
        UnknownNameError: there is no exercise of this name; the message lists all names.

    Example:
        >>> check("01-heading", lambda pose: ...)
        01-heading: not attempted. Return the heading of a level camera from its pose, radians in (-pi, pi].
    """
    return _find(name).check(answer)


def solution(name: str) -> Solution:
    """Return the solution of an exercise; notebooks show it after a click.

    Raises:
        UnknownNameError: there is no exercise of this name; the message lists all names.
    """
    return _find(name).hidden_solution()


def _find(name: str) -> Exercise:
    if name not in EXERCISES:
        raise UnknownNameError("exercise", name, EXERCISES)
    return EXERCISES[name]


__all__ = ["EXERCISES", "Exercise", "check", "solution"]
