"""``autonerf-lab course start``: copies of the notebooks, a line for what is missing, and JupyterLab."""

import json
import os
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

import pytest

from autonerf_lab import cli
from autonerf_lab.course import notebooks
from autonerf_lab.course.notebooks import copy_notebooks, missing_parts, notebook_paths, open_jupyterlab
from autonerf_lab.errors import DataError, MissingPackageError

SOURCES = Path(__file__).parents[2] / "notebooks"


def test_notebooks_are_copied_and_the_work_of_a_student_is_kept(tmp_path):
    folder = tmp_path / "my course"
    copied, kept = copy_notebooks(folder)
    assert [path.name for path in copied] == sorted(path.name for path in SOURCES.glob("*.ipynb")) and not kept
    assert copied[0].read_bytes() == (SOURCES / copied[0].name).read_bytes()
    copied[3].write_text("my answers")
    copied[5].unlink()
    again, kept = copy_notebooks(folder)
    assert again == [copied[5]] and len(kept) == len(copied) - 1 and copied[3].read_text() == "my answers"
    assert copy_notebooks(folder, overwrite=True)[1] == [] and copied[3].read_text() != "my answers"


def test_a_folder_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match=r"cannot copy the notebooks to .*file"):
        copy_notebooks(tmp_path / "file")


def test_installed_notebooks_are_found_without_a_checkout(tmp_path, monkeypatch):
    package = tmp_path / "autonerf_lab"
    monkeypatch.setattr(notebooks, "__file__", str(package / "course" / "notebooks.py"))
    with pytest.raises(DataError, match="reinstall"):
        notebook_paths()
    (package / "notebooks").mkdir(parents=True)
    (package / "notebooks" / "00_tour.ipynb").write_text("{}")
    assert notebook_paths() == [package / "notebooks" / "00_tour.ipynb"]


def test_a_missing_system_library_is_said_in_a_line(tmp_path, monkeypatch):
    (tmp_path / "open3d.py").write_text("raise OSError('libGL.so.1: cannot open shared object file')")
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    monkeypatch.setattr(notebooks, "PACKAGES", {"open3d": "11", "not_installed": "05"})
    monkeypatch.setattr(sys, "platform", "linux")
    library, package = missing_parts()
    assert "11" in library and "libGL.so.1: cannot open" in library and "sudo apt install" in library
    assert package.startswith("notebook 05") and 'pip install "autonerf-lab[notebooks]"' in package
    monkeypatch.setattr(sys, "platform", "win32")
    assert "Visual C++" in missing_parts()[0] and "apt" not in missing_parts()[0]


def test_missing_jupyterlab_names_the_extra(tmp_path, monkeypatch):
    monkeypatch.setattr(notebooks.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(MissingPackageError, match=r"autonerf-lab\[notebooks\]"):
        open_jupyterlab(tmp_path)


def test_copy_only(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(notebooks, "PACKAGES", {})
    number = len(notebooks.notebook_paths())
    for count in (f"{number} notebooks copied, 0 kept", f"0 notebooks copied, {number} kept (see --overwrite)"):
        assert cli.main(["course", "start", str(tmp_path / "course"), "--copy-only"]) == 0
        assert capsys.readouterr().out == f"{tmp_path / 'course'}: {count}\n"


def contents(address):
    for _ in range(100):
        try:
            with urllib.request.urlopen(address, timeout=20) as reply:
                return json.load(reply)["content"]
        except urllib.error.URLError:  # announced, but not yet listening
            time.sleep(0.1)
    raise AssertionError(f"{address} does not answer")


def test_jupyterlab_serves_the_copies(tmp_path):
    code = """
import sys
from autonerf_lab.cli import main
from autonerf_lab.course import notebooks
notebooks.PACKAGES = {}  # this test is not about them, and open3d takes seconds
sys.exit(main(sys.argv[1:]))
"""
    command = [sys.executable, "-c", code, "course", "start", str(tmp_path / "course"), "--no-browser"]
    (tmp_path / "jupyter_server_config.py").write_text("c.ServerApp.allow_root = True")  # tests may run as root
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    environment = os.environ | {"JUPYTER_TOKEN": "token", "JUPYTER_PORT": port, "JUPYTER_CONFIG_DIR": str(tmp_path)}
    with subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, cwd=tmp_path, env=environment
    ) as server:
        try:
            assert any("is running at" in line for line in server.stderr)
            names = {entry["name"] for entry in contents(f"http://127.0.0.1:{port}/api/contents?token=token")}
        finally:
            server.terminate()
    assert "00_tour.ipynb" in names
