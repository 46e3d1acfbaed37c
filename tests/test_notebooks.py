"""Every notebook runs from top to bottom in a fresh kernel and an empty folder, and is committed without outputs."""

import os
import signal
import time
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError, CellTimeoutError, DeadKernelError

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.ipynb"))
CELL_TIMEOUT = 240  # seconds: a first run compiles kernels
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


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_runs_in_smoke(path, tmp_path, monkeypatch):
    monkeypatch.setenv("AUTONERF_LAB_PRESET", "smoke")
    monkeypatch.delenv("MPLBACKEND", raising=False)  # kernels draw into the notebook
    executed = execute(nbformat.read(path, as_version=4), tmp_path)
    outputs = [output for cell in executed.cells for output in cell.get("outputs", [])]
    assert any("image/png" in output.get("data", {}) for output in outputs), "figures remain without a kernel"
    pictures = [output["metadata"].get("image/png", {}) for output in outputs if "image/png" in output.get("data", {})]
    assert all(picture.get("alt", "").startswith("Figure") for picture in pictures), "every figure can be read aloud"
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
    assert time.monotonic() - started < 60


def test_an_endless_cell_fails_at_its_timeout(tmp_path):
    with pytest.raises(CellTimeoutError):
        execute(notebook_of("while True: pass"), tmp_path, timeout=1)


def test_kernels_have_no_network(tmp_path):
    with pytest.raises(CellExecutionError, match="NetworkBlockedError"):
        execute(notebook_of("import socket; socket.create_connection(('192.0.2.1', 80), 5)"), tmp_path)


def test_kernels_run_in_the_folder_they_are_given(tmp_path):
    executed = execute(notebook_of("import os; print(os.getcwd())"), tmp_path)
    assert os.path.samefile(executed.cells[0].outputs[0].text.strip(), tmp_path)
