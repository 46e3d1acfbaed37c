"""The stages go on where they stopped, whatever stopped them, and check what they are given."""

import json
import signal
import subprocess
import sys
from types import SimpleNamespace

import pytest

from autonerf_lab import pipeline
from autonerf_lab.errors import DataError, RunFolderError, TrainingError, UnknownNameError
from autonerf_lab.pipeline.run_folder import STAGES, load_run


@pytest.fixture
def fake(monkeypatch):
    """Stages that write one file each and may be told to fail; the log of those that ran."""
    log: list[str] = []
    broken: dict[str, BaseException] = {}

    def stage(name):
        def run(work):
            log.append(name)
            if name in broken:
                raise broken.pop(name)
            folder = work.run.path / "figures"
            folder.mkdir(exist_ok=True)
            (folder / f"{name}_x.png").write_text(name)

        return run

    monkeypatch.setattr(pipeline, "find_scene", lambda name: SimpleNamespace(name=name, sha256=f"sha of {name}"))
    monkeypatch.setattr(pipeline, "INPUTS", dict.fromkeys(STAGES, ()))
    monkeypatch.setattr(pipeline, "STAGE_FUNCTIONS", {name: stage(name) for name in STAGES})
    return SimpleNamespace(log=log, broken=broken)


def begin(out, **changes):
    pipeline.begin(out, **{"scene": "val-0", "policy": "frontier", "preset_name": "smoke"} | changes)


def test_all_stages_in_order(fake, tmp_path):
    begin(tmp_path, model="semantic-nerfacto")
    assert fake.log == list(STAGES)
    run = load_run(tmp_path)
    assert list(run.stages) == list(STAGES)
    assert all(row["seconds"] >= 0 and row["peak_gb"] > 0 for row in run.stages.values())


@pytest.mark.parametrize("stop", [KeyboardInterrupt(), TrainingError("NaN"), MemoryError()])
@pytest.mark.parametrize("stage", STAGES)
def test_the_same_command_goes_on_after_any_stage_failed(fake, tmp_path, stage, stop):
    fake.broken[stage] = stop
    with pytest.raises(type(stop)):
        begin(tmp_path, model="semantic-nerfacto")
    begin(tmp_path, model="semantic-nerfacto")
    once = [name for name in STAGES if name != stage]
    assert sorted(fake.log) == sorted([*once, stage, stage])


def test_finished_run_is_not_touched(fake, tmp_path):
    begin(tmp_path, model="semantic-nerfacto")
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    with pytest.raises(RunFolderError, match="finished run"):
        begin(tmp_path, model="semantic-nerfacto")
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before
    begin(tmp_path, model="semantic-nerfacto", overwrite=True)
    assert fake.log == [*STAGES, *STAGES]


def test_stages_one_by_one_make_the_same_run(fake, tmp_path):
    begin(tmp_path, last="explore")
    assert load_run(tmp_path).config.model is None
    pipeline.resume(tmp_path, "fit", model="semantic-nerfacto")
    for stage in ("evaluate", "mesh", "report", "report"):
        pipeline.resume(tmp_path, stage)
    assert fake.log == [*STAGES, "report"]
    with pytest.raises(RunFolderError, match="finished run"):
        begin(tmp_path, model="semantic-nerfacto")


@pytest.mark.parametrize(
    ("stage", "first"), [("fit", "explore"), ("evaluate", "fit"), ("mesh", "fit"), ("report", "evaluate")]
)
def test_stage_that_comes_too_early_names_the_one_before(fake, tmp_path, stage, first):
    begin(tmp_path, last="scene")
    with pytest.raises(RunFolderError, match=f"`autonerf-lab {first}` comes first"):
        pipeline.resume(tmp_path, stage)


def test_stage_again_needs_overwrite(fake, tmp_path):
    begin(tmp_path, model="semantic-nerfacto")
    with pytest.raises(RunFolderError, match="`fit` is finished; --overwrite"):
        pipeline.resume(tmp_path, "fit", model="semantic-nerfacto")
    pipeline.resume(tmp_path, "fit", model="semantic-nerfacto", overwrite=True)
    assert list(load_run(tmp_path).stages) == ["scene", "explore", "fit"]


def test_report_that_fails_leaves_the_old_one(fake, tmp_path):
    begin(tmp_path, model="semantic-nerfacto")
    fake.broken["report"] = DataError("no space left")
    with pytest.raises(DataError):
        pipeline.resume(tmp_path, "report")
    assert (tmp_path / "figures/report_x.png").exists()


@pytest.mark.parametrize(
    ("change", "valid"),
    [
        ({"policy": "frontire"}, "frontier, "),
        ({"model": "nerf"}, "semantic-nerfacto"),
        ({"preset_name": "fats"}, "fast, paper, smoke"),
    ],
)
def test_unknown_names_fail_before_anything_is_made(tmp_path, change, valid):
    with pytest.raises(UnknownNameError, match=valid):
        begin(tmp_path / "run", **change)
    assert not (tmp_path / "run").exists()


def test_unknown_scene_lists_the_library(tmp_path):
    with pytest.raises(UnknownNameError, match="val-0"):
        begin(tmp_path / "run", scene="val-99")
    assert not (tmp_path / "run").exists()


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs POSIX signals")
@pytest.mark.parametrize("stage", ["scene", "fit", "report"])
def test_killed_process_is_resumed(tmp_path, stage):
    """A real kill, with a half-written file left behind."""
    code = f"""
import os, signal
from types import SimpleNamespace
from autonerf_lab import pipeline
from autonerf_lab.pipeline.run_folder import STAGES
def work(name):
    def run(work):
        marker = work.run.path / "killed"
        (work.run.path / "log").open("a").write(name + "\\n")
        if name == {stage!r} and not marker.exists():
            marker.touch()
            (work.run.path / ".run.json.half").write_text("{{")
            os.kill(os.getpid(), signal.SIGKILL)
    return run
pipeline.find_scene = lambda name: SimpleNamespace(sha256=name)
pipeline.STAGE_FUNCTIONS = {{name: work(name) for name in STAGES}}
pipeline.check_names = lambda *a, **k: None
pipeline.begin({str(tmp_path / "run")!r}, "val-0", "frontier", "smoke")
"""
    killed, resumed = (
        subprocess.run([sys.executable, "-c", code], capture_output=True, check=False).returncode for _ in range(2)
    )
    assert (killed, resumed) == (-signal.SIGKILL, 0)
    assert sorted((tmp_path / "run/log").read_text().split()) == sorted([*STAGES, stage])
    assert list(json.loads((tmp_path / "run/run.json").read_text())["stages"]) == list(STAGES)
