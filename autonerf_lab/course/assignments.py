"""Assignments: the notebooks with solutions, points and hidden tests, for two grading tools.

A notebook becomes a list of cells with a role. The modules ``nbgrader`` and ``otter`` mark the roles in the format of
their tool; both tools then remove solutions and hidden tests themselves.

In grading, only imports, answers and tests run, so that a notebook is graded in seconds: all other cells have the tags
``skip-execution`` and ``otter_ignore``, which the tools obey and JupyterLab ignores.
"""

import ast
import copy
import inspect
import re
import textwrap
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from autonerf_lab.course.checker import Exercise
from autonerf_lab.course.notebooks import notebook_paths
from autonerf_lab.errors import DataError, UnknownNameError
from autonerf_lab.utils import storage

CONTEXT, IMPORTS, ANSWER = "context", "imports", "answer"
SKIP_TAGS = ["skip-execution", "otter_ignore"]  # of nbclient and of otter-grader


@dataclass(frozen=True)
class Part:
    """Cell of an assignment with its role; ``exercise`` and ``answer`` (a name) only of an answer."""

    role: str
    cell: Any
    exercise: Exercise | None = None
    answer: str = ""


def select_notebooks(numbers: Iterable[str] | None = None) -> list[Path]:
    """Return the notebooks of some numbers, such as ``00`` and ``06``; all of them without numbers.

    Raises:
        UnknownNameError: There is no notebook of a number; the message lists the numbers.
    """
    paths = {path.name[:2]: path for path in notebook_paths()}
    chosen = list(numbers or ()) or list(paths)
    for number in chosen:
        if number not in paths:
            raise UnknownNameError("notebook", number, paths)
    return [paths[number] for number in chosen]


def write_notebook(notebook: Any, path: Path) -> None:
    """Write a notebook, and the folder that it is in.

    Raises:
        DataError: The file cannot be written.
    """
    import nbformat

    storage.write_bytes(path, f"{nbformat.writes(notebook)}\n".encode())


def parts_of(notebook: Any, exercises: dict[str, Exercise], begin: str, end: str) -> list[Part]:
    """Divide a notebook into parts; cells that show a solution are left out.

    Args:
        notebook: Notebook of the course, of nbformat 4.
        exercises: Exercises by name.
        begin, end: Lines around a solution, such as ``### BEGIN SOLUTION``.

    Raises:
        DataError: An answer cell has no function or class of the name that is checked.
    """
    parts = []
    first_code = True
    for cell in copy.deepcopy(notebook.cells):
        found = re.search(r'^course\.check\("([^"]+)", (\w+)\)$', cell.source, re.MULTILINE)
        if cell.cell_type != "code":
            parts.append(Part(CONTEXT, cell))
        elif first_code:
            first_code = False
            parts += _imports_and_rest(cell)
        elif re.match(r'course\.solution\("', cell.source):
            continue
        elif found and cell.id.endswith("-exercise"):
            exercise = exercises[found[1]]
            cell.source = with_solution(cell.source, found[2], exercise, begin, end)
            parts.append(Part(ANSWER, cell, exercise, found[2]))
        else:
            parts.append(Part(CONTEXT, _skipped(cell)))
    return parts


def _imports_and_rest(cell: Any) -> list[Part]:
    """Divide the first code cell, so that grading needs only the imports."""
    imports = [node for node in ast.parse(cell.source).body if isinstance(node, ast.Import | ast.ImportFrom)]
    lines = cell.source.splitlines()
    last = max((node.end_lineno or 0 for node in imports), default=0)
    rest = copy.deepcopy(cell)
    cell.source, rest.source = "\n".join(lines[:last]), "\n".join(lines[last:]).strip("\n")
    rest.id = f"{cell.id}-rest"
    return [Part(IMPORTS, cell), *([Part(CONTEXT, _skipped(rest))] if rest.source else [])]


def _skipped(cell: Any) -> Any:
    cell.metadata["tags"] = [*cell.metadata.get("tags", []), *SKIP_TAGS]
    return cell


def with_solution(source: str, name: str, exercise: Exercise, begin: str, end: str) -> str:
    """Return an answer cell in which the solution of the exercise stands between two marks, instead of ``...``.

    Without the marked lines, and with ``...`` for them, the cell is the original again. A solution that is a class
    follows the unfinished class.

    Raises:
        DataError: The cell does not define the name.
    """
    nodes = {node.name: node for node in ast.parse(source).body if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    if name not in nodes:
        raise DataError(f"the answer cell of {exercise.name} defines no {name!r}")
    node, lines = nodes[name], source.splitlines()
    given = textwrap.dedent(inspect.getsource(exercise.solution))
    made = ast.parse(given).body[0]
    if isinstance(made, ast.FunctionDef) and isinstance(node, ast.FunctionDef):
        first = node.body[-1].lineno - 1  # of the line with "..."
        after_docstring = made.body[0].end_lineno if ast.get_docstring(made) else made.lineno
        body = given.splitlines()[after_docstring:]
        new = [f"    {begin}", *body, f"    {end}"]
    else:
        first = node.end_lineno or 0
        new = ["", "", begin, re.sub(r"\A(class|def) \w+", rf"\1 {name}", given).rstrip(), end]
    return "\n".join([*lines[:first], *new, *lines[node.end_lineno :]])


def points_of(exercise: Exercise) -> int:
    """Return the points of an exercise: one per case of the checker."""
    return len(exercise.cases)
