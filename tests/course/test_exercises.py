"""The exercises of the course: every solution is right, every typical mistake gets its own hint, and nothing raises."""

import re
from pathlib import Path

import nbformat
import numpy as np
import pytest

from autonerf_lab import course
from autonerf_lab.course.checker import OPEN, RIGHT, WRONG, Case, Exercise, Mistake, Verdict
from autonerf_lab.errors import UnknownNameError

NOTEBOOKS = Path(__file__).parents[2] / "notebooks"
EXERCISES = list(course.EXERCISES.values())
EVIL = "<img src=x onerror=alert(1)>"
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
    assert exercise.check(None).status == exercise.check(...).status == OPEN
    assert exercise.check(lambda *args: ...).status == exercise.check(lambda *args: None).status == OPEN
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
def test_whatever_is_handed_over_gets_an_answer(exercise):
    def fails(*args):
        raise RuntimeError(EVIL)

    verdict = exercise.check(fails)
    assert verdict.status == WRONG and f"RuntimeError: {EVIL}" in verdict.text and "Hint" not in verdict.text
    assert EVIL not in verdict._repr_html_() and "&lt;img" in verdict._repr_html_()
    assert exercise.check(3.5).status == exercise.check("text").status == WRONG
    assert exercise.check(lambda *args: EVIL).status == exercise.check(lambda *args: object()).status == WRONG


def test_names_are_shown_as_code():
    shown = [Verdict("one", WRONG, text)._repr_html_() for text in ("use `there`, `<b>`", "one ` alone")]
    assert "use <code>there</code>, <code>&lt;b&gt;</code><" in shown[0] and "one ` alone<" in shown[1]
    texts = [text for one in EXERCISES for text in (one.question, *(mistake.hint for mistake in one.mistakes))]
    assert not [text for text in texts if "`" in re.sub("`[^`]+`", "", text)]


@pytest.mark.parametrize("name", course.EXERCISES)
def test_every_exercise_is_asked_in_the_notebook_that_its_name_begins_with(name):
    (notebook,) = NOTEBOOKS.glob(f"{name.split('-')[0]}_*.ipynb")
    cells = [cell.source for cell in nbformat.read(notebook, as_version=4).cells]
    assert any(f"**Exercise `{name}`.**" in cell for cell in cells)
    assert any(f'course.check("{name}", ' in cell for cell in cells)
    assert f'course.solution("{name}")' in cells


def test_a_name_that_does_not_exist():
    with pytest.raises(UnknownNameError, match=r"unknown exercise '01-nothing'; valid names: .*01-heading"):
        course.check("01-nothing", None)


def test_a_wrong_answer_is_shown_where_it_fails():
    assert DOUBLE.check(lambda x: 2 * x).status == RIGHT
    assert repr(DOUBLE.check(lambda x: x**2)) == (
        "double: not yet. With three: expected 6, and your answer is 9.\nHint: A square."
    )
    assert DOUBLE.check(lambda x: x + 3).text == "With an array: expected [2 4], and your answer is [4 5]."
    assert DOUBLE.check(lambda x: 6 if isinstance(x, int) else np.zeros((2, 2))).text == (
        "With an array: expected an array of shape (2,), and yours has (2, 2)."
    )
    assert DOUBLE.check(lambda x: 6 if isinstance(x, int) else None).status == WRONG  # a return is missing
    assert DOUBLE.check(6).text == "Hand over the function itself, without calling it."


def test_an_answer_may_write_to_what_it_is_given():
    def in_place(x):
        x *= 2
        return x

    assert DOUBLE.check(in_place) and DOUBLE.check(in_place)


def test_a_value_may_be_asked_for():
    area = Exercise("area", "Cells in a square metre.", (Case("", (), 400),), lambda: 400, ())
    assert area.check(400) and area.check(...).status == OPEN
    assert area.check(20).text == "expected 400, and your answer is 20."
