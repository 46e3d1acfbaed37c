"""What the notebooks of the course share: exercises with a checker that gives hints, and things to play with.

One module holds the exercises of one notebook. In a notebook::

    from autonerf_lab import course

    course.check("01-heading", my_function)  # right, or what is wrong, with a hint
    course.solution("01-heading")  # behind a click
"""

from typing import Any

from autonerf_lab.course.checker import Exercise, Hidden, Verdict
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
    """What a checker says about an answer: right, not attempted, or what is wrong with it.

    Args:
        name: of the exercise.
        answer: a function, a class, or a value: what the exercise asks for. ``None`` and ``...`` are not attempted.

    Raises:
        UnknownNameError: lists the exercises.

    Example:
        >>> check("01-heading", lambda pose: ...)
        01-heading: not attempted. The heading of a level camera from its pose, radians in (-pi, pi].
    """
    return _find(name).check(answer)


def solution(name: str) -> Hidden:
    """The solution of an exercise, which a notebook shows when it is clicked on.

    Raises:
        UnknownNameError: lists the exercises.
    """
    return _find(name).source()


def _find(name: str) -> Exercise:
    if name not in EXERCISES:
        raise UnknownNameError("exercise", name, EXERCISES)
    return EXERCISES[name]


__all__ = ["EXERCISES", "Exercise", "check", "solution"]
