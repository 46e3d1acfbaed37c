"""Stages: an interrupted run continues after its last finished stage; arguments and order are checked."""

import json
import signal
import subprocess
import sys
from types import SimpleNamespace

import pytest
import toy_scene

from autonerf_lab import cli, pipeline
from autonerf_lab.data.trajectory import load_trajectory
from autonerf_lab.errors import DataError, RunFolderError, TrainingError, UnknownNameError
from autonerf_lab.pipeline import run as run_module
from autonerf_lab.pipeline.run_folder import STAGES, load_run


@pytest.fixture
def fake(monkeypatch):
    """Fake stages that write one file each and can be made to fail, and the log of the stages that ran."""
    log: list[str] = []
    broken: dict[str, BaseException] = {}

    def stage(name):
        def run(context):
            log.append(name)
            if name in broken:
                raise broken.pop(name)
            folder = context.run.path / "figures"
            folder.mkdir(exist_ok=True)
            (folder / f"{name}_x.png").write_text(name)

        return run

    monkeypatch.setattr(run_module, "find_scene", lambda name: SimpleNamespace(name=name, sha256=f"sha of {name}"))
    monkeypatch.setattr(run_module, "INPUTS", dict.fromkeys(STAGES, ()))
    monkeypatch.setattr(run_module, "STAGE_FUNCTIONS", {name: stage(name) for name in STAGES})
    return SimpleNamespace(log=log, broken=broken)


def run_pipeline(out, **changes):
    pipeline.run_pipeline(out, **{"scene": "val-0", "policy": "frontier", "preset_name": "smoke"} | changes)


def test_all_stages_in_order(fake, tmp_path):
    run_pipeline(tmp_path, model="semantic-nerfacto")
    assert fake.log == list(STAGES)
    run = load_run(tmp_path)
    assert list(run.stages) == list(STAGES)
    assert all(row["seconds"] >= 0 and row["peak_gb"] > 0 for row in run.stages.values())


@pytest.mark.parametrize("stop", [KeyboardInterrupt(), TrainingError("NaN"), MemoryError()])
@pytest.mark.parametrize("stage", STAGES)
def test_same_command_continues_after_any_failed_stage(fake, tmp_path, stage, stop):
    fake.broken[stage] = stop
    with pytest.raises(type(stop)):
        run_pipeline(tmp_path, model="semantic-nerfacto")
    run_pipeline(tmp_path, model="semantic-nerfacto")
    once = [name for name in STAGES if name != stage]
    assert sorted(fake.log) == sorted([*once, stage, stage])


def test_finished_run_is_not_changed(fake, tmp_path):
    run_pipeline(tmp_path, model="semantic-nerfacto")
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    with pytest.raises(RunFolderError, match="finished run"):
        run_pipeline(tmp_path, model="semantic-nerfacto")
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before
    run_pipeline(tmp_path, model="semantic-nerfacto", overwrite=True)
    assert fake.log == [*STAGES, *STAGES]


def test_single_stages_give_the_same_run(fake, tmp_path):
    run_pipeline(tmp_path, last="explore")
    assert load_run(tmp_path).config.model is None
    pipeline.run_stage(tmp_path, "fit", model="semantic-nerfacto")
    for stage in ("evaluate", "mesh", "report", "report"):
        pipeline.run_stage(tmp_path, stage)
    assert fake.log == [*STAGES, "report"]
    with pytest.raises(RunFolderError, match="finished run"):
        run_pipeline(tmp_path, model="semantic-nerfacto")


@pytest.mark.parametrize(
    ("stage", "first"), [("fit", "explore"), ("evaluate", "fit"), ("mesh", "fit"), ("report", "evaluate")]
)
def test_error_of_a_stage_that_runs_too_early_names_the_previous_one(fake, tmp_path, stage, first):
    run_pipeline(tmp_path, last="scene")
    with pytest.raises(RunFolderError, match=f"run `autonerf-lab {first}` first"):
        pipeline.run_stage(tmp_path, stage)


def test_second_run_of_a_stage_needs_overwrite(fake, tmp_path):
    run_pipeline(tmp_path, model="semantic-nerfacto")
    with pytest.raises(RunFolderError, match="`fit` is finished; --overwrite"):
        pipeline.run_stage(tmp_path, "fit", model="semantic-nerfacto")
    pipeline.run_stage(tmp_path, "fit", model="semantic-nerfacto", overwrite=True)
    assert list(load_run(tmp_path).stages) == ["scene", "explore", "fit"]


