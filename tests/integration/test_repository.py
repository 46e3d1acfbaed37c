"""Properties of the repository as a whole: packaging, installation, documents, imports, examples."""

import ast
import os
import re
import shutil
import socket
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from itertools import chain
from pathlib import Path

import pytest
import toy_photos
import yaml
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
FOR_NOTEBOOKS = {"notebooks", "training", "viewer"}  # extras
MARKDOWN = sorted(
    path
    for path in [*ROOT.glob("*.md"), *(p for f in ("docs", "benchmarks", "examples") for p in (ROOT / f).rglob("*.md"))]
    if "generated" not in path.parts
)
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
    attempts = {
        "connect": lambda s: s.connect(("192.0.2.1", 80)),
        "connect_ex": lambda s: s.connect_ex(("192.0.2.1", 80)),
        "sendto": lambda s: s.sendto(b"x", ("192.0.2.1", 80)),
        "sendmsg": lambda s: s.sendmsg([b"x"], [], 0, ("192.0.2.1", 80)),
        "a name that begins like loopback": lambda s: s.connect(("127.example.org", 80)),
    }
    for attempt in attempts.values():
        with socket.socket(type=socket.SOCK_DGRAM) as s, pytest.raises(OSError, match="tried to reach"):
            attempt(s)
    code = "import socket; socket.create_connection(('192.0.2.1', 80), 5)"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "NetworkBlockedError" in result.stderr


def test_loopback_is_open():
    with socket.create_server(("127.0.0.1", 0)) as server, socket.create_connection(server.getsockname()):
        pass


