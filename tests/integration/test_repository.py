"""Promises that the repository as a whole makes."""

import ast
import os
import re
import shutil
import socket
import subprocess
import sys
import tomllib
import zipfile
from itertools import chain
from pathlib import Path

import pytest
import toy_photos
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
FOR_NOTEBOOKS = {"notebooks", "training", "viewer"}  # extras
PYTHON_FILES = sorted(
    path
    for folder in ("autonerf_lab", "tests", "benchmarks", "examples", "docs")
    for path in (ROOT / folder).rglob("*.py")
    if "build" not in path.parts
)


def test_imports_point_one_way():
    result = subprocess.run(["lint-imports"], cwd=ROOT, env=_with_venv(), capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout


def test_the_network_is_blocked_here_and_in_child_processes():
    with socket.socket() as s, pytest.raises(OSError, match="tried to reach"):
        s.connect(("192.0.2.1", 80))
    code = "import socket; socket.create_connection(('192.0.2.1', 80), 5)"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "NetworkBlockedError" in result.stderr


def test_loopback_is_open():
    with socket.create_server(("127.0.0.1", 0)) as server, socket.create_connection(server.getsockname()):
        pass


@pytest.mark.parametrize("path", PYTHON_FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_nothing_loads_code_from_data(path):
    """Pickle runs what it reads, so no file of the tree may unpickle; and a module reads in one sitting."""
    text = path.read_text()
    assert len(text.splitlines()) <= 400
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            assert not {a.name.split(".")[0] for a in node.names} & {"pickle", "dill", "cloudpickle", "joblib"}
        if isinstance(node, ast.ImportFrom):
            assert (node.module or "").split(".")[0] not in ("pickle", "dill", "cloudpickle", "joblib")
        if isinstance(node, ast.Call):
            assert ast.unparse(node.func) not in ("torch.load", "eval", "exec")
            for keyword in node.keywords:
                assert keyword.arg != "allow_pickle" or ast.unparse(keyword.value) == "False"


def test_first_lesson_names_mean_the_same_whatever_was_imported_before():
    """A submodule of the same name would take the place of a function in the package, once something imports it."""
    code = (
        "import importlib, pkgutil, autonerf_lab as lab\n"
        "for m in pkgutil.walk_packages(lab.__path__, 'autonerf_lab.'): importlib.import_module(m.name)\n"
        "for name in lab.__all__: assert callable(getattr(lab, name)), name"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr


def test_every_dependency_has_a_tested_version():
    lines = [line for line in (ROOT / "constraints.txt").read_text().splitlines() if not line.startswith("#")]
    pins = dict(line.split("==") for line in lines)
    assert pins["torch"] == "2.13.0"
    extras = PYPROJECT["project"]["optional-dependencies"]
    for requirement in map(Requirement, chain(PYPROJECT["project"]["dependencies"], *extras.values())):
        name = canonicalize_name(requirement.name)
        if name != "autonerf-lab":
            assert name in pins
            assert requirement.specifier.contains(pins[name]), f"constraints.txt and pyproject.toml disagree on {name}"


@pytest.mark.parametrize("name", ["README.md", *(f"notebooks/{path.name}" for path in ROOT.glob("notebooks/*.ipynb"))])
def test_the_address_of_the_repository_is_the_same_everywhere(name):
    repository = PYPROJECT["project"]["urls"]["Repository"].removeprefix("https://github.com/")
    found = re.findall(r"(?:colab\.research\.google\.com/github|mybinder\.org/v2/gh|git\+https://github\.com)/(\w\S+?/[\w-]+)",
                       (ROOT / name).read_text())  # fmt: skip
    assert len(found) >= 2 and set(found) == {repository}, f"{name} and pyproject.toml disagree on the repository"


def test_binder_installs_what_the_notebooks_need():
    binder = ROOT / ".binder"
    lines = (binder / "requirements.txt").read_text().splitlines()
    assert (binder / next(line for line in lines if line.startswith("-c ")).split()[1]).samefile(
        ROOT / "constraints.txt"
    )
    extras = re.search(r"^-e \.\[(.+)\]$", lines[-1])
    assert extras and FOR_NOTEBOOKS <= set(extras[1].split(",")) <= set(PYPROJECT["project"]["optional-dependencies"])
    assert os.access(binder / "postBuild", os.X_OK)
    python = (binder / "runtime.txt").read_text().strip().removeprefix("python-")
    assert SpecifierSet(PYPROJECT["project"]["requires-python"]).contains(python)


def test_extras():
    assert {"notebooks", "gl", "open3d", "viewer", "cluster", "dev", "all"} <= set(
        PYPROJECT["project"]["optional-dependencies"]
    )


def test_continuous_integration_is_make_test():
    assert os.access(ROOT / ".ci/run", os.X_OK)
    assert "make test" in (ROOT / ".ci/run").read_text()
    assert ".ci/run" in (ROOT / ".github/workflows/test.yml").read_text()


@pytest.mark.parametrize("name", ["README.md", "Makefile", "autonerf_lab/pipeline/report.html.jinja"])
def test_words_for_strangers(name):
    assert not re.search(r"TODO|FIXME|\bissue \d|/work/", (ROOT / name).read_text())


def test_every_file_that_readme_links_exists():
    text = (ROOT / "README.md").read_text()
    links = [link for link in re.findall(r"\]\(([^)#]+)\)", text) if "://" not in link]
    assert links
    for link in links:
        assert (ROOT / link).exists(), link


def _with_venv(**extra: str) -> dict[str, str]:
    return {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}", **extra}


def test_wheel_holds_the_package_and_the_frozen_scenes(tmp_path):
    source = tmp_path / "source"
    for name in ("autonerf_lab", "data"):
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    command = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "--no-index", "-w", tmp_path]
    subprocess.run([*command, source], check=True, capture_output=True)
    names = set(zipfile.ZipFile(next(tmp_path.glob("*.whl"))).namelist())
    modules = {str(path.relative_to(ROOT)) for path in (ROOT / "autonerf_lab").rglob("*.py")}
    frozen = ROOT / "data/procedural_scenes"
    scenes = {f"autonerf_lab/procedural_scenes/{p.relative_to(frozen)}" for p in frozen.rglob("*") if p.is_file()}
    assert modules | scenes | {"autonerf_lab/pipeline/report.html.jinja"} <= names


# --- .ci/install: what a newcomer meets when something is missing ---------------------------------------------------


@pytest.fixture
def checkout(tmp_path):
    """The files that the installation reads, and a folder of commands that stand in for the system's."""
    if sys.platform == "win32":
        pytest.skip("a POSIX shell is needed")
    for name in (".ci/install", "Makefile", "apt.txt", "constraints.txt", "pyproject.toml"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    (tmp_path / "bin").mkdir()
    return tmp_path


def _command(checkout: Path, name: str, script: str) -> None:
    path = checkout / "bin" / name
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(0o755)


def _install(checkout: Path, flavour: str = "all", **env: str) -> subprocess.CompletedProcess:
    path = f"{checkout / 'bin'}{os.pathsep}{os.environ['PATH']}"
    return subprocess.run(
        ["sh", ".ci/install", flavour],
        cwd=checkout,
        env={**os.environ, "PATH": path, "PYTHON": "fakepython", **env},
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )


# Answers the version check, says whether ensurepip is there, and makes a .venv whose pip obeys $PIP.
FAKE_PYTHON = """
case "$*" in
*version_info\\[:2\\]\\ \\<=*) exit 0 ;;
*"import ensurepip"*) exit ${NO_ENSUREPIP:-0} ;;
*"%d.%d-venv"*) echo python3.11-venv ;;
*--version*) echo "Python 3.11.2" ;;
*"-m venv"*) mkdir -p .venv/bin; cp "$0" .venv/bin/python; echo made >>venv.log ;;
*"-m pip --version"*) test -x .venv/bin/python ;;
*"-m pip install"*) echo "$@" >>pip.log; exit ${PIP:-0} ;;
esac
"""
ALL_INSTALLED = "echo installed"


def test_python_that_is_missing(checkout):
    result = _install(checkout, PYTHON="python-of-nobody")
    assert result.returncode == 1
    assert "there is no 'python-of-nobody'" in result.stderr and not (checkout / ".venv").exists()


def test_python_that_is_too_old(checkout):
    _command(checkout, "fakepython", 'case "$*" in *--version*) echo "Python 3.9.2" ;; *) exit 1 ;; esac')
    result = _install(checkout)
    assert result.returncode == 1
    assert "Python 3.9.2, and Python 3.11 to 3.13 is needed" in result.stderr and not (checkout / ".venv").exists()


def test_missing_packages_without_rights_are_named_and_nothing_is_made(checkout):
    _command(checkout, "fakepython", FAKE_PYTHON)
    _command(checkout, "id", "echo 1000")
    _command(checkout, "sudo", "exit 1")
    _command(checkout, "apt-get", "exit 1")
    _command(checkout, "dpkg-query", 'case "$*" in *libgomp1*) echo installed ;; *) exit 1 ;; esac')
    _command(checkout, "google-chrome", "exit 0")  # in place of chromium
    result = _install(checkout, NO_ENSUREPIP="1")
    assert result.returncode == 1
    assert "apt-get install --no-install-recommends python3.11-venv libegl1 libgl1 libusb-1.0-0\n" in result.stderr
    assert not (checkout / ".venv").exists()


def test_missing_packages_are_installed_where_that_is_allowed(checkout):
    _command(checkout, "fakepython", FAKE_PYTHON)
    _command(checkout, "id", "echo 0")
    _command(checkout, "apt-get", f'echo "$@" >>{checkout}/apt.log')
    _command(checkout, "dpkg-query", 'case "$*" in *libusb*) exit 1 ;; *) echo installed ;; esac')
    assert _install(checkout).returncode == 0
    assert "install -y -qq --no-install-recommends libusb-1.0-0" in (checkout / "apt.log").read_text()
    assert (checkout / ".venv/.installed-all").exists()


def test_main_job_needs_no_debian_packages(checkout):
    _command(checkout, "fakepython", FAKE_PYTHON)
    _command(checkout, "dpkg-query", "exit 1")
    assert _install(checkout, "base").returncode == 0
    assert (checkout / ".venv/.installed-base").exists() and not (checkout / ".venv/.installed-all").exists()


def test_the_lab_gets_what_the_notebooks_need(checkout):
    _command(checkout, "fakepython", FAKE_PYTHON)
    assert _install(checkout, "lab").returncode == 0
    (extras,) = re.findall(r"-e \.\[(.+)\]", (checkout / "pip.log").read_text())
    assert set(extras.split(",")) == FOR_NOTEBOOKS and (checkout / ".venv/.installed-lab").exists()


def test_pip_that_fails_leaves_no_stamp_and_the_next_call_goes_on(checkout):
    _command(checkout, "fakepython", FAKE_PYTHON)
    _command(checkout, "dpkg-query", ALL_INSTALLED)
    failed = _install(checkout, PIP="1", PIP_ARGS="--extra-index-url https://example.org/cpu")
    assert failed.returncode == 1 and "run the same command again" in failed.stderr
    assert not list(checkout.glob(".venv/.installed-*"))
    assert _install(checkout).returncode == 0
    assert (checkout / "venv.log").read_text() == "made\n"  # .venv was made once
    first, second = (checkout / "pip.log").read_text().splitlines()
    assert "--extra-index-url https://example.org/cpu -c constraints.txt" in first
    assert "-e .[all,dev]" in second


def test_make_installs_once(checkout):
    _command(checkout, "fakepython", FAKE_PYTHON)
    _command(checkout, "dpkg-query", ALL_INSTALLED)
    env = {**os.environ, "PATH": f"{checkout / 'bin'}{os.pathsep}{os.environ['PATH']}"}
    for _ in range(2):
        subprocess.run(["make", "setup", "PYTHON=fakepython"], cwd=checkout, env=env, check=True, capture_output=True)
        # the fake one does not print, which make takes for a broken .venv
        (checkout / ".venv/bin/python").write_text("#!/bin/sh\necho 1\n")
    assert len((checkout / "pip.log").read_text().splitlines()) == 1


def test_example_compares_policies():
    command = [sys.executable, "examples/compare_policies.py", "--scenes", "dev-0", "--steps", "20"]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    header, line = result.stdout.splitlines()
    assert header.split()[-2:] == ["random", "frontier"] and line.startswith("dev-0")


def test_example_walks_the_whole_chain(tmp_path):
    options = ["--frames", "50", "--scene", "train-01", "--steps", "60", "--preset", "smoke", "--out", tmp_path]
    command = [sys.executable, "examples/whole_chain.py", *options]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    assert "nearest_view" in result.stdout and "pointgoal_success" in result.stdout
    assert f"{tmp_path / 'policy'}" in result.stdout.splitlines()[-1], "the policy that was just trained"
    assert (tmp_path / "maps.png").stat().st_size > 1000


def test_example_fits_photographs(tmp_path):
    data = toy_photos.photographs(toy_photos.orbit(24))
    folder = toy_photos.write(data, tmp_path / "photographs")
    options = ["--preset", "smoke", "--steps", "60", "--points", "500", "--out", tmp_path / "field"]
    command = [sys.executable, "examples/photographs.py", folder, *options]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    assert "held_out" in result.stdout and "nearest_view" in result.stdout
    names = [Path(name).stem for name in data.split()[1].names]
    assert {path.stem for path in (tmp_path / "field").glob("*.png")} == {f"held-out-{name}" for name in names}
    assert (tmp_path / "field/points.ply").stat().st_size > 500
