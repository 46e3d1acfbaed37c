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
class Raised:
    """Result of an answer that raised an exception."""

    error: Exception

    def __repr__(self) -> str:
        return f"{type(self.error).__name__}: {self.error}"


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
    tolerance: float = 1e-6  # absolute

    def check(self, answer: Any) -> Verdict:
        """Check an answer, a function or a value, and return the verdict. Exceptions of the answer are caught."""
        if answer is None or answer is ...:
            return Verdict(self.name, NOT_ATTEMPTED, self.question)
        if not callable(answer) and self.cases[0].args:
            return Verdict(self.name, WRONG, "Pass the function itself, without calling it.")
        outcomes = self._outcomes(answer)
        if all(outcome is None or outcome is ... for outcome in outcomes):
            return Verdict(self.name, NOT_ATTEMPTED, self.question)
        for case, outcome in zip(self.cases, outcomes, strict=True):
            if not self._same(outcome, case.expected):
                return Verdict(self.name, WRONG, _difference(case, outcome) + self._hint(outcomes))
        return Verdict(self.name, RIGHT)

    def hidden_solution(self) -> Solution:
        """Return the source code of the solution."""
        return Solution(self.name, textwrap.dedent(inspect.getsource(self.solution)))

    def _outcomes(self, answer: Any) -> list[Any]:
        outcomes = []
        for case in self.cases:
            try:
                with np.errstate(all="ignore"):
                    outcomes.append(self.evaluate(answer, copy.deepcopy(case.args)))
            except Exception as error:  # answers may contain any error
                outcomes.append(Raised(error))
        return outcomes

    def _hint(self, outcomes: list[Any]) -> str:
        for mistake in self.mistakes:
            if all(map(self._same, outcomes, self._outcomes(mistake.answer))):
                return f"\nHint: {mistake.hint}"
        return ""

    def _same(self, a: Any, b: Any) -> bool:
        if isinstance(a, Raised) or isinstance(b, Raised):
            return isinstance(a, Raised) and isinstance(b, Raised) and type(a.error) is type(b.error)
        try:
            x, y = np.asarray(a, np.float64), np.asarray(b, np.float64)
        except (TypeError, ValueError):
            return False
        return x.shape == y.shape and bool(np.allclose(x, y, rtol=0, atol=self.tolerance, equal_nan=True))


def _difference(case: Case, outcome: Any) -> str:
    prefix = f"For {case.description}: " if case.args else ""
    if isinstance(outcome, Raised):
        return f"{prefix}expected {_short(case.expected)}, but the answer raised {outcome!r}."
    shapes = [np.shape(value) if isinstance(value, np.ndarray) else None for value in (outcome, case.expected)]
    if None not in shapes and shapes[0] != shapes[1]:
        return f"{prefix}expected an array of shape {shapes[1]}, got shape {shapes[0]}."
    return f"{prefix}expected {_short(case.expected)}, got {_short(outcome)}."


def _short(value: Any) -> str:
    if isinstance(value, np.ndarray | np.generic):
        return np.array2string(np.asarray(value), precision=4, suppress_small=True, threshold=20)
    text = f"{value:.6g}" if isinstance(value, float) else repr(value)
    return text if len(text) <= 200 else text[:200] + " ..."
