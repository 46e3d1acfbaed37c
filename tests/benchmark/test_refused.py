"""Errors of a grid before it runs: invalid names and values, other results, changed contents behind a name."""

import copy
import json
from dataclasses import replace

import fake_cell
import pytest
from fake_grid import GRID, NAMES, log, run

from autonerf_lab.benchmark import Grid, load_results, run_grid
from autonerf_lab.benchmark.fingerprint import grid_fingerprint
from autonerf_lab.benchmark.grid import load_grid
from autonerf_lab.benchmark.results import open_results
from autonerf_lab.benchmark.results_table import load_results_table
from autonerf_lab.errors import AutoNerfError, DataError, MissingPackageError, RunFolderError, UnknownNameError
from autonerf_lab.evaluators import finetuning
from autonerf_lab.presets import PRESETS


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"policies": ("random", "frontire")}, "unknown policy 'frontire'; valid names: all, "),
        ({"scenes": ("val-9",)}, "unknown scene 'val-9'; valid names: all, dev, "),
        ({"scenes": ("nowhere.glb",)}, "nowhere.glb"),
        ({"models": ("gauss",)}, "unknown model 'gauss'; valid names: all, instant-ngp"),
        ({"preset": "fats"}, "unknown preset 'fats'"),
        ({"starts": 0}, "starts must be at least 1"),
        ({"scenes": ()}, "no cell"),
        ({"policies": "random"}, r"policies must be a tuple of names, such as \('random',\), not 'random'"),
        ({"scenes": ("val-0", 3)}, "scenes must be a tuple of names"),
        ({"optional": "navigation"}, "optional must be a tuple of names"),
        ({"optional": ("dancing",)}, "unknown optional task 'dancing'"),
        ({"starts": 2.5}, "starts must be a whole number, not 2.5"),
        ({"starts": True}, "starts must be a whole number, not True"),
        ({"preset": None}, "preset must be a name, such as 'fast', not None"),
        ({"scenes": ("NOWHERE.GLB",)}, "NOWHERE.GLB does not exist"),
    ],
)
def test_invalid_names_fail_before_files_are_written(tmp_path, change, words):
    with pytest.raises(AutoNerfError, match=words):
        run(tmp_path, grid=Grid(**{**GRID.__dict__, **change}))
    assert not (tmp_path / "out").exists() and not (tmp_path / "log").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"workers": -1}, "workers must be a whole number, 0 or more, not -1"),
        ({"workers": 1.5}, "workers must be a whole number"),
        ({"timeout": 0}, "timeout must be more than 0, not 0"),
        ({"timeout": float("nan")}, "timeout must be more than 0, not nan"),
        ({"memory_gb": -2.0}, "memory_gb must be more than 0, not -2.0"),
        ({"lpips": "nowhere.safetensors"}, "nowhere.safetensors does not exist"),
    ],
)
def test_invalid_values_fail_before_files_are_written(tmp_path, arguments, words):
    with pytest.raises(DataError, match=words):
        run(tmp_path, **arguments)
    assert not (tmp_path / "out").exists()


def test_output_path_that_is_a_file_is_refused(tmp_path):
    (tmp_path / "out").write_text("thesis")
    with pytest.raises(DataError, match=r"cannot create the folder .*out: File exists"):
        run(tmp_path)
    assert (tmp_path / "out").read_text() == "thesis"


def test_simultaneous_starts_of_different_grids_do_not_mix(tmp_path, monkeypatch):
    """The second run starts before the first has written grid.json and finds the folder locked."""
    from autonerf_lab.benchmark import run as run_module

    def second_start(*arguments):
        monkeypatch.setattr(run_module, "open_results", open_results)
        with pytest.raises(RunFolderError, match="another process"):
            run(tmp_path, grid=Grid(("random",), ("val-3",), 1, preset="smoke"))
        return open_results(*arguments)

    monkeypatch.setattr(run_module, "open_results", second_start)
    assert run(tmp_path).grid == GRID == load_results(tmp_path / "out").grid


def test_finetuning_needs_weights_and_packages(tmp_path, monkeypatch):
    grid = Grid(**{**GRID.__dict__, "optional": ("finetuning",)})
    monkeypatch.setattr(finetuning, "PRETRAINED", tmp_path / "pretrained.safetensors")
    with pytest.raises(DataError, match=r"pretrained\.safetensors does not exist: train one with `autonerf-lab"):
        run(tmp_path, grid=grid)
    for name in ("pretrained.safetensors", "pretrained.json"):
        (tmp_path / name).write_text("{}")
    monkeypatch.setattr("autonerf_lab.benchmark.grid.find_spec", lambda name: None)
    with pytest.raises(MissingPackageError, match=r"autonerf-lab\[training\]"):
        run(tmp_path, grid=grid)
    assert not (tmp_path / "out").exists()
    monkeypatch.undo()
    assert "PointGoal" not in grid_fingerprint(GRID)["weights"]


def test_settings_of_unused_tasks_are_not_in_the_fingerprint(monkeypatch):
    def sizes(optional):
        return grid_fingerprint(replace(GRID, optional=optional))["sizes"]

    plain, tuned = sizes(()), sizes(("finetuning",))
    other = replace(PRESETS[GRID.preset], finetuning_lr=1e-3)
    monkeypatch.setitem(PRESETS, GRID.preset, other)
    assert sizes(()) == plain and sizes(("finetuning",)) != tuned
    monkeypatch.setitem(PRESETS, GRID.preset, replace(other, test_poses=9))
    assert sizes(()) != plain


CONTENTS = [
    ("weights", "modular-obs"),
    ("scene_files", "val-0"),
    ("sizes", "smoke"),
    ("settings", "semantic-nerfacto"),
]


