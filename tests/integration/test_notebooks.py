"""Every notebook runs from top to bottom in a fresh kernel and an empty folder, and is committed without outputs."""

import os
import re
import signal
import sys
import time
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError, CellTimeoutError, DeadKernelError

NOTEBOOKS = sorted((Path(__file__).parents[2] / "notebooks").glob("*.ipynb"))
CELL_TIMEOUT = 240  # seconds: a first run compiles kernels
MOST_MEMORY = 4.0  # GB, of a kernel
PEAK = "import resource; print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)"
FORBIDDEN_TAGS = {"skip-execution", "raises-exception"}


def execute(notebook: nbformat.NotebookNode, folder: Path, timeout: float = CELL_TIMEOUT) -> nbformat.NotebookNode:
    """Run a notebook; a cell that fails, takes too long or loses its kernel raises."""
    resources = {"metadata": {"path": str(folder)}}
    return NotebookClient(notebook, timeout=timeout, kernel_name="python3", resources=resources).execute()


def notebook_of(*cells: str) -> nbformat.NotebookNode:
    return nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in cells])


def test_there_are_notebooks():
    assert NOTEBOOKS


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_committed_stripped(path):
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    ids = [cell.get("id") for cell in notebook.cells]
    assert all(ids) and len(set(ids)) == len(ids)
    for cell in notebook.cells:
        assert not FORBIDDEN_TAGS & set(cell.metadata.get("tags", []))
        assert len(cell.source.splitlines()) <= 24, "a cell fits on a screen"
        if cell.cell_type == "code":
            assert cell.outputs == [] and cell.execution_count is None
    code = [cell.source for cell in notebook.cells if cell.cell_type == "code"]
    assert "assert " in code[-1], "the last cell checks what the notebook claimed"


def test_every_notebook_says_where_else_it_runs_and_installs_itself_there():
    setups = set()
    for path in NOTEBOOKS:
        title, setup, *_ = nbformat.read(path, as_version=4).cells
        for service in ("[Colab](https://colab.research.google.com/", "[Binder](https://mybinder.org/"):
            (address,) = re.findall(re.escape(service) + r"[^)]+", title.source)
            assert address.endswith(f"notebooks/{path.name}")
        assert setup.id == "setup-colab"
        setups.add(setup.source)
    (source,) = setups
    assert "autonerf-lab[training,viewer] @ git+https" in source and "anywidget" in source


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_runs_in_smoke(path, tmp_path, monkeypatch):
    monkeypatch.setenv("AUTONERF_LAB_PRESET", "smoke")
    monkeypatch.delenv("MPLBACKEND", raising=False)  # kernels draw into the notebook
    notebook = nbformat.read(path, as_version=4)
    if sys.platform == "linux":
        notebook.cells.append(nbformat.v4.new_code_cell(PEAK))
    executed = execute(notebook, tmp_path)
    if sys.platform == "linux":
        assert int(executed.cells.pop().outputs[0].text) * 1024 / 1e9 < MOST_MEMORY
    outputs = [output for cell in executed.cells for output in cell.get("outputs", [])]
    assert any("image/png" in output.get("data", {}) for output in outputs), "figures remain without a kernel"
    for kind, word in (("image/png", "Figure"), ("image/gif", "Film")):
        pictures = [output["metadata"].get(kind, {}) for output in outputs if kind in output.get("data", {})]
        assert all(picture.get("alt", "").startswith(word) for picture in pictures), "every figure can be read aloud"
    stderr = "".join(o.text for o in outputs if o.output_type == "stream" and o.name == "stderr")
    assert "Warning" not in stderr, stderr


def test_a_failing_cell_fails(tmp_path):
    with pytest.raises(CellExecutionError, match="ZeroDivisionError"):
        execute(notebook_of("1 / 0"), tmp_path)


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs POSIX signals")
def test_a_killed_kernel_fails_within_seconds(tmp_path):
    started = time.monotonic()
    with pytest.raises(DeadKernelError):
        execute(notebook_of(f"import os; os.kill(os.getpid(), {int(signal.SIGKILL)})", "1"), tmp_path)
    assert time.monotonic() - started < 15


def test_an_endless_cell_fails_at_its_timeout(tmp_path):
    with pytest.raises(CellTimeoutError):
        execute(notebook_of("while True: pass"), tmp_path, timeout=1)


def test_kernels_have_no_network(tmp_path):
    with pytest.raises(CellExecutionError, match="NetworkBlockedError"):
        execute(notebook_of("import socket; socket.create_connection(('192.0.2.1', 80), 5)"), tmp_path)


def test_kernels_run_in_the_folder_they_are_given(tmp_path):
    executed = execute(notebook_of("import os; print(os.getcwd())"), tmp_path)
    assert os.path.samefile(executed.cells[0].outputs[0].text.strip(), tmp_path)
