"""Run folder: configuration, progress, overwriting and locks."""

import errno
import hashlib
import json
import os
import shutil
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest

from autonerf_lab.errors import DataError, RunFolderError
from autonerf_lab.pipeline.run_folder import OUTPUTS, STAGES, RunConfig, load_run, locked, open_run

CONFIG = RunConfig("val-0", "f00d", "frontier", "smoke", 0, "semantic-nerfacto")


def finish(run, *stages):
    for stage in stages:
        run.mark_finished(stage, 1.0, 0.5)


def test_new_folder_stores_the_configuration_first(tmp_path):
    open_run(tmp_path / "a" / "b", CONFIG)
    assert load_run(tmp_path / "a" / "b").config == CONFIG


def test_run_json_without_overrides_is_readable(tmp_path):
    """Older files have no entries for steps, map and camera."""
    open_run(tmp_path, CONFIG)
    content = json.loads((tmp_path / "run.json").read_text())
    for key in ("steps", "map_size", "width", "height", "hfov_deg"):
        del content["config"][key]
    (tmp_path / "run.json").write_text(json.dumps(content))
    assert load_run(tmp_path).config == CONFIG


def test_unfinished_run_is_continued(tmp_path):
    finish(open_run(tmp_path, CONFIG), "scene", "explore")
    run = open_run(tmp_path, CONFIG)
    assert [stage for stage in STAGES if run.finished(stage)] == ["scene", "explore"]


def test_unfinished_run_is_continued_even_with_overwrite(tmp_path):
    finish(open_run(tmp_path, CONFIG), "scene")
    assert open_run(tmp_path, CONFIG, overwrite=True).finished("scene")


def test_finished_run_is_refused_and_kept(tmp_path):
    finish(open_run(tmp_path, CONFIG), *STAGES)
    before = (tmp_path / "run.json").read_bytes()
    with pytest.raises(RunFolderError, match=r"finished run \(.*report.html\); choose another --out.*--overwrite"):
        open_run(tmp_path, CONFIG)
    with pytest.raises(RunFolderError, match=r"finished run \(.*run.json\)"):
        open_run(tmp_path, CONFIG, last="fit")
    assert (tmp_path / "run.json").read_bytes() == before


def test_run_is_finished_only_with_every_stage(tmp_path):
    finish(open_run(tmp_path, CONFIG), "scene", "explore", "fit", "evaluate", "report")
    assert not open_run(tmp_path, CONFIG).finished("mesh")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"scene": "val-1", "scene_sha256": "beef"}, "scene is 'val-0', not 'val-1'"),
        ({"scene_sha256": "beef"}, "scene 'val-0' has changed since the run began"),
        ({"policy": "random"}, "policy is 'frontier', not 'random'"),
        ({"preset": "fast"}, "preset is 'smoke', not 'fast'"),
        ({"seed": 3}, "seed is 0, not 3"),
        ({"model": "other"}, "model is 'semantic-nerfacto', not 'other'"),
        ({"steps": 100}, "steps is unset, not 100"),
        ({"width": 64, "height": 48}, "width is unset, not 64; height is unset, not 48"),
    ],
)
def test_another_run_is_refused_with_the_difference(tmp_path, change, words):
    finish(open_run(tmp_path, CONFIG), "scene")
    with pytest.raises(RunFolderError, match="holds another run") as caught:
        open_run(tmp_path, replace(CONFIG, **change))
    assert words in str(caught.value)


def test_model_may_be_set_later(tmp_path):
    open_run(tmp_path, replace(CONFIG, model=None))
    assert open_run(tmp_path, CONFIG).config.model is None


def test_another_version_is_refused(tmp_path):
    open_run(tmp_path, CONFIG)
    content = json.loads((tmp_path / "run.json").read_text())
    (tmp_path / "run.json").write_text(json.dumps({**content, "package": "0.0.1"}))
    with pytest.raises(RunFolderError, match=r"made by autonerf-lab 0\.0\.1"):
        open_run(tmp_path, CONFIG)


@pytest.mark.parametrize(
    "content", ["", "{", "[]", "{}", '{"version": 1}', '{"version":1,"package":"x","config":{"a":1},"stages":{}}']
)
def test_damaged_run_json_is_one_clear_error(tmp_path, content):
    (tmp_path / "run.json").write_text(content)
    with pytest.raises(DataError, match=r"run\.json"):
        load_run(tmp_path)
    with pytest.raises(DataError, match=r"run\.json"):
        open_run(tmp_path, CONFIG)
    assert (tmp_path / "run.json").read_text() == content
    assert open_run(tmp_path, CONFIG, overwrite=True).config == CONFIG


def test_folder_with_other_files_is_refused_even_with_overwrite(tmp_path):
    (tmp_path / "thesis.tex").write_text("years")
    for overwrite in (False, True):
        with pytest.raises(RunFolderError, match="not a run folder"):
            open_run(tmp_path, CONFIG, overwrite=overwrite)
    assert [p.name for p in tmp_path.iterdir()] == ["thesis.tex"]


def test_run_killed_during_the_first_write_can_be_resumed(tmp_path):
    (tmp_path / ".run.json.x7h2").write_text('{"versi')
    assert open_run(tmp_path, CONFIG).config == CONFIG


def put(folder, *names):
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(name)


