"""Committed results in ``benchmarks/results`` and the script that exports them."""

import runpy
import shutil
import sys
from pathlib import Path

import pytest
from PIL import Image

from autonerf_lab.benchmark import load_results

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
GROUPS = [path.parent for path in sorted((BENCHMARKS / "results").glob("*/tables.md"))]
TABLES = ("tables.md", "tables.tex", "tables.html")


def runs_of(group: Path) -> list[Path]:
    """Return the results folders of a committed group, in the order of its tables."""
    return sorted(path.parent for path in group.glob("*/grid.json"))


def export(monkeypatch: pytest.MonkeyPatch, runs: list[Path], out: Path) -> None:
    monkeypatch.setattr(sys, "argv", ["export.py", *map(str, runs), str(out)])
    runpy.run_path(str(BENCHMARKS / "results/export.py"), run_name="__main__")


@pytest.mark.parametrize("group", GROUPS, ids=lambda group: group.name)
def test_committed_grids_are_complete_and_their_tables_match_their_cells(monkeypatch, group, tmp_path, capsys):
    runs = runs_of(group)
    cells = [cell for run in runs for cell in load_results(run).grid.cells()]
    outcomes = [outcome for run in runs for outcome in load_results(run).outcomes()]
    assert [outcome.status for outcome in outcomes] == ["ok"] * len(cells)
    export(monkeypatch, runs, tmp_path / "out")
    assert capsys.readouterr().out.startswith(f"{len(outcomes)} cells; ")
    for name in TABLES:
        assert (tmp_path / "out" / name).read_bytes() == (group / name).read_bytes(), f"{name}: export again"
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert written | {"trajectories.jpg"} == {path.name for path in group.iterdir()}, "figures of cells are not kept"


def test_an_unfinished_run_is_exported_with_its_figures_and_relative_paths(monkeypatch, tmp_path):
    """The tables count the missing cell; the weights of a policy are named relative to the working directory."""
    run = shutil.copytree(runs_of(GROUPS[0])[0], tmp_path / "run")
    monkeypatch.chdir(tmp_path)
    first, *others = load_results(run).outcomes()
    (run / "cells" / f"{first.cell.name}.json").unlink()
    (run / "figures").mkdir()
    for outcome in others:
        Image.new("RGB", (8, 8)).save(run / "figures" / f"{outcome.cell.name}_trajectory.webp")
        file = run / "cells" / f"{outcome.cell.name}.json"
        file.write_text(file.read_text().replace('"modular-cov"', f'"{tmp_path}/w/modular-cov.safetensors"'))
    grid = run / "grid.json"
    grid.write_text(grid.read_text().replace('"modular-cov",', f'"{tmp_path}/w/modular-cov.safetensors",', 1))
    export(monkeypatch, [run], tmp_path / "out")
    assert (tmp_path / "out/tables.md").read_text().startswith(f"{len(others)} of {len(others) + 1} cells")
    assert (tmp_path / "out/trajectories.jpg").exists()
    exported = load_results(tmp_path / "out/run")
    assert "w/modular-cov.safetensors" in exported.grid.policies
    assert len(exported.outcomes()) == len(others)
