"""An exercise: cases worked by hand, a solution that stays hidden, and the mistakes that are usually made.

A mistake is written down as the wrong answer it leads to. An answer that agrees with one in every case gets its hint;
any other wrong answer is shown the first case it fails in.
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

RIGHT, WRONG, OPEN = "right", "not yet", "not attempted"
_COLORS = {RIGHT: "#0072B2", WRONG: "#D55E00", OPEN: "#808080"}


@dataclass(frozen=True)
class Case:
    """What an answer is called with, and what it has to return."""

    given: str  # in words, for whoever fails in it
    args: tuple[Any, ...]  # empty: the answer is a value and is not called
    expected: Any  # a number, or (nested) numbers


@dataclass(frozen=True)
class Mistake:
    """A wrong answer that is given often, and what helps."""

    hint: str
    answer: Any


@dataclass(frozen=True)
class Raised:
    """In place of a value: the answer raised an exception."""

    error: Exception

    def __repr__(self) -> str:
        return f"{type(self.error).__name__}: {self.error}"


@dataclass(frozen=True)
class Verdict:
    """What the checker says: a notebook shows it in colour."""

    exercise: str
    status: str  # RIGHT, WRONG or OPEN
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
class Hidden:
    """Source code behind a click."""

    exercise: str
    source: str

    def __repr__(self) -> str:
        return self.source

    def _repr_html_(self) -> str:
        name, source = html.escape(self.exercise), html.escape(self.source)
        return f"<details><summary>A solution of {name}</summary><pre>{source}</pre></details>"


def call(answer: Any, args: tuple[Any, ...]) -> Any:
    """How most answers are asked: a function with the arguments, a value without."""
    return answer(*args) if args else answer


@dataclass(frozen=True)
class Exercise:
    """A question with a checker.

    Example:
        >>> def double(x):
        ...     return 2 * x
        >>> square = Mistake("A square is not the double.", lambda x: x * x)
        >>> exercise = Exercise("double", "Double it.", (Case("three", (3,), 6),), double, (square,))
        >>> exercise.check(double), exercise.check(lambda x: ...)
        (double: right, double: not attempted. Double it.)
        >>> print(exercise.check(lambda x: x**2))
        double: not yet. With three: expected 6, and your answer is 9.
        Hint: A square is not the double.
    """

    name: str
    question: str
    cases: tuple[Case, ...]
    solution: Callable[..., Any]
    mistakes: tuple[Mistake, ...]
    ask: Callable[[Any, tuple[Any, ...]], Any] = call
    tolerance: float = 1e-6

    def check(self, answer: Any) -> Verdict:
        """What is to be said about an answer: a function, or a value where the question asks for one. Never raises."""
        if answer is None or answer is ...:
            return Verdict(self.name, OPEN, self.question)
        if not callable(answer) and self.cases[0].args:
            return Verdict(self.name, WRONG, "Hand over the function itself, without calling it.")
        outcomes = self._outcomes(answer)
        if all(outcome is None or outcome is ... for outcome in outcomes):
            return Verdict(self.name, OPEN, self.question)
        for case, outcome in zip(self.cases, outcomes, strict=True):
            if not self._same(outcome, case.expected):
                return Verdict(self.name, WRONG, _difference(case, outcome) + self._hint(outcomes))
        return Verdict(self.name, RIGHT)

    def source(self) -> Hidden:
        """The solution, to be shown behind a click."""
        return Hidden(self.name, textwrap.dedent(inspect.getsource(self.solution)))

    def _outcomes(self, answer: Any) -> list[Any]:
        outcomes = []
        for case in self.cases:
            try:
                with np.errstate(all="ignore"):
                    outcomes.append(self.ask(answer, copy.deepcopy(case.args)))
            except Exception as error:  # an answer is code in the making
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
    where = f"With {case.given}: " if case.args else ""
    if isinstance(outcome, Raised):
        return f"{where}expected {_short(case.expected)}, and your answer failed with {outcome!r}."
    shapes = [np.shape(value) if isinstance(value, np.ndarray) else None for value in (outcome, case.expected)]
    if None not in shapes and shapes[0] != shapes[1]:
        return f"{where}expected an array of shape {shapes[1]}, and yours has {shapes[0]}."
    return f"{where}expected {_short(case.expected)}, and your answer is {_short(outcome)}."


def _short(value: Any) -> str:
    if isinstance(value, np.ndarray | np.generic):
        return np.array2string(np.asarray(value), precision=4, suppress_small=True, threshold=20)
    text = f"{value:.6g}" if isinstance(value, float) else repr(value)
    return text if len(text) <= 200 else text[:200] + " ..."