def left(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


def test_overwrite_removes_only_outputs_of_the_run(tmp_path):
    run = open_run(tmp_path, CONFIG)
    put(tmp_path, *(pattern.replace("*", "1") for patterns in OUTPUTS.values() for pattern in patterns))
    put(tmp_path, "figures/fit.json", "figures/fit_depth.png")
    finish(run, *STAGES)
    theirs = ["notes.txt", "trajectory/images/best.jpg", "mesh/edited.blend", "mesh/mine.glb", "figures/fit_notes.md"]
    put(tmp_path, *theirs, "photos/a/b.png", "nerf/.nerf.json.abcd_123")
    open_run(tmp_path, CONFIG, overwrite=True)
    assert left(tmp_path) == sorted([*theirs, "photos/a/b.png", "outputs.json", "run.json"])
    assert not (tmp_path / "nerf").exists() and not load_run(tmp_path).stages


def test_a_file_that_was_edited_is_not_overwritten(tmp_path):
    run = open_run(tmp_path, CONFIG)
    put(tmp_path, "mesh/color.glb", "scores.json")
    finish(run, *STAGES)
    (tmp_path / "mesh/color.glb").write_text("edited in Blender")
    before = left(tmp_path)
    for again in (lambda: open_run(tmp_path, CONFIG, overwrite=True), lambda: run.clear_stage("mesh", overwrite=True)):
        with pytest.raises(RunFolderError, match=r"changed after the run wrote it: mesh/color.glb; move it away"):
            again()
    assert left(tmp_path) == before and list(load_run(tmp_path).stages) == list(STAGES)


@pytest.mark.parametrize("link", ["mesh", "mesh/color.glb"])
def test_symbolic_links_are_not_followed(tmp_path, link):
    run, outside = open_run(tmp_path / "run", CONFIG), tmp_path / "outside"
    put(tmp_path / "run", "mesh/color.glb")
    finish(run, *STAGES)
    shutil.move(tmp_path / "run" / link, outside)
    (tmp_path / "run" / link).symlink_to(outside)
    open_run(tmp_path / "run", CONFIG, overwrite=True)
    assert (outside / "color.glb" if outside.is_dir() else outside).read_text() == "mesh/color.glb"


@pytest.mark.parametrize("name", ["{outside}", "../outside", "mesh/../../outside"])
def test_a_list_that_names_files_elsewhere_removes_none_of_them(tmp_path, name):
    run, outside = open_run(tmp_path / "run", CONFIG), tmp_path / "outside"
    finish(run, *STAGES)
    outside.write_text("precious")
    digest = hashlib.sha256(b"precious").hexdigest()
    listed = {"mesh": {name.format(outside=outside): digest}}
    (tmp_path / "run/outputs.json").write_text(json.dumps(listed))
    open_run(tmp_path / "run", CONFIG, overwrite=True)
    assert outside.read_text() == "precious"


def test_running_a_stage_again_removes_dependent_results(tmp_path):
    run = open_run(tmp_path, CONFIG)
    put(tmp_path, "nerf/a.json", "scores.json", "mesh/a.glb", "report.html")
    finish(run, *STAGES)
    with pytest.raises(RunFolderError, match="`evaluate` is finished; --overwrite"):
        run.clear_stage("evaluate", overwrite=False)
    run.clear_stage("evaluate", overwrite=True)
    assert list(load_run(tmp_path).stages) == ["scene", "explore", "fit", "mesh"]
    assert left(tmp_path) == ["mesh/a.glb", "nerf/a.json", "outputs.json", "run.json"]


def test_two_processes_do_not_share_a_folder(tmp_path):
    with locked(tmp_path), pytest.raises(RunFolderError, match="another process"), locked(tmp_path):
        pass
    with locked(tmp_path):  # the lock is free again
        pass


def test_lock_file_is_removed_and_that_of_a_killed_process_is_not_locked(tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run/.lock").touch()
    with locked(tmp_path / "run"):
        assert not open_run(tmp_path / "run", CONFIG).finished("scene"), "the lock file does not count"
        assert (tmp_path / "run/.lock").exists()
    assert [path.name for path in (tmp_path / "run").iterdir()] == ["run.json"]


def test_waiting_process_gets_the_lock_of_a_removed_folder(tmp_path):
    path, order = tmp_path / "work", []

    def second():
        with locked(path, wait=True):
            order.append("second")
            with pytest.raises(RunFolderError, match="another process"), locked(path):
                pass

    with ThreadPoolExecutor(1) as pool:
        with locked(path):
            waiting = pool.submit(second)
            time.sleep(0.3)
            shutil.rmtree(path)
            order.append("first")
        waiting.result(timeout=30)
    assert order == ["first", "second"]
    assert path.exists() and not list(path.iterdir())


def test_release_in_a_removed_folder_keeps_the_lock_of_the_next_process(tmp_path):
    path = tmp_path / "work"
    with locked(path):
        shutil.rmtree(path)
        after = locked(path)
        after.__enter__()
    with pytest.raises(RunFolderError, match="another process"), locked(path):
        pass
    after.__exit__(None, None, None)
    assert not list(path.iterdir())


def test_file_system_without_locks_is_an_error(tmp_path, monkeypatch):
    fcntl = pytest.importorskip("fcntl")

    def flock(handle, how):
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(fcntl, "flock", flock)
    with pytest.raises(DataError, match=r"cannot lock .*\.lock: No locks available"), locked(tmp_path):
        pass
    monkeypatch.undo()
    (tmp_path / ".lock").unlink()
    (tmp_path / ".lock").mkdir()
    with pytest.raises(DataError, match=r"cannot lock .*\.lock: Is a directory"), locked(tmp_path):
        pass


def test_folder_that_cannot_be_created(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="cannot create the folder"), locked(tmp_path / "file" / "run"):
        pass
