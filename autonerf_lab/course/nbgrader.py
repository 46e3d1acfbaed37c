"""Course folder for nbgrader: instructor versions in ``source``, student versions in ``release``."""

import importlib.util
import os
import subprocess
import sys
import sysconfig
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from autonerf_lab.course.assignments import ANSWER, IMPORTS, Part, parts_of, points_of, select_notebooks, write_notebook
from autonerf_lab.course.checker import Exercise
from autonerf_lab.errors import DataError, MissingPackageError
from autonerf_lab.utils import storage

_CONFIG = '''\
"""Settings of nbgrader for this course folder."""

c = get_config()  # noqa: F821 - defined by nbgrader
c.CourseDirectory.course_id = "autonerf-lab"
c.ClearSolutions.code_stub = {"python": "..."}
c.ExecutePreprocessor.timeout = 300  # seconds for a cell; the first import may compile
c.Execute.timeout = 300
'''
_TEST = """\
# The points of {name}: one per case of the checker.
### BEGIN HIDDEN TESTS
course.grade("{name}", {answer})
### END HIDDEN TESTS"""


def export_nbgrader(out: Path, exercises: dict[str, Exercise], numbers: Iterable[str] | None = None) -> list[Path]:
    """Write a course folder and let nbgrader generate the student versions.

    Args:
        out: Course folder; ``nbgrader`` commands run in it.
        exercises: Exercises by name.
        numbers: Notebooks, such as ``("00", "06")``; None: all.

    Returns:
        The student versions, ``release/NAME/NAME.ipynb``.

    Raises:
        MissingPackageError: nbgrader is not installed.
        DataError: nbgrader failed, or the folder cannot be written.
        UnknownNameError: There is no notebook of a number.
    """
    if importlib.util.find_spec("nbgrader") is None:
        raise MissingPackageError('this export needs nbgrader: pip install "autonerf-lab[nbgrader]"')
    import nbformat

    paths = select_notebooks(numbers)
    for path in paths:
        notebook = nbformat.read(path, as_version=4)
        notebook.cells = _cells(parts_of(notebook, exercises, "### BEGIN SOLUTION", "### END SOLUTION"))
        write_notebook(notebook, out / "source" / path.stem / path.name)
    storage.write_bytes(out / "nbgrader_config.py", _CONFIG.encode())

    for path in paths:
        _generate(out, path.stem)
    return [out / "release" / path.stem / path.name for path in paths]


def _generate(out: Path, assignment: str) -> None:
    command = [sys.executable, "-m", "nbgrader", "generate_assignment", assignment, "--force", "--create"]
    # nbgrader runs `alembic`, which is beside Python but not on the path if the environment is not activated
    path = os.pathsep.join([sysconfig.get_path("scripts"), os.environ.get("PATH", "")])
    result = subprocess.run(
        command, cwd=out, env=os.environ | {"PATH": path}, capture_output=True, text=True, check=False
    )
    if result.returncode:
        raise DataError(f"nbgrader could not generate {assignment}: {(result.stdout + result.stderr).strip()}")


def _cells(parts: list[Part]) -> list[Any]:
    from nbformat.v4 import new_code_cell

    cells = []
    for part in parts:
        cells.append(part.cell)
        if part.role == IMPORTS:
            part.cell.metadata["nbgrader"] = _metadata("imports", locked=True)
        if part.role == ANSWER and part.exercise is not None:
            name = part.exercise.name
            part.cell.metadata["nbgrader"] = _metadata(name, solution=True)
            test = new_code_cell(_TEST.format(name=name, answer=part.answer), id=f"{part.cell.id}-points"[:64])
            test.metadata["nbgrader"] = _metadata(
                f"{name}-points", locked=True, grade=True, points=points_of(part.exercise)
            )
            cells.append(test)
    return cells


def _metadata(grade_id: str, **roles: Any) -> dict[str, Any]:
    base = {"grade": False, "locked": False, "solution": False, "task": False, "schema_version": 3}
    return base | {"grade_id": grade_id} | roles
