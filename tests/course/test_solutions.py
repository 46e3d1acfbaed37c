"""Answers that students write: right ones in other styles are accepted, wrong ones get their hint."""

import runpy
from pathlib import Path

import numpy as np
import pytest
import torch

from autonerf_lab import course
from autonerf_lab.course.answers import to_array
from autonerf_lab.course.checker import RIGHT, WRONG

TABLES = [runpy.run_path(str(path)) for path in sorted((Path(__file__).parent / "solutions").glob("*.py"))]
RIGHT_ANSWERS = {name: answers for table in TABLES for name, answers in table["RIGHT"].items()}
WRONG_ANSWERS = {name: answers for table in TABLES for name, answers in table["WRONG"].items()}
STATEFUL = {"04-new-squares"}  # the answer is a class

pytestmark = pytest.mark.filterwarnings("ignore")  # of NumPy and torch in answers of students


def returned_as(convert, solution):
    """A function with the result of the solution in another type."""

    def answer(*args):
        return convert(to_array(solution(*args)))

    return answer


def float32(value):
    is_float = isinstance(value, float) or (isinstance(value, np.ndarray) and value.dtype == np.float64)
    return np.asarray(value, np.float32)[()] if is_float else value


def of_mistakes(solution, is_reward=False):
    """Wrong answers to any question, with a part of the message."""

    def forgets_to_return(*args):
        print(solution(*args), end="")

    def raises(*args):
        result = solution(*args)
        return result[0] / undefined_name  # noqa: F821 - the mistake

    def text(*args):
        return str(solution(*args))

    def nested(*args):
        return [to_array(solution(*args)).tolist()]

    return (
        ("returned None. Is a `return` missing?", forgets_to_return),
        ("return result[0] / undefined_name", raises),
        ("not a finite number" if is_reward else "of type `str`", text),
        ("not a finite number" if is_reward else "got ", nested),
    )


def test_every_exercise_has_its_table():
    assert set(RIGHT_ANSWERS) == set(WRONG_ANSWERS) == set(course.EXERCISES)
    for name, exercise in course.EXERCISES.items():
        assert len(RIGHT_ANSWERS[name]) >= 5
        assert len(WRONG_ANSWERS[name]) + len(of_mistakes(exercise.solution)) >= 8


@pytest.mark.parametrize("name", course.EXERCISES)
def test_right_answers(name):
    for answer in RIGHT_ANSWERS[name]:
        assert course.check(name, answer).status == RIGHT, course.check(name, answer)
    if name in STATEFUL:
        return
    solution = course.EXERCISES[name].solution
    for convert in (torch.tensor, lambda a: a.tolist(), lambda a: a):
        assert course.check(name, returned_as(convert, solution))
    in_float32 = course.check(name, lambda *args: solution(*map(float32, args)))
    assert in_float32, in_float32


@pytest.mark.parametrize("name", course.EXERCISES)
def test_wrong_answers(name):
    exercise = course.EXERCISES[name]
    wrong = WRONG_ANSWERS[name] + (
        () if name in STATEFUL else of_mistakes(exercise.solution, is_reward=name[:2] == "04")
    )
    for start, answer in wrong:
        verdict = course.check(name, answer)
        assert verdict.status == WRONG, f"accepted: {start}"
        assert start in verdict.text, f"{start!r} is not in {verdict}"
        assert not all(exercise.passed(answer))
