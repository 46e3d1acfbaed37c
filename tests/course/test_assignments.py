"""Assignments: student versions lose the solutions and nothing else, instructor versions get every point."""

import ast
import re
import runpy

import nbformat
import pytest

from autonerf_lab import course
from autonerf_lab.course.assignments import ANSWER, CONTEXT, IMPORTS, parts_of, points_of, select_notebooks
from autonerf_lab.course.checker import RIGHT
from autonerf_lab.course.notebooks import notebook_paths
from autonerf_lab.errors import MissingPackageError, UnknownNameError

BEGIN, END = "### BEGIN SOLUTION", "### END SOLUTION"
PATHS = notebook_paths()


@pytest.fixture(scope="module", params=PATHS, ids=lambda path: path.stem)
def notebook(request):
    return nbformat.read(request.param, as_version=4)


@pytest.fixture(scope="module")
def parts(notebook):
    return parts_of(notebook, course.EXERCISES, BEGIN, END)


def test_every_exercise_is_an_answer_once():
    names = []
    for path in PATHS:
        parts = parts_of(nbformat.read(path, as_version=4), course.EXERCISES, BEGIN, END)
        names += [part.exercise.name for part in parts if part.role == ANSWER]
    assert sorted(names) == sorted(course.EXERCISES)


def test_the_student_version_is_the_notebook_without_solutions(notebook, parts):
    students = []
    for part in parts:
        if part.role == ANSWER:
            stub = re.sub(rf"(?s)( *){BEGIN}.*{END}", r"\1...", part.cell.source)
            stub = stub.replace("\n\n\n...", "")  # after a class
            students.append(stub)
        elif part.cell.id != "setup-rest":
            students.append(part.cell.source)
    kept = [cell.source for cell in notebook.cells if not cell.source.startswith("course.solution(")]
    setup = next(k for k, cell in enumerate(notebook.cells) if cell.cell_type == "code")
    assert kept[setup].startswith(students[setup])
    assert students[:setup] + students[setup + 1 :] == kept[:setup] + kept[setup + 1 :]
    assert not [source for source in students if "course.solution" in source or "BEGIN" in source]
    assert not any(part.cell.get("outputs") for part in parts)


def test_grading_runs_only_imports_answers_and_tests(parts):
    skipped = [part for part in parts if part.cell.cell_type == "code" and part.role == CONTEXT]
    assert skipped and all({"skip-execution", "otter_ignore"} <= set(part.cell.metadata.tags) for part in skipped)
    (imports,) = [part.cell.source for part in parts if part.role == IMPORTS]
    assert all(isinstance(node, ast.Import | ast.ImportFrom) for node in ast.parse(imports).body)


def test_solutions_in_the_notation_of_the_notebook_are_right(parts, tmp_path):
    answers = [part for part in parts if part.role == ANSWER]
    program = [part.cell.source for part in parts if part.role in (IMPORTS, ANSWER)]
    (tmp_path / "program.py").write_text("\n\n".join(program), encoding="utf-8")
    names = runpy.run_path(str(tmp_path / "program.py"))
    for part in answers:
        assert course.check(part.exercise.name, names[part.answer]).status == RIGHT
        assert course.grade(part.exercise.name, names[part.answer]) == points_of(part.exercise)


def test_points_of_an_answer(capsys):
    def noisy(sigma, delta):
        print("noise")
        return 0.5

    assert course.grade("00-opacity", noisy) == 1
    shown = capsys.readouterr()
    assert shown.out.startswith("00-opacity: not yet. For half a metre of air") and "noise" not in shown.out
    assert [course.grade("00-opacity", noisy, case=k) for k in range(4)] == [0, 0, 1, 0]
    assert course.grade("00-opacity", 0.5) == course.grade("00-opacity", None) == 0


def test_unknown_names_and_missing_tools(tmp_path, monkeypatch):
    with pytest.raises(UnknownNameError, match="unknown notebook '99'"):
        select_notebooks(["99"])
    assert select_notebooks(iter(["06", "00"])) == [PATHS[6], PATHS[0]] and select_notebooks() == PATHS
    with pytest.raises(UnknownNameError, match="unknown grading tool 'moodle'"):
        course.export("moodle", tmp_path)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    for tool in ("nbgrader", "otter"):
        with pytest.raises(MissingPackageError, match=rf"autonerf-lab\[{tool}\]"):
            course.export(tool, tmp_path)
