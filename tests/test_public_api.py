"""The public names: what a user, an editor and a type checker find."""

import ast
import re
import subprocess
import sys
from collections.abc import Callable
from graphlib import TopologicalSorter
from pathlib import Path

import grimp
import pytest

import autonerf_lab as lab
from autonerf_lab.errors import WrongTypeError

PACKAGE = Path(lab.__file__).parent
STUB = ast.parse((PACKAGE / "__init__.pyi").read_text())
NAMES = sorted(alias.name for node in STUB.body if isinstance(node, ast.ImportFrom) for alias in node.names)
SCRIPT = Path(__file__).parent / "support/user_script.py"


def test_dir_lists_exactly_the_public_names() -> None:
    assert dir(lab) == NAMES == sorted(lab.__all__)


@pytest.mark.parametrize("name", NAMES)
def test_every_public_name_loads_and_is_documented(name: str) -> None:
    assert getattr(lab, name).__doc__


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="nonsense"):
        lab.nonsense  # noqa: B018


def test_importing_the_package_loads_nothing_heavy() -> None:
    code = (
        "import sys, autonerf_lab; print([m for m in ('torch', 'numba', 'matplotlib', 'trimesh') if m in sys.modules])"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"


def test_tables_of_finished_results_load_no_torch() -> None:
    code = "import sys, autonerf_lab.benchmark.paper_tables; print('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "False\n"


def test_modules_import_each_other_in_no_circle() -> None:
    """Circular imports are errors only for some orders of import; without a circle every order works."""
    graph = grimp.build_graph("autonerf_lab", exclude_type_checking_imports=True)
    imported = {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}
    assert len(imported) > 300 and any(imported.values())
    tuple(TopologicalSorter(imported).static_order())  # names a circle


@pytest.mark.parametrize(
    "command",
    [
        ["-m", "mypy", "--config-file", SCRIPT.with_name("mypy.ini")],
        ["-m", "basedpyright", "--pythonpath", sys.executable, "--project", SCRIPT.with_name("pyrightconfig.json")],
    ],
    ids=["mypy", "pyright"],
)
def test_type_checkers_accept_a_script_of_a_user(command: list[str | Path], tmp_path: Path) -> None:
    """Run from elsewhere, so that the names come from the installed package."""
    result = subprocess.run(
        [sys.executable, *command, SCRIPT], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stdout


@pytest.mark.parametrize(
    ("call", "advice"),
    [
        (lambda: lab.Simulator("dev-0"), "pass lab.load_scene('dev-0')"),
        (lambda: lab.explore("dev-0"), "pass lab.Simulator(lab.load_scene('dev-0'))"),
        (lambda: lab.fit("runs/a"), "pass lab.load_trajectory('runs/a')"),
        (lambda: lab.evaluate("runs/a", "dev-0"), "pass lab.load_nerf('runs/a')"),
        (lambda: lab.evaluate(object(), "dev-0"), "pass lab.load_scene('dev-0')"),
    ],
)
def test_a_name_in_place_of_an_object_says_how_to_load_it(call: Callable[[], object], advice: str) -> None:
    with pytest.raises(WrongTypeError, match=re.escape(advice)):
        call()
