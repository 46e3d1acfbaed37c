"""Exercises of the course: solutions are right, mistakes get their own hints, and the checker never raises."""

import re
from pathlib import Path

import nbformat
import numpy as np
import pytest
import torch

from autonerf_lab import course
from autonerf_lab.course.checker import NOT_ATTEMPTED, RIGHT, WRONG, Case, Exercise, Mistake, Verdict
from autonerf_lab.errors import UnknownNameError

NOTEBOOKS = Path(__file__).parents[2] / "notebooks"
EXERCISES = list(course.EXERCISES.values())
HTML = "<img src=x onerror=alert(1)>"
DOUBLE = Exercise(
    "double",
    "Double it.",
    (Case("three", (3,), 6), Case("an array", (np.array([1, 2]),), np.array([2, 4]))),
    lambda x: 2 * x,
    (Mistake("A square.", lambda x: x**2), Mistake("Division.", lambda x: x / 0)),
)


@pytest.mark.parametrize("exercise", EXERCISES, ids=lambda e: e.name)
def test_every_exercise(exercise):
    assert exercise.check(exercise.solution) and exercise.check(exercise.solution).status == RIGHT
    assert exercise.check(None).status == exercise.check(...).status == NOT_ATTEMPTED
    assert exercise.check(lambda *args: ...).status == exercise.check(lambda *args: None).status == NOT_ATTEMPTED
    hints = [mistake.hint for mistake in exercise.mistakes]
    assert len(set(hints)) == len(hints) >= 4
    for mistake in exercise.mistakes:
        verdict = exercise.check(mistake.answer)
        assert verdict.status == WRONG and not verdict
        assert verdict.text.endswith(f"Hint: {mistake.hint}")
    source = repr(course.solution(exercise.name))
    assert f" {exercise.solution.__name__}" in source.splitlines()[0]
    assert "<details>" in course.solution(exercise.name)._repr_html_()


@pytest.mark.parametrize("exercise", EXERCISES, ids=lambda e: e.name)
def test_any_answer_gets_a_verdict(exercise):
    def fails(*args):
        raise RuntimeError(HTML)

    verdict = exercise.check(fails)
    assert verdict.status == WRONG and f"RuntimeError: {HTML}" in verdict.text and "Hint" not in verdict.text
    assert HTML not in verdict._repr_html_() and "&lt;img" in verdict._repr_html_()
    assert exercise.check(3.5).status == exercise.check("text").status == WRONG
    assert exercise.check(lambda *args: HTML).status == exercise.check(lambda *args: object()).status == WRONG


def test_names_in_backquotes_are_shown_as_code():
    shown = [Verdict("one", WRONG, text)._repr_html_() for text in ("use `there`, `<b>`", "one ` alone")]
    assert "use <code>there</code>, <code>&lt;b&gt;</code><" in shown[0] and "one ` alone<" in shown[1]
    texts = [text for one in EXERCISES for text in (one.question, *(mistake.hint for mistake in one.mistakes))]
    assert not [text for text in texts if "`" in re.sub("`[^`]+`", "", text)]


@pytest.mark.parametrize("name", course.EXERCISES)
def test_every_exercise_is_in_the_notebook_of_its_number(name):
    (notebook,) = NOTEBOOKS.glob(f"{name.split('-')[0]}_*.ipynb")
    cells = [cell.source for cell in nbformat.read(notebook, as_version=4).cells]
    assert any(f"**Exercise `{name}`.**" in cell for cell in cells)
    assert any(f'course.check("{name}", ' in cell for cell in cells)
    assert f'course.solution("{name}")' in cells


def test_an_unknown_name_lists_the_exercises():
    with pytest.raises(UnknownNameError, match=r"unknown exercise '01-nothing'; valid names: .*01-heading"):
        course.check("01-nothing", None)


def test_notebooks_continue_with_a_right_answer_or_with_the_solution(capsys):
    def right(sigma, delta):
        return 1 - np.exp(-sigma * delta)

    assert course.accepted("00-opacity", right) is right
    assert capsys.readouterr().out == "00-opacity: your answer\n"
    for other in (None, lambda sigma, delta: ..., lambda sigma, delta: sigma):
        assert course.accepted("00-opacity", other) is course.EXERCISES["00-opacity"].solution
        assert capsys.readouterr().out.startswith("00-opacity: the solution of the package")


