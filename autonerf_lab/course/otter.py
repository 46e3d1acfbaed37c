"""Assignments for otter-grader: instructor versions in ``source``, the output of Otter Assign beside them."""

import contextlib
import io
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from autonerf_lab.course.assignments import ANSWER, Part, parts_of, select_notebooks, write_notebook
from autonerf_lab.course.checker import Exercise
from autonerf_lab.errors import DataError, MissingPackageError

_ASSIGNMENT = """\
# ASSIGNMENT CONFIG
name: {name}
init_cell: true
export_cell: false
check_all_cell: false
run_tests: false
generate: true
requirements:
  - autonerf-lab[notebooks]"""
_PUBLIC_TEST = '''\
""" # BEGIN TEST CONFIG
points: 0
hidden: false
""" # END TEST CONFIG
verdict = course.check("{name}", {answer})
assert verdict, verdict'''
_HIDDEN_TEST = '''\
""" # BEGIN TEST CONFIG
points: 1
hidden: true
failure_message: {message}
""" # END TEST CONFIG
assert course.grade("{name}", {answer}, case={case})'''


def export_otter(out: Path, exercises: dict[str, Exercise], numbers: Iterable[str] | None = None) -> list[Path]:
    """Write instructor versions and let Otter Assign make student versions and autograders.

    The checker's verdict with its hint is a public test without points. Each case is a hidden test of one point.

    Args:
        out: Output folder.
        exercises: Exercises by name.
        numbers: Notebooks, such as ``("00", "06")``; None: all.

    Returns:
        The student versions, ``NAME/student/NAME.ipynb``. ``NAME/autograder`` holds the solved notebook and the
        configuration (.zip) for ``otter run``, ``otter grade`` and Gradescope.

    Raises:
        MissingPackageError: otter-grader is not installed.
        DataError: Otter Assign failed, or the folder cannot be written.
        UnknownNameError: There is no notebook of a number.
    """
    try:
        import nbformat
        from otter.assign import main as assign
    except ImportError as error:
        raise MissingPackageError('this export needs otter-grader: pip install "autonerf-lab[otter]"') from error
    students = []
    for path in select_notebooks(numbers):
        notebook = nbformat.read(path, as_version=4)
        parts = parts_of(notebook, exercises, "# BEGIN SOLUTION", "# END SOLUTION")
        notebook.cells = _cells(path.stem, parts)
        source = out.resolve() / "source" / path.name
        write_notebook(notebook, source)
        log = io.StringIO()
        try:
            with contextlib.redirect_stdout(log):
                assign(str(source), str(out.resolve() / path.stem), no_pdfs=True, no_run_tests=True)
        except Exception as error:  # of any class
            raise DataError(f"Otter Assign could not process {source}: {error!r}\n{log.getvalue()}") from error
        students.append(out / path.stem / "student" / path.name)
    return students


def _cells(stem: str, parts: list[Part]) -> list[Any]:
    from nbformat.v4 import new_code_cell, new_raw_cell

    cells = [new_raw_cell(_ASSIGNMENT.format(name=stem))]
    for part in parts:
        if part.role != ANSWER or part.exercise is None:
            cells.append(part.cell)
            continue
        names = {"name": part.exercise.name, "answer": part.answer}
        tests = [_PUBLIC_TEST.format(**names)]
        for number, case in enumerate(part.exercise.cases):
            message = json.dumps(f"{part.exercise.name}, case {number + 1}: {case.description or 'the value'}")
            tests.append(_HIDDEN_TEST.format(**names, case=number, message=message))
        question = f"# BEGIN QUESTION\nname: q{part.exercise.name.replace('-', '_')}"
        cells += [new_raw_cell(question), new_raw_cell("# BEGIN SOLUTION"), part.cell, new_raw_cell("# END SOLUTION")]
        cells += [new_raw_cell("# BEGIN TESTS"), *map(new_code_cell, tests), new_raw_cell("# END TESTS")]
        cells.append(new_raw_cell("# END QUESTION"))
    return cells
