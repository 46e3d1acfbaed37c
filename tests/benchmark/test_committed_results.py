"""Committed results in ``benchmarks/results`` and the script that exports them."""

import runpy
import shutil
import sys
from pathlib import Path

import pytest
from PIL import Image

from autonerf_lab.benchmark import load_results

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
COMMITTED = BENCHMARKS / "results"
TABLES = ("scores.csv", "tables.md", "tables.tex", "tables.html")


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """Copy of the committed results with figures, as after a run."""
    folder = shutil.copytree(COMMITTED, tmp_path / "run")
    (folder / "figures").mkdir()
    for cell in load_results(folder).grid.cells():
        Image.new("RGB", (8, 8)).save(folder / "figures" / f"{cell.name}_trajectory.webp")
    return folder


def export(monkeypatch: pytest.MonkeyPatch, run: Path, out: Path) -> None:
    monkeypatch.setattr(sys, "argv", ["export_results.py", str(run), str(out)])
    runpy.run_path(str(BENCHMARKS / "export_results.py"), run_name="__main__")


def test_committed_grid_is_complete_and_its_tables_match_its_cells(monkeypatch, run, tmp_path, capsys):
    cells = load_results(COMMITTED).grid.cells()
    assert [outcome.status for outcome in load_results(COMMITTED).outcomes()] == ["ok"] * len(cells)
    export(monkeypatch, run, tmp_path / "out")
    assert capsys.readouterr().out.startswith(f"{len(cells)} cells; ")
    for name in TABLES:
        assert (tmp_path / "out" / name).read_bytes() == (COMMITTED / name).read_bytes(), f"{name}: export again"
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == sorted(
        p.name for p in COMMITTED.iterdir() if p.name != "README.md"
    )


def test_unfinished_grid_is_not_exported(monkeypatch, run, tmp_path):
    next((run / "cells").iterdir()).unlink()
    with pytest.raises(SystemExit, match="69 of 70 cells are finished"):
        export(monkeypatch, run, tmp_path / "out")
    assert not (tmp_path / "out").exists()
