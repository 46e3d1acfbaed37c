"""Committed results in ``benchmarks/results`` and the script that exports them."""

import json
import runpy
import shutil
import sys
from pathlib import Path

import pytest
from PIL import Image

from autonerf_lab.benchmark import Outcome, load_results

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
GROUPS = [path.parent for path in sorted((BENCHMARKS / "results").glob("*/tables.md"))]
WHOLE = BENCHMARKS / "results/val-0.1"  # has one run, whose first policy is `random`
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
    assert len(outcomes) == len(cells), "every cell has been run"
    export(monkeypatch, runs, tmp_path / "out")
    assert capsys.readouterr().out.startswith(f"{len(outcomes)} cells; ")
    for name in TABLES:
        assert (tmp_path / "out" / name).read_bytes() == (group / name).read_bytes(), f"{name}: export again"
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert written == {path.name for path in group.iterdir()} - {"trajectories.jpg"}, "figures of cells are not kept"


def test_the_complete_scenes_of_all_runs_are_exported_with_relative_paths(monkeypatch, tmp_path):
    """A scene that one run has not completed is left out of all, a failed cell is not; weights have relative paths."""
    run, finished = (shutil.copytree(runs_of(WHOLE)[0], tmp_path / name) for name in ("run", "finished"))
    monkeypatch.chdir(tmp_path)
    policies = load_results(run).grid.policies
    assert policies[0] == "random"
    moved = f"{tmp_path}/w/random.safetensors"
    for folder, chosen in ((run, (moved, *policies[1:4])), (finished, policies[4:])):
        content = json.loads((folder / "grid.json").read_text())
        content["grid"]["policies"] = chosen
        (folder / "grid.json").write_text(json.dumps(content))
        for file in (folder / "cells").glob("*_random_*.json"):
            file.write_text(file.read_text().replace('"policy": "random"', f'"policy": "{moved}"', 1))
    first, *others = load_results(run).outcomes()
    (run / "cells" / f"{first.cell.name}.json").unlink()
    failed = load_results(finished).outcomes()[-1].cell
    load_results(finished).write(Outcome(failed, "failed: odd"))
    (run / "figures").mkdir()
    for outcome in others:
        Image.new("RGB", (8, 8)).save(run / "figures" / f"{outcome.cell.name}_trajectory.webp")
    export(monkeypatch, [run, finished], tmp_path / "out")
    assert (tmp_path / "out/trajectories.jpg").exists()
    exported = [load_results(tmp_path / "out" / name) for name in ("run", "finished")]
    assert "w/random.safetensors" in exported[0].grid.policies
    for results in exported:
        assert {outcome.cell.scene for outcome in results.outcomes()} == {*results.grid.scenes}
        assert {*load_results(run).grid.scenes} - {*results.grid.scenes} == {first.cell.scene}
        assert len(results.outcomes()) == len(results.grid.cells())
    assert [outcome.cell for outcome in exported[1].outcomes() if not outcome.finished] == [failed]


def test_scene_files_in_the_working_directory_are_exported_with_relative_paths(monkeypatch, tmp_path):
    run = shutil.copytree(runs_of(WHOLE)[0], tmp_path / "run")
    monkeypatch.chdir(tmp_path)
    moved = f"{tmp_path}/val-0.json"
    for file in (run / "grid.json", *(run / "cells").glob("val-0_*.json")):
        file.write_text(file.read_text().replace('"val-0"', f'"{moved}"'))
    content = json.loads((run / "grid.json").read_text())
    content["grid"]["scene_files"]["val-0"] = content["grid"]["scene_files"].pop(moved)
    (run / "grid.json").write_text(json.dumps(content))
    export(monkeypatch, [run], tmp_path / "out")
    results = load_results(tmp_path / "out/run")
    assert "val-0.json" in results.grid.scenes and len(results.outcomes()) == len(results.grid.cells())


def test_parts_of_a_grid_become_one_results_folder(monkeypatch, tmp_path):
    """The first two scenes are an earlier export, the others a run of the same name; other weights are refused."""
    whole = runs_of(WHOLE)[0]
    names = load_results(whole).grid.scenes
    parts = [shutil.copytree(whole, tmp_path / part / whole.name) for part in ("a", "b")]
    for part, scenes in zip(parts, (names[:2], names[1:]), strict=True):
        content = json.loads((part / "grid.json").read_text())
        content["grid"] |= {"scenes": scenes, "scene_files": {n: content["grid"]["scene_files"][n] for n in scenes}}
        (part / "grid.json").write_text(json.dumps(content))
    export(monkeypatch, parts[:1], tmp_path / "out")
    export(monkeypatch, [tmp_path / "out" / whole.name, parts[1]], tmp_path / "out")
    for name in TABLES:
        assert (tmp_path / "out" / name).read_bytes() == (WHOLE / name).read_bytes()
    content["grid"]["weights"]["modular-obs"] = "0" * 64
    (parts[1] / "grid.json").write_text(json.dumps(content))
    with pytest.raises(SystemExit, match=r"a/policies and .*b/policies differ in more than their scenes"):
        export(monkeypatch, parts, tmp_path / "other")
    shutil.rmtree(parts[0] / "cells")
    with pytest.raises(SystemExit, match="no scene is complete in all runs"):
        export(monkeypatch, parts[:1], tmp_path / "other")