@pytest.mark.parametrize(("key", "name"), CONTENTS)
def test_content_behind_a_name_must_be_the_same(tmp_path, key, name):
    grid = Grid(("modular-obs",), ("val-0",), 1, preset="smoke")
    assert list(grid_fingerprint(grid)[key]) == [name]
    run(tmp_path, grid=grid)
    header = tmp_path / "out/grid.json"
    content = json.loads(header.read_text())
    now = content["grid"][key][name]
    content["grid"][key][name] = "0" * 64
    header.write_text(json.dumps(content))
    words = f"{key.replace('_', ' ')} of {name}: 00000000, not {now[:8]}"
    with pytest.raises(RunFolderError, match=rf"another grid \({words}\)"):
        run(tmp_path, grid=grid)
    assert load_results_table(load_results(tmp_path / "out")).cell_count == 1, "reading is allowed"
    other = run_grid(Grid(("modular-obs",), ("val-0",), 1, ("instant-ngp",), "smoke"), tmp_path / "other",
                     function=fake_cell.FUNCTION)  # fmt: skip
    if key == "settings":  # the other grid has another model
        load_results_table(load_results(tmp_path / "out"), other)
    else:
        with pytest.raises(RunFolderError, match=f"differ in {words}; compare"):
            load_results_table(load_results(tmp_path / "out"), other)


def test_fingerprint_of_a_scene_is_that_of_its_file(tmp_path):
    path = tmp_path / "flat.GLB"
    grid = Grid(("random",), (str(path),), 1, preset="smoke")
    path.write_bytes(b"one")
    before = grid_fingerprint(grid)
    path.write_bytes(b"two")
    assert list(before["scene_files"]) == ["flat"] and before != grid_fingerprint(grid)
    assert grid.checked().scenes == (str(path),)


def test_lpips_weights_are_part_of_the_fingerprint(tmp_path, monkeypatch):
    from autonerf_lab.benchmark import run as run_module

    monkeypatch.setattr(run_module, "_checked_weights", lambda file: file[-2:] * 32)
    assert run(tmp_path, lpips=tmp_path / "01").lpips == "01" * 32 == load_results(tmp_path / "out").lpips
    for weights, words in ((None, "none"), ("02", "02020202")):
        with pytest.raises(RunFolderError, match=f"weights of LPIPS: 01010101, not {words}"):
            run(tmp_path, lpips=weights)
    run(tmp_path, lpips=tmp_path / "elsewhere" / "01")


def test_cell_gets_the_lpips_weights(tmp_path, monkeypatch):
    from autonerf_lab import pipeline
    from autonerf_lab.benchmark import cell as cell_module

    def fail(*arguments, options):
        raise ValueError(f"called with {options.lpips}")

    monkeypatch.setattr(pipeline, "run_pipeline", fail)
    monkeypatch.setattr("autonerf_lab.evaluators.lpips.Lpips", lambda file, sha256: f"{sha256} of {file}")
    results = open_results(tmp_path / "out", GRID, "0123")
    one, other = (cell_module.run_cell(GRID.cells()[k], results.path, lpips=file) for k, file in enumerate(("w", None)))
    assert one == "failed: ValueError: called with 0123 of w" and other == "failed: ValueError: called with None"


def test_unknown_status_to_retry(tmp_path):
    with pytest.raises(UnknownNameError, match="valid names: died, failed, oom, timeout") as raised:
        run(tmp_path, retry=["slow"])
    assert str(copy.copy(raised.value)) == str(raised.value), "the error can be sent by a worker process"


def test_results_of_another_grid_or_version_are_refused(tmp_path):
    run(tmp_path)
    with pytest.raises(RunFolderError, match=r"another grid \(starts: 2, not 3\)"):
        run(tmp_path, grid=Grid(**{**GRID.__dict__, "starts": 3}))
    header = tmp_path / "out/grid.json"
    header.write_text(header.read_text().replace('"package": "', '"package": "9.'))
    with pytest.raises(RunFolderError, match=r"was made by autonerf-lab 9.*read but not continued"):
        run(tmp_path)
    assert len(load_results(tmp_path / "out").outcomes()) == len(NAMES), "reading is allowed"
    with pytest.raises(RunFolderError, match="was made by autonerf-lab 9"):
        load_results(tmp_path / "out", to_run=True)
    header.write_text(header.read_text().replace('"version": 1', '"version": 7'))
    with pytest.raises(RunFolderError, match="has format 7"):
        load_results(tmp_path / "out")
    header.write_text("{")
    with pytest.raises(DataError, match=r"grid\.json"):
        run(tmp_path)
    (tmp_path / "foreign").mkdir()
    (tmp_path / "foreign/thesis.txt").touch()
    with pytest.raises(RunFolderError, match="not a results folder"):
        run_grid(GRID, tmp_path / "foreign", function=fake_cell.FUNCTION)
    assert len(log(tmp_path)) == len(NAMES)


def test_grid_of_a_python_file(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text('from autonerf_lab.benchmark import Grid\nGRID = Grid(("random",), ("dev-0",), 1)\n')
    assert load_grid(str(path)) == Grid(("random",), ("dev-0",), 1)
    path.write_text("GRID = 3")
    with pytest.raises(DataError, match="must set GRID"):
        load_grid(str(path))
    path.write_text("raise SystemExit(3)")
    with pytest.raises(DataError, match="SystemExit: 3"):
        load_grid(str(path))
    path.write_text("import nowhere_to_be_found")
    with pytest.raises(DataError, match="nowhere_to_be_found"):
        load_grid(str(path))
    with pytest.raises(UnknownNameError, match=r"FILE\.py, paper"):
        load_grid("papers")
