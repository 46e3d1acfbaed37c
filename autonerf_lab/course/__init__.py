"""Exercises of the notebooks with a checker that gives hints, and interactive widgets.

Each module of ``exercises`` belongs to one notebook. In a notebook::

    from autonerf_lab import course

    course.check("01-heading", my_function)  # verdict with a hint
    course.solution("01-heading")  # hidden until it is clicked
"""

import contextlib
import io
import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from autonerf_lab.course.checker import Exercise, Solution, Verdict
from autonerf_lab.course.exercises import (
    apartments,
    exploration,
    hash_encoding,
    image_metrics,
    localization,
    mapping,
    meshes,
    photographs,
    planning,
    pose_refinement,
    ppo,
    rewards,
    segmentation,
    statistics,
    tour,
    uncertainty,
    volume_rendering,
)
from autonerf_lab.course.nbgrader import export_nbgrader
from autonerf_lab.course.otter import export_otter
from autonerf_lab.errors import UnknownNameError

_NOTEBOOKS = (
    *(tour, apartments, mapping, exploration, rewards, ppo, volume_rendering, hash_encoding),
    *(image_metrics, planning, pose_refinement, meshes, statistics, photographs, localization),
    *(segmentation, uncertainty),
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


def accepted(name: str, answer: Any) -> Any:
    """Return an answer if the checker accepts it, otherwise the solution, and print which of the two.

    The notebooks continue with the result, so that the answers of a student do the work that follows.

    Args:
        name: of the exercise.
        answer: function, class or value that the exercise asks for.

    Raises:
        UnknownNameError: there is no exercise of this name; the message lists all names.

    Example:
        >>> accepted("01-heading", lambda pose: 0.0).__name__
        01-heading: the solution of the package, until the checker accepts your answer
        'heading'
    """
    right = bool(check(name, answer))
    print(f"{name}:", "your answer" if right else "the solution of the package, until the checker accepts your answer")
    return answer if right else _find(name).solution


def grade(name: str, answer: Any, case: int | None = None) -> int:
    """Return the points of an answer, one per passed case; print the verdict if the answer is not right.

    The exported assignments call this in their hidden tests. What the answer prints or warns is discarded, because
    nbgrader gives no points to a test that writes to stderr.

    Args:
        name: of the exercise.
        answer: function, class or value that the exercise asks for.
        case: number of a single case, from 0; None: all cases.

    Raises:
        UnknownNameError: there is no exercise of this name; the message lists all names.

    Example:
        >>> import math
        >>> grade("00-opacity", lambda sigma, delta: math.exp(-sigma * delta))
        00-opacity: not yet. For half a metre of air (density 0): expected 0, got 1.
        Hint: This is the fraction that passes. Opacity is 1 minus this fraction.
        1
    """
    exercise = _find(name)
    unshown = io.StringIO()
    with warnings.catch_warnings(), contextlib.redirect_stdout(unshown), contextlib.redirect_stderr(unshown):
        warnings.simplefilter("ignore")
        passed = exercise.passed(answer)
        if case is not None:
            return int(passed[case])
        verdict = exercise.check(answer)
    if not verdict:
        print(verdict)
    return sum(passed)


def export(tool: str, out: str | Path, numbers: Iterable[str] | None = None) -> list[Path]:
    """Export the notebooks as assignments for a grading tool, and return the student versions.

    Instructor versions, with solutions, points and hidden tests, are written to ``source`` in the same folder.

    Args:
        tool: ``nbgrader`` or ``otter``; the extra of that name must be installed.
        out: output folder.
        numbers: notebooks, such as ``("00", "06")``; None: all.

    Raises:
        UnknownNameError: there is no such tool or notebook.
        MissingPackageError: the tool is not installed.
        DataError: the tool failed; the message says why.
    """
    tools = {"nbgrader": export_nbgrader, "otter": export_otter}
    if tool not in tools:
        raise UnknownNameError("grading tool", tool, tools)
    return tools[tool](Path(out), EXERCISES, numbers)


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


__all__ = ["EXERCISES", "Exercise", "accepted", "check", "export", "grade", "solution"]
