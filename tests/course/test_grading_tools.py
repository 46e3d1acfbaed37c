"""Exported assignments in the real nbgrader and the real otter-grader, extras with a job of their own in CI."""

import csv
import json
import os
import shutil
import subprocess
import sys
import sysconfig
from importlib.util import find_spec
from pathlib import Path

import nbformat
import pytest

from autonerf_lab import course
from autonerf_lab.course.assignments import points_of
from autonerf_lab.course.notebooks import notebook_paths

PATH = os.pathsep.join([sysconfig.get_path("scripts"), os.environ["PATH"]])  # nbgrader runs alembic
STEMS = [path.stem for path in notebook_paths()]

needs_nbgrader = pytest.mark.skipif(find_spec("nbgrader") is None, reason="needs the extra nbgrader")
needs_otter = pytest.mark.skipif(find_spec("otter") is None, reason="needs the extra otter")


def run(*command, cwd=None):
    result = subprocess.run(
        [sys.executable, "-m", *map(str, command)],
        cwd=cwd,
        env=os.environ | {"PATH": PATH},
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stdout + result.stderr
    return result


def exported(tool, folder):
    """Student versions of all notebooks by name, and their folder."""
    printed = run("autonerf_lab.cli", "course", "export", "--to", tool, "--out", folder).stdout
    return {path.stem: path for line in printed.splitlines() if (path := Path(line)).suffix == ".ipynb"}, folder


@pytest.fixture(scope="module")
def nbgrader_course(tmp_path_factory):
    return exported("nbgrader", tmp_path_factory.mktemp("nbgrader"))


@pytest.fixture(scope="module")
def otter_course(tmp_path_factory):
    return exported("otter", tmp_path_factory.mktemp("otter"))


def maximum(stem):
    return sum(points_of(exercise) for name, exercise in course.EXERCISES.items() if name[:2] == stem[:2])


def sources(notebook):
    return "\n".join(cell.source for cell in notebook.cells)


def check_student_version(path):
    """Read a student version: no solution, neither marked nor as text, no hidden test, no output."""
    notebook = nbformat.read(path, as_version=4)
    text = sources(notebook)
    for hidden in ("SOLUTION", "HIDDEN", "course.solution", "course.grade"):
        assert hidden not in text and hidden not in json.dumps(notebook.metadata)
    for name, exercise in course.EXERCISES.items():
        if name[:2] == path.stem[:2]:
            _, *body = course.solution(name).source.splitlines()
            body = "\n".join(line for line in body if '"""' not in line)
            assert body not in text, f"the solution of {exercise.name} is in the student version"
    assert not any(cell.get("outputs") for cell in notebook.cells)
    return notebook


def answer_with(notebook, start, source):
    """Replace the answer cell that starts with a line; the others stay empty."""
    (cell,) = [cell for cell in notebook.cells if cell.source.startswith(start)]
    cell.source = source
    return notebook


FRACTION = "def opacity(s, d):\n    print('noise')\n    return np.exp(-s * d)"  # the fraction that passes: 1 of 4 cases


def with_one_point(notebook, stem):
    """The empty student version; that of notebook 00 with an answer that is right in one case."""
    return answer_with(notebook, "def opacity", FRACTION) if stem == "00_tour" else notebook


@needs_nbgrader
@pytest.mark.parametrize("stem", STEMS)
def test_nbgrader(stem, nbgrader_course):
    students, folder = nbgrader_course
    release = check_student_version(students[stem])
    instructor = nbformat.read(folder / "source" / stem / f"{stem}.ipynb", as_version=4)
    assert "### BEGIN SOLUTION" in sources(instructor)
    for name, notebook in (("ada", instructor), ("bob", with_one_point(release, stem))):
        (folder / "submitted" / name / stem).mkdir(parents=True)
        nbformat.write(notebook, folder / "submitted" / name / stem / f"{stem}.ipynb")
    run("nbgrader", "autograde", stem, cwd=folder)
    run("nbgrader", "export", cwd=folder)
    with (folder / "grades.csv").open() as file:
        rows = {row["student_id"]: row for row in csv.DictReader(file) if row["assignment"] == stem}
    scores = {name: (float(row["score"]), float(row["max_score"])) for name, row in rows.items()}
    full = maximum(stem)
    assert scores == {"ada": (full, full), "bob": (int(stem == "00_tour"), full)}
    if stem == "00_tour":
        graded = (folder / "autograded" / "bob" / stem / f"{stem}.ipynb").read_text()
        assert "Hint: This is the fraction that passes" in graded


@needs_otter
@pytest.mark.parametrize("stem", STEMS)
def test_otter(stem, otter_course, tmp_path):
    def graded(submission):
        (autograder,) = (folder / stem / "autograder").glob("*.zip")
        shutil.copy(submission, tmp_path / "graded.ipynb")
        run("otter", "run", "-a", autograder, "-o", tmp_path, "--no-logo", tmp_path / "graded.ipynb")
        tests = json.loads((tmp_path / "results.json").read_text())["tests"]
        return sum(test.get("score", 0) for test in tests), sum(test.get("max_score", 0) for test in tests), tests

    students, folder = otter_course
    student, full = check_student_version(students[stem]), maximum(stem)
    assert graded(folder / stem / "autograder" / f"{stem}.ipynb")[:2] == (full, full)
    nbformat.write(with_one_point(student, stem), tmp_path / "bob.ipynb")
    points, most, tests = graded(tmp_path / "bob.ipynb")
    assert (points, most) == (int(stem == "00_tour"), full)
    if stem == "00_tour":
        assert "Hint: This is the fraction that passes" in tests[0]["output"], "public, with the hint"
        assert "00-opacity, case 1: half a metre of air" in json.dumps(tests)
