"""Every notebook runs in a fresh kernel and an empty folder, and is committed without outputs."""

import os
import signal
import sys
import time
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError, CellTimeoutError, DeadKernelError

NOTEBOOKS = sorted((Path(__file__).parents[2] / "notebooks").glob("*.ipynb"))
CELL_TIMEOUT = 240  # seconds; the first run compiles kernels
MAX_MEMORY = 4.0  # GB per kernel
PEAK = "import resource; print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)"
FORBIDDEN_TAGS = {"skip-execution", "raises-exception"}


def execute(notebook: nbformat.NotebookNode, folder: Path, timeout: float = CELL_TIMEOUT) -> nbformat.NotebookNode:
    """Run a notebook; raise if a cell fails, exceeds the timeout or loses its kernel."""
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
        assert len(cell.source.splitlines()) <= 24, "a cell must fit on a screen"
        if cell.cell_type == "code":
            assert cell.outputs == [] and cell.execution_count is None
    code = [cell.source for cell in notebook.cells if cell.cell_type == "code"]
    assert "assert " in code[-1], "the last cell must check the results of the notebook"


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_runs_in_smoke(path, tmp_path, monkeypatch):
    monkeypatch.setenv("AUTONERF_LAB_PRESET", "smoke")
    monkeypatch.delenv("MPLBACKEND", raising=False)  # let kernels use the inline backend
    notebook = nbformat.read(path, as_version=4)
    if sys.platform == "linux":
        notebook.cells.append(nbformat.v4.new_code_cell(PEAK))
    executed = execute(notebook, tmp_path)
    if sys.platform == "linux":
        assert int(executed.cells.pop().outputs[0].text) * 1024 / 1e9 < MAX_MEMORY
    outputs = [output for cell in executed.cells for output in cell.get("outputs", [])]
    assert any("image/png" in output.get("data", {}) for output in outputs), "the notebook must contain static figures"
    for kind, word in (("image/png", "Figure"), ("image/gif", "Film")):
        metadata = [output["metadata"].get(kind, {}) for output in outputs if kind in output.get("data", {})]
        assert all(image.get("alt", "").startswith(word) for image in metadata), "every image needs a text alternative"
    stderr = "".join(o.text for o in outputs if o.output_type == "stream" and o.name == "stderr")
    assert "Warning" not in stderr, stderr


def test_failing_cell_raises(tmp_path):
    with pytest.raises(CellExecutionError, match="ZeroDivisionError"):
        execute(notebook_of("1 / 0"), tmp_path)


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs POSIX signals")
def test_killed_kernel_fails_within_seconds(tmp_path):
    started = time.monotonic()
    with pytest.raises(DeadKernelError):
        execute(notebook_of(f"import os; os.kill(os.getpid(), {int(signal.SIGKILL)})", "1"), tmp_path)
    assert time.monotonic() - started < 15


def test_endless_cell_fails_at_the_timeout(tmp_path):
    with pytest.raises(CellTimeoutError):
        execute(notebook_of("while True: pass"), tmp_path, timeout=1)


def test_kernels_have_no_network(tmp_path):
    with pytest.raises(CellExecutionError, match="NetworkBlockedError"):
        execute(notebook_of("import socket; socket.create_connection(('192.0.2.1', 80), 5)"), tmp_path)


def test_kernels_run_in_the_given_folder(tmp_path):
    executed = execute(notebook_of("import os; print(os.getcwd())"), tmp_path)
    assert os.path.samefile(executed.cells[0].outputs[0].text.strip(), tmp_path)