def test_failed_report_keeps_the_previous_report(fake, tmp_path):
    run_pipeline(tmp_path, model="semantic-nerfacto")
    fake.broken["report"] = DataError("no space left")
    with pytest.raises(DataError):
        pipeline.run_stage(tmp_path, "report")
    assert (tmp_path / "figures/report_x.png").exists()


@pytest.mark.parametrize(
    ("change", "valid"),
    [
        ({"policy": "frontire"}, "frontier, "),
        ({"model": "nerf"}, "semantic-nerfacto"),
        ({"preset_name": "fats"}, "fast, paper, smoke"),
    ],
)
def test_unknown_names_fail_before_files_are_written(tmp_path, change, valid):
    with pytest.raises(UnknownNameError, match=valid):
        run_pipeline(tmp_path / "run", **change)
    assert not (tmp_path / "run").exists()


def test_overrides_change_the_preset_and_are_checked_on_resume(fake, tmp_path):
    run_pipeline(tmp_path, last="explore", steps=7, width=64, height=32, hfov_deg=60.0, map_size=800)
    context = pipeline.StageContext(load_run(tmp_path))
    size = context.preset
    assert (size.episode_steps, size.width, size.height, size.hfov_deg) == (7, 64, 32, 60.0)
    assert size.label == "smoke, width=64, height=32, episode_steps=7, hfov_deg=60.0"
    with pytest.raises(RunFolderError, match=r"another run .*steps is 7, not 8"):
        run_pipeline(tmp_path, steps=8, width=64, height=32, hfov_deg=60.0, map_size=800)
    with pytest.raises(RunFolderError, match="map_size is 800, not unset"):
        run_pipeline(tmp_path, steps=7, width=64, height=32, hfov_deg=60.0)


def test_unknown_scene_lists_the_library(tmp_path):
    with pytest.raises(UnknownNameError, match="val-0"):
        run_pipeline(tmp_path / "run", scene="val-99")
    assert not (tmp_path / "run").exists()


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs POSIX signals")
@pytest.mark.parametrize("stage", ["scene", "fit", "report"])
def test_killed_process_is_resumed(tmp_path, stage):
    """The process is killed with SIGKILL and leaves a half-written file."""
    code = f"""
import os, signal
from types import SimpleNamespace
from autonerf_lab import cli, pipeline
from autonerf_lab.pipeline import run as run_module
from autonerf_lab.pipeline.run_folder import STAGES
def stage_function(name):
    def run(context):
        marker = context.run.path / "killed"
        (context.run.path / "log").open("a").write(name + "\\n")
        if name == {stage!r} and not marker.exists():
            marker.touch()
            (context.run.path / ".run.json.half").write_text("{{")
            os.kill(os.getpid(), signal.SIGKILL)
    return run
run_module.find_scene = lambda name: SimpleNamespace(sha256=name)
run_module.STAGE_FUNCTIONS = {{name: stage_function(name) for name in STAGES}}
run_module.check_arguments = lambda *a, **k: None
pipeline.run_pipeline({str(tmp_path / "run")!r}, "val-0", "frontier", "smoke")
"""
    killed, resumed = (
        subprocess.run([sys.executable, "-c", code], capture_output=True, check=False).returncode for _ in range(2)
    )
    assert (killed, resumed) == (-signal.SIGKILL, 0)
    assert sorted((tmp_path / "run/log").read_text().split()) == sorted([*STAGES, stage])
    assert list(json.loads((tmp_path / "run/run.json").read_text())["stages"]) == list(STAGES)


def test_pose_sources_of_exploration_and_training(tmp_path, monkeypatch):
    used = []
    toy = toy_scene.to_scene(toy_scene.two_rooms())
    monkeypatch.setattr(run_module, "find_scene", lambda name: toy)
    monkeypatch.setitem(run_module.STAGE_FUNCTIONS, "scene", lambda context: None)
    monkeypatch.setitem(run_module.STAGE_FUNCTIONS, "fit", lambda context: used.append(context.trajectory))
    noise = {"noise": "ans", "depth_noise": "redwood", "poses": "estimated", "steps": 3}
    options = pipeline.StageOptions(figures=("drift", "pose_maps"))
    run_pipeline(tmp_path, policy="random", last="explore", options=options, **noise)
    assert load_run(tmp_path).config.poses == "estimated"
    drawn = {path.name for path in (tmp_path / "figures").glob("*.png")}
    assert drawn == {"explore_drift.png", "explore_pose_maps.png"}
    with pytest.raises(DataError, match="there are no 'refined' poses, only true, odometry, estimated"):
        pipeline.run_stage(tmp_path, "fit", "instant-ngp", poses="refined")
    assert not used and load_run(tmp_path).config.model is None
    pipeline.run_stage(tmp_path, "fit", "instant-ngp")
    pipeline.run_stage(tmp_path, "fit", "instant-ngp", overwrite=True, poses="odometry")
    assert [trajectory.pose_source for trajectory in used] == ["estimated", "odometry"]
    assert load_run(tmp_path).config.fit_poses == "odometry"
    pipeline.run_stage(tmp_path, "fit", "instant-ngp", overwrite=True)
    assert used[-1].pose_source == "estimated" and load_run(tmp_path).config.fit_poses is None, "a fit started anew"
    with pytest.raises(RunFolderError, match="poses is 'estimated', not 'true'"):
        run_pipeline(tmp_path, policy="random", last="explore", **(noise | {"poses": "true"}))
    with pytest.raises(UnknownNameError, match="pose source 'gps'"):
        run_pipeline(tmp_path, poses="gps")
    refined = noise | {"poses": "refined"}
    run_pipeline(tmp_path / "b", policy="random", last="explore", options=pipeline.StageOptions(figures=()), **refined)
    pipeline.run_stage(tmp_path / "b", "fit", "instant-ngp")
    assert used[-1].pose_source == "refined"
    assert list(used[-1].pose_sources) == ["true", "odometry", "estimated", "refined"]