@pytest.mark.parametrize("path", PYTHON_FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_no_pickle_and_no_long_module(path):
    """Pickle runs code from files, so no module may use it. A module has at most 400 lines."""
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


def test_public_names_do_not_depend_on_earlier_imports():
    """Importing a submodule of the same name must not replace a function of the package."""
    code = (
        "import importlib, pathlib, pkgutil, re, autonerf_lab as lab\n"
        "for m in pkgutil.walk_packages(lab.__path__, 'autonerf_lab.'):\n"
        "    if m.name.rpartition('.')[2] in lab.__all__: importlib.import_module(m.name)\n"
        "packages = re.findall(r'from [.] import (\\w+)', pathlib.Path(lab.__file__ + 'i').read_text())\n"
        "for name in set(lab.__all__) - set(packages): assert callable(getattr(lab, name)), name"
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


def test_version_is_the_same_everywhere():
    version = PYPROJECT["project"]["version"]
    assert f'__version__ = "{version}"' in (ROOT / "autonerf_lab/version.py").read_text()
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text()


def test_the_address_of_the_repository_is_the_same_everywhere():
    command = [sys.executable, "docs/set_owner.py", "--check"]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 0, f"run `python docs/set_owner.py`; it would change:\n{result.stdout}"


def test_the_address_of_the_repository_is_decided_in_one_place(tmp_path):
    for name in ("docs", "notebooks"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("generated"))
    for name in ("pyproject.toml", "README.md", "CITATION.cff"):
        shutil.copy(ROOT / name, tmp_path)
    before = {path: path.read_text() for path in tmp_path.rglob("*") if path.suffix in (".md", ".cff", ".ipynb")}
    project = (tmp_path / "pyproject.toml").read_text()
    if "urls" not in PYPROJECT["project"]:
        addresses = '[project.urls]\nRepository = "https://github.com/somebody/autonerf-lab"\n\n[project.scripts]'
        (tmp_path / "pyproject.toml").write_text(project.replace("[project.scripts]", addresses))
    subprocess.run([sys.executable, "docs/set_owner.py"], cwd=tmp_path, check=True, capture_output=True)
    for path in [tmp_path / "README.md", *(tmp_path / "notebooks").glob("*.ipynb")]:
        text = path.read_text()
        assert "colab.research.google.com/github/" in text and "mybinder.org/v2/gh/" in text and "OWNER" not in text
    (tmp_path / "pyproject.toml").write_text(project)
    subprocess.run([sys.executable, "docs/set_owner.py"], cwd=tmp_path, check=True, capture_output=True)
    assert {path: path.read_text() for path in before} == before


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
    assert {"notebooks", "gl", "open3d", "viewer", "cluster", "docs", "dev", "all"} <= set(
        PYPROJECT["project"]["optional-dependencies"]
    )


def test_continuous_integration_is_make_test():
    assert os.access(ROOT / ".ci/run", os.X_OK)
    assert "make test" in (ROOT / ".ci/run").read_text()
    assert ".ci/run" in (ROOT / ".github/workflows/test.yml").read_text()


@pytest.mark.parametrize("path", sorted((ROOT / ".github/workflows").glob("*.yml")), ids=lambda path: path.stem)
def test_workflows_have_least_permissions_and_actions_pinned_by_commit(path):
    workflow = yaml.safe_load(path.read_text())
    assert workflow["permissions"] == {"contents": "read"}
    for job in workflow["jobs"].values():
        assert job["timeout-minutes"] <= 60
        for step in job["steps"]:
            assert "run" in step or re.search(r"@[0-9a-f]{40}$", step["uses"])
    assert all(re.search(r" # v\d+\.\d+\.\d+$", line) for line in path.read_text().splitlines() if "uses:" in line)


@pytest.mark.parametrize("path", [*MARKDOWN, ROOT / "Makefile", ROOT / "autonerf_lab/pipeline/report.html.jinja"],
                         ids=lambda path: str(path.relative_to(ROOT)))  # fmt: skip
def test_documents_are_for_strangers(path):
    assert not re.search(r"TODO|FIXME|\bissue \d|/work/", path.read_text())


def _anchors(path: Path) -> set[str]:
    """Return the anchors of the headings of a Markdown file, as GitHub and MyST make them."""
    text = re.sub(r"(?ms)^```.*?^```", "", path.read_text())
    headings = [heading.replace("`", "") for heading in re.findall(r"(?m)^#+ (.+)$", text)]
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("path", MARKDOWN, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_link_leads_somewhere(path):
    text = re.sub(r"(?ms)^```.*?^```", "", path.read_text())
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        if not re.match(r"[a-z]+:", link):
            name, _, anchor = link.partition("#")
            target = path.parent / name if name else path
            assert target.is_file(), f"{path.name} links {link}"
            assert not anchor or anchor in _anchors(target), f"{link}: {target.name} has no such heading"


def _with_venv(**extra: str) -> dict[str, str]:
    return {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}", **extra}


@pytest.fixture
def source(tmp_path):
    """Return a copy of the repository without what is made from it."""
    folder = tmp_path / "source"
    folder.mkdir()
    made = shutil.ignore_patterns("__pycache__", ".ipynb_checkpoints", "generated")
    for name in ("autonerf_lab", "data", "notebooks", "examples", "docs", "benchmarks", "tests", ".ci"):
        shutil.copytree(ROOT / name, folder / name, ignore=made)
    for path in ROOT.iterdir():
        if path.is_file():
            shutil.copy(path, folder)
    return folder


def test_wheel_holds_the_package_the_frozen_scenes_and_the_notebooks(tmp_path, source):
    command = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "--no-index", "-w", tmp_path]
    subprocess.run([*command, source], check=True, capture_output=True)
    wheel = zipfile.ZipFile(next(tmp_path.glob("*.whl")))
    names = set(wheel.namelist())
    page = wheel.read(next(name for name in names if name.endswith(".dist-info/METADATA"))).decode()
    assert "Description-Content-Type: text/markdown" in page and "# AutoNeRF Lab" in page
    assert all("://" in target or target.startswith("#") for target in re.findall(r"\]\(([^)]*)\)", page))
    modules = {str(path.relative_to(ROOT)) for path in (ROOT / "autonerf_lab").rglob("*.py")}
    frozen = ROOT / "data/procedural_scenes"
    scenes = {f"autonerf_lab/procedural_scenes/{p.relative_to(frozen)}" for p in frozen.rglob("*") if p.is_file()}
    notebooks = {f"autonerf_lab/notebooks/{path.name}" for path in (ROOT / "notebooks").glob("*.ipynb")}
    assert modules | scenes | notebooks | {"autonerf_lab/pipeline/report.html.jinja", "autonerf_lab/py.typed"} <= names
    assert all(name.startswith(("autonerf_lab/", "autonerf_lab-", "autonerf_lab.")) for name in names)


def test_sdist_holds_notebooks_examples_and_documentation(tmp_path, source):
    code = f"from setuptools.build_meta import build_sdist; build_sdist({str(tmp_path)!r})"
    subprocess.run([sys.executable, "-c", code], cwd=source, check=True, capture_output=True)
    with tarfile.open(next(tmp_path.glob("*.tar.gz"))) as archive:
        names = {member.name.partition("/")[2] for member in archive.getmembers() if member.isfile()}
    for folder in ("notebooks", "examples", "data", "docs", "tests", "benchmarks", ".ci"):
        files = {str(path.relative_to(source)) for path in (source / folder).rglob("*") if path.is_file()}
        files -= {name for name in files if name.startswith("docs/notebooks/")}
        assert files and files <= names
    assert {"CHANGELOG.md", "CONTRIBUTING.md", "CITATION.cff", "LICENSE", "Makefile", "constraints.txt"} <= names


# --- .ci/install, with something missing ---------------------------------------------------


@pytest.fixture
def checkout(tmp_path):
    """Copy the files that the installation reads, beside a folder of commands that replace those of the system."""
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


# Fake Python: answers the version check and the test for ensurepip, and makes a .venv whose pip exits with $PIP.
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


def test_missing_python(checkout):
    result = _install(checkout, PYTHON="missing-python")
    assert result.returncode == 1
    assert "there is no 'missing-python'" in result.stderr and not (checkout / ".venv").exists()


def test_old_python(checkout):
    _command(checkout, "fakepython", 'case "$*" in *--version*) echo "Python 3.9.2" ;; *) exit 1 ;; esac')
    result = _install(checkout)
    assert result.returncode == 1
    assert "Python 3.9.2, and Python 3.11 to 3.13 is needed" in result.stderr and not (checkout / ".venv").exists()


def test_missing_packages_without_root_are_named_and_nothing_is_changed(checkout):
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


def test_missing_packages_are_installed_by_root(checkout):
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


def test_lab_installs_the_extras_of_the_notebooks(checkout):
    _command(checkout, "fakepython", FAKE_PYTHON)
    assert _install(checkout, "lab").returncode == 0
    (extras,) = re.findall(r"-e \.\[(.+)\]", (checkout / "pip.log").read_text())
    assert set(extras.split(",")) == FOR_NOTEBOOKS and (checkout / ".venv/.installed-lab").exists()


def test_failed_pip_leaves_no_stamp_and_the_next_call_continues(checkout):
    _command(checkout, "fakepython", FAKE_PYTHON)
    _command(checkout, "dpkg-query", ALL_INSTALLED)
    failed = _install(checkout, PIP="1", PIP_ARGS="--extra-index-url https://example.org/cpu")
    assert failed.returncode == 1 and "Run the same command again" in failed.stderr
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
        # make takes a Python that prints nothing for a broken .venv
        (checkout / ".venv/bin/python").write_text("#!/bin/sh\necho 1\n")
    assert len((checkout / "pip.log").read_text().splitlines()) == 1


def test_example_compares_policies():
    command = [sys.executable, "examples/compare_policies.py", "--scenes", "dev-0", "--steps", "20"]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    header, line = result.stdout.splitlines()
    assert header.split()[-2:] == ["random", "frontier"] and line.startswith("dev-0")


def test_example_runs_the_whole_chain(tmp_path):
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
