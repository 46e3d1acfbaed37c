"""The results in ``benchmarks/results``, and the script that keeps them there."""

import runpy
import shutil
import sys
from pathlib import Path

import pytest
from PIL import Image

from autonerf_lab.benchmark import load_results

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
KEPT = BENCHMARKS / "results"
MADE = ("scores.csv", "tables.md", "tables.tex", "tables.html")


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """The grid as it was when its run had ended: with pictures."""
    folder = shutil.copytree(KEPT, tmp_path / "run")
    (folder / "pictures").mkdir()
    for cell in load_results(folder).grid.cells():
        Image.new("RGB", (8, 8)).save(folder / "pictures" / f"{cell.name}_walk.webp")
    return folder


def keep(monkeypatch: pytest.MonkeyPatch, run: Path, kept: Path) -> None:
    monkeypatch.setattr(sys, "argv", ["keep_results.py", str(run), str(kept)])
    runpy.run_path(str(BENCHMARKS / "keep_results.py"), run_name="__main__")


def test_the_grid_that_is_kept_is_whole_and_its_tables_are_those_of_its_cells(monkeypatch, run, tmp_path, capsys):
    cells = load_results(KEPT).grid.cells()
    assert [outcome.status for outcome in load_results(KEPT).outcomes()] == ["ok"] * len(cells)
    keep(monkeypatch, run, tmp_path / "kept")
    assert capsys.readouterr().out.startswith(f"{len(cells)} cells; ")
    for name in MADE:
        assert (tmp_path / "kept" / name).read_bytes() == (KEPT / name).read_bytes(), f"{name}: keep the grid again"
    assert sorted(p.name for p in (tmp_path / "kept").iterdir()) == sorted(
        p.name for p in KEPT.iterdir() if p.name != "README.md"
    )


def test_half_a_grid_is_not_kept(monkeypatch, run, tmp_path):
    next((run / "cells").iterdir()).unlink()
    with pytest.raises(SystemExit, match="69 of 70 cells are finished"):
        keep(monkeypatch, run, tmp_path / "kept")
    assert not (tmp_path / "kept").exists()