def test_an_episode_that_could_not_be_loaded_is_refused_before_it_is_simulated(tmp_path, monkeypatch):
    toy = toy_scene.to_scene(toy_scene.two_rooms())
    monkeypatch.setattr(run_module, "find_scene", lambda name: toy)
    monkeypatch.setitem(run_module.STAGE_FUNCTIONS, "scene", lambda context: None)
    monkeypatch.setattr("autonerf_lab.exploration.explore", lambda *args, **options: pytest.fail("explored"))
    with pytest.raises(DataError, match="the images of the episode need 4147200000 bytes, at most 2147483648"):
        run_pipeline(tmp_path, policy="random", last="explore", steps=1500, width=640, height=480)


def test_overwrite_in_the_working_directory_leaves_the_files_around_the_run_alone(tmp_path, monkeypatch):
    """A dotfile beside the run folder has a name like that of an interrupted write."""
    run = tmp_path / "run"
    toy = toy_scene.to_scene(toy_scene.two_rooms())
    monkeypatch.setattr(run_module, "find_scene", lambda name: toy)
    for stage in ("scene", "explore", "fit"):
        monkeypatch.setitem(run_module.STAGE_FUNCTIONS, stage, lambda context: None)
    monkeypatch.setitem(
        run_module.STAGE_FUNCTIONS, "evaluate", lambda context: (context.run / "scores.json").write_text("[]")
    )
    monkeypatch.setattr(run_module, "INPUTS", dict.fromkeys(run_module.INPUTS, ()))
    run_pipeline(run, policy="random", last="evaluate")
    backup = tmp_path / ".bashrc.bak.20240131"
    backup.touch()
    pipeline.run_stage(run, "evaluate", overwrite=True)
    assert backup.exists()
    monkeypatch.chdir(run)
    pipeline.run_stage(".", "evaluate", overwrite=True)
    assert backup.exists() and (run / "scores.json").exists()


def test_a_refused_refinement_keeps_the_exploration(tmp_path, monkeypatch):
    def refuse(trajectory):
        raise DataError("0 of 3 views overlap")

    toy = toy_scene.to_scene(toy_scene.two_rooms())
    monkeypatch.setattr(run_module, "find_scene", lambda name: toy)
    monkeypatch.setitem(run_module.STAGE_FUNCTIONS, "scene", lambda context: None)
    monkeypatch.setattr("autonerf_lab.bundle_adjustment.refine_poses", refuse)
    conditions = {"noise": "ans", "depth_noise": "redwood", "poses": "refined", "steps": 3}
    with pytest.raises(DataError, match=r"0 of 3 views overlap. The exploration is saved .*autonerf-lab adopt"):
        run_pipeline(tmp_path, policy="random", last="explore", **conditions)
    saved = load_trajectory(tmp_path / "trajectory")
    assert (len(saved), saved.pose_source) == (3, "estimated") and "true" in saved.pose_sources
    monkeypatch.undo()
    assert not load_run(tmp_path).finished("explore")


def test_poses_of_fit_belong_to_a_run_or_to_photographs(tmp_path, capsys):
    assert cli.main(["fit", str(tmp_path), "--poses", "colmap"]) == 1
    assert "--poses colmap need photographs" in capsys.readouterr().err
    assert cli.main(["fit", str(tmp_path), "--poses", "true", "--out", str(tmp_path / "out")]) == 1
    assert "photographs have no true poses" in capsys.readouterr().err
