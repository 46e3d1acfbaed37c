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

NUMBERS = os.environ.get("AUTONERF_LAB_GRADED_NOTEBOOKS", "00,04")  # "all" takes five minutes
SELECTED = None if NUMBERS == "all" else NUMBERS
PATH = os.pathsep.join([sysconfig.get_path("scripts"), os.environ["PATH"]])  # nbgrader runs alembic


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
    selection = [] if SELECTED is None else ["--notebooks", SELECTED]
    printed = run("autonerf_lab.cli", "course", "export", "--to", tool, "--out", folder, *selection).stdout
    return [Path(line) for line in printed.splitlines() if line.endswith(".ipynb")]


def maximum(stem):
    return sum(points_of(exercise) for name, exercise in course.EXERCISES.items() if name[:2] == stem[:2])


def sources(notebook):
    return "\n".join(cell.source for cell in notebook.cells)


def check_student_version(path):
    notebook = nbformat.read(path, as_version=4)
    text = sources(notebook)
    for hidden in ("SOLUTION", "HIDDEN", "course.solution", "course.grade"):
        assert hidden not in text and hidden not in json.dumps(notebook.metadata)
    assert not any(cell.get("outputs") for cell in notebook.cells)
    return notebook


def answer_with(notebook, start, source):
    """Replace the answer cell that starts with a line; the others stay empty."""
    (cell,) = [cell for cell in notebook.cells if cell.source.startswith(start)]
    cell.source = source
    return notebook


FRACTION = "def opacity(s, d):\n    print('noise')\n    return np.exp(-s * d)"  # the fraction that passes: 1 of 4 cases


@pytest.mark.skipif(find_spec("nbgrader") is None, reason="needs the extra nbgrader")
def test_nbgrader(tmp_path):
    for path in exported("nbgrader", tmp_path):
        release, stem = check_student_version(path), path.stem
        instructor = tmp_path / "source" / stem / path.name
        assert "### BEGIN SOLUTION" in sources(nbformat.read(instructor, as_version=4))
        student = answer_with(release, "def opacity", FRACTION) if stem == "00_tour" else release
        for name, notebook in (("ada", nbformat.read(instructor, as_version=4)), ("bob", student)):
            (tmp_path / "submitted" / name / stem).mkdir(parents=True)
            nbformat.write(notebook, tmp_path / "submitted" / name / stem / path.name)
        run("nbgrader", "autograde", stem, cwd=tmp_path)
    run("nbgrader", "export", cwd=tmp_path)
    with (tmp_path / "grades.csv").open() as file:
        rows = [row for row in csv.DictReader(file)]
    assert rows
    for row in rows:
        full = maximum(row["assignment"])
        expected = full if row["student_id"] == "ada" else int(row["assignment"] == "00_tour")
        assert (float(row["max_score"]), float(row["score"])) == (full, expected), row
    graded = (tmp_path / "autograded" / "bob" / "00_tour" / "00_tour.ipynb").read_text()
    assert "Hint: This is the fraction that passes" in graded


@pytest.mark.skipif(find_spec("otter") is None, reason="needs the extra otter")
def test_otter(tmp_path):
    def graded(stem, submission):
        (autograder,) = (tmp_path / stem / "autograder").glob("*.zip")
        shutil.copy(submission, tmp_path / "graded.ipynb")
        run("otter", "run", "-a", autograder, "-o", tmp_path, "--no-logo", tmp_path / "graded.ipynb")
        tests = json.loads((tmp_path / "results.json").read_text())["tests"]
        return sum(test.get("score", 0) for test in tests), sum(test.get("max_score", 0) for test in tests), tests

    for path in exported("otter", tmp_path):
        student, stem = check_student_version(path), path.stem
        assert graded(stem, tmp_path / stem / "autograder" / path.name)[:2] == (maximum(stem), maximum(stem))
        if stem == "00_tour":
            nbformat.write(answer_with(student, "def opacity", FRACTION), tmp_path / "bob.ipynb")
            points, full, tests = graded(stem, tmp_path / "bob.ipynb")
            assert (points, full) == (1, maximum(stem))
            assert "Hint: This is the fraction that passes" in tests[0]["output"], "public, with the hint"
            assert "00-opacity, case 1: half a metre of air" in json.dumps(tests)
