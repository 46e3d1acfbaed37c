"""Checker of the exercises: test cases, a hidden solution, and typical mistakes with hints.

A mistake is defined by the wrong answer it produces. If an answer agrees with a mistake in every case, the verdict
contains the hint of that mistake; otherwise it contains only the first failed case.
"""

import copy
import html
import inspect
import re
import textwrap
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from autonerf_lab.course.answers import Raised, difference, holds_floats, is_unfinished, same, to_array

RIGHT, WRONG, NOT_ATTEMPTED = "right", "not yet", "not attempted"
_COLORS = {RIGHT: "#0072B2", WRONG: "#D55E00", NOT_ATTEMPTED: "#808080"}


@dataclass(frozen=True)
class Case:
    """Test case: arguments and expected result."""

    description: str  # of the arguments, shown when the case fails
    args: tuple[Any, ...]  # empty if the answer is a value, which is not called
    expected: Any  # a number, an array or nested lists of numbers


@dataclass(frozen=True)
class Mistake:
    """Typical wrong answer with a hint."""

    hint: str
    answer: Any


@dataclass(frozen=True)
class Verdict:
    """Verdict of the checker; notebooks show it in colour."""

    exercise: str
    status: str  # RIGHT, WRONG or NOT_ATTEMPTED
    text: str = ""

    def __bool__(self) -> bool:
        return self.status == RIGHT

    def __repr__(self) -> str:
        return f"{self.exercise}: {self.status}" + (f". {self.text}" if self.text else "")

    def _repr_html_(self) -> str:
        color = _COLORS[self.status]
        text = re.sub("`([^`]+)`", r"<code>\1</code>", html.escape(self.text))
        return (
            f'<div style="border-left: 5px solid {color}; padding: 2px 10px">'
            f"<b>{html.escape(self.exercise)}: {self.status}</b><br>"
            f'<span style="white-space: pre-wrap">{text}</span></div>'
        )


@dataclass(frozen=True)
class Solution:
    """Source code of a solution; notebooks show it after a click."""

    exercise: str
    source: str

    def __repr__(self) -> str:
        return self.source

    def _repr_html_(self) -> str:
        name, source = html.escape(self.exercise), html.escape(self.source)
        return f"<details><summary>Solution of {name}</summary><pre>{source}</pre></details>"


def call(answer: Any, args: tuple[Any, ...]) -> Any:
    """Call an answer with the arguments of a case; return the answer itself if there are none."""
    return answer(*args) if args else answer


@dataclass(frozen=True)
class Exercise:
    """Question with test cases, a solution and typical mistakes.

    Example:
        >>> def double(x):
        ...     return 2 * x
        >>> square = Mistake("This is the square.", lambda x: x * x)
        >>> exercise = Exercise("double", "Double it.", (Case("three", (3,), 6),), double, (square,))
        >>> exercise.check(double), exercise.check(lambda x: ...)
        (double: right, double: not attempted. Double it.)
        >>> print(exercise.check(lambda x: x**2))
        double: not yet. For three: expected 6, got 9.
        Hint: This is the square.
    """

    name: str
    question: str  # shown if the exercise is not attempted
    cases: tuple[Case, ...]
    solution: Callable[..., Any]
    mistakes: tuple[Mistake, ...]
    evaluate: Callable[[Any, tuple[Any, ...]], Any] = call  # (answer, arguments of a case) -> result
    integers: bool = False  # results are indices, which must not be floats

    def check(self, answer: Any) -> Verdict:
        """Check an answer, a function or a value, and return the verdict. Exceptions of the answer are caught."""
        if answer is None or answer is ...:
            return Verdict(self.name, NOT_ATTEMPTED, self.question)
        if not callable(answer) and self.cases[0].args:
            return Verdict(self.name, WRONG, "Pass the function itself, without calling it.")
        outcomes = self.outcomes(answer)
        if all(outcome is ... or (outcome is None and is_unfinished(answer)) for outcome in outcomes):
            return Verdict(self.name, NOT_ATTEMPTED, self.question)
        for case, outcome, passed in zip(self.cases, outcomes, self._passed(outcomes), strict=True):
            if not passed:
                return Verdict(self.name, WRONG, self._failure(case, outcome) + self._hint(outcomes))
        return Verdict(self.name, RIGHT)

    def passed(self, answer: Any) -> list[bool]:
        """Return for each case whether an answer passes it."""
        callable_if_needed = callable(answer) or not self.cases[0].args
        outcomes = self.outcomes(answer) if callable_if_needed else [None] * len(self.cases)
        return self._passed(outcomes)

    def _passed(self, outcomes: list[Any]) -> list[bool]:
        return [
            same(outcome, case.expected) and not (self.integers and holds_floats(outcome))
            for case, outcome in zip(self.cases, outcomes, strict=True)
        ]

    def hidden_solution(self) -> Solution:
        """Return the source code of the solution."""
        return Solution(self.name, textwrap.dedent(inspect.getsource(self.solution)))

    def outcomes(self, answer: Any) -> list[Any]:
        """Return the result of an answer in each case, or the exception as :class:`Raised`."""
        outcomes = []
        for case in self.cases:
            try:
                with np.errstate(all="ignore"):
                    outcomes.append(self.evaluate(answer, copy.deepcopy(case.args)))
            except Exception as error:  # answers may contain any error
                outcomes.append(Raised(error))
        return outcomes

    def _failure(self, case: Case, outcome: Any) -> str:
        prefix = f"For {case.description}: " if case.args else ""
        if self.integers and holds_floats(outcome) and same(outcome, case.expected):
            return f"{prefix}the values are right, but they are floats. Indices must be integers: use int()."
        return prefix + difference(outcome, case.expected)

    def _hint(self, outcomes: list[Any]) -> str:
        for mistake in self.mistakes:
            if all(map(same, outcomes, self.outcomes(mistake.answer))):
                return f"\nHint: {mistake.hint}"
        turned = [None if isinstance(outcome, Raised) else to_array(outcome) for outcome in outcomes]
        if all(a is not None and a.ndim > 1 and same(a.T, c.expected) for a, c in zip(turned, self.cases, strict=True)):
            return "\nHint: The axes are in reverse order: transpose the result."
        return ""