def test_a_wrong_answer_is_shown_its_first_failed_case():
    assert DOUBLE.check(lambda x: 2 * x).status == RIGHT
    assert repr(DOUBLE.check(lambda x: x**2)) == ("double: not yet. For three: expected 6, got 9.\nHint: A square.")
    assert DOUBLE.check(lambda x: x + 3).text == "For an array: expected [2 4], got [4 5]."
    assert DOUBLE.check(lambda x: 6 if isinstance(x, int) else np.zeros((2, 2))).text == (
        "For an array: expected an array of shape (2,), got shape (2, 2)."
    )
    assert DOUBLE.check(lambda x: 6 if isinstance(x, int) else None).status == WRONG  # missing return statement
    assert DOUBLE.check(6).text == "Pass the function itself, without calling it."


def test_an_answer_may_modify_its_arguments():
    def in_place(x):
        x *= 2
        return x

    assert DOUBLE.check(in_place) and DOUBLE.check(in_place)


def test_an_answer_may_be_a_value():
    area = Exercise("area", "Cells in a square metre.", (Case("", (), 400),), lambda: 400, ())
    assert area.check(400) and area.check(...).status == NOT_ATTEMPTED
    assert area.check(20).text == "expected 400, got 20."


def test_a_missing_return_and_an_empty_body_are_distinguished():
    def empty(x):
        """Docstring."""
        ...

    def passes(x):
        pass

    def forgets(x):
        x * 2

    assert DOUBLE.check(empty).status == DOUBLE.check(passes).status == NOT_ATTEMPTED
    assert DOUBLE.check(forgets).text == "For three: expected 6, but the answer returned None. Is a `return` missing?"
    in_one_branch = DOUBLE.check(lambda x: 6 if isinstance(x, int) else None)
    assert in_one_branch.text.startswith("For an array: expected [2 4], but the answer returned None")


def test_the_line_of_an_exception_is_shown():
    def helper(x):
        return x.nothing

    def answer(x):
        return helper(x) + 1

    verdict = DOUBLE.check(answer)
    assert verdict.text.endswith("in line " + f"{helper.__code__.co_firstlineno + 1}: return x.nothing")
    assert "\nin " not in DOUBLE.check(lambda: 3).text  # the call itself fails, no line does


def test_the_difference_is_printed_when_both_print_alike():
    one = Exercise("one", "", (Case("", (), np.array([0.5, 0.00001])),), lambda: 0, ())
    assert one.check(np.array([0.5, 0.00004])).text == (
        "expected [0.5 0. ], got [0.5 0. ]. The largest difference is 3e-05."
    )
    assert one.check(np.array([0.5, 0.00001 + 4e-6])), "within the tolerance"
    assert one.check(np.array([0.5, 0.2])).text == "expected [0.5 0. ], got [0.5 0.2]."


def test_floats_are_no_indices():
    cells = Exercise(
        "cells", "", (Case("a point", (1,), [4, 2]), Case("none", (2,), [])), lambda x: 0, (), integers=True
    )
    assert cells.check(lambda x: [4, 2] if x == 1 else [])
    assert cells.check(lambda x: torch.tensor([4, 2]) if x == 1 else ())
    assert "they are floats" in cells.check(lambda x: [4.0, 2] if x == 1 else []).text
    assert cells.check(lambda x: [4, 3] if x == 1 else []).text == "For a point: expected [4, 2], got [4, 3]."
    assert cells.passed(lambda x: [4.0, 2.0] if x == 1 else []) == [False, True]
    assert cells.passed(3) == [False, False]


def test_reversed_axes_are_named():
    table = Exercise("table", "", (Case("it", (1,), np.arange(6).reshape(2, 3)),), lambda x: 0, ())
    assert table.check(lambda x: np.arange(6).reshape(2, 3).T).text.endswith("transpose the result.")
    assert "transpose" not in table.check(lambda x: np.arange(6).reshape(3, 2)).text
