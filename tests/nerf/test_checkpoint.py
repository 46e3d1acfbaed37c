"""Checkpoints of a training: content, rhythm, snapshots, and files that do not fit. A model of two arrays is enough."""

import json
from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from autonerf_lab.errors import DataError, RunFolderError
from autonerf_lab.nerf import checkpoint
from autonerf_lab.nerf.checkpoint import (
    FIELD_FILE,
    TRAINING_FILE,
    Progress,
    TrainingState,
    load_parts,
    save_parts,
    settings_to_json,
)
from autonerf_lab.nerf.models.semantic_nerfacto import SETTINGS
from autonerf_lab.nerf.optimizer import Adam
from autonerf_lab.utils.storage import read_arrays, write_arrays


def training(value: float = 1.0, seed: int = 0) -> TrainingState:
    """Return a training state in which all numbers differ from their defaults."""
    parameters = {"w": np.full(3, value, np.float32)}
    model = SimpleNamespace(
        parameters=parameters,
        state={"grid": np.full(2, value, np.float32)},
        settings=replace(SETTINGS["smoke"], averaged=0.2),
    )
    state = TrainingState(model, Adam(parameters), np.random.default_rng(seed))
    state.optimizer.first["w"][:], state.optimizer.second["w"][:] = value + 1, value + 2
    return state


def saved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> TrainingState:
    state = training(5.0, seed=9)
    state.resume(tmp_path, {"seed": 3})  # nothing to resume yet
    state.step, state.psnr, state.seconds, state.losses = 12, 20.5, 3.25, {"mse": 0.5}
    state.skipped, state.rate_scale = 2, 0.25
    state.optimizer.steps["w"] = 11
    state.average.add()
    state.rng.random(7)
    monkeypatch.setattr(checkpoint, "SAVE_EVERY", 0.0)
    state.save_periodically(tmp_path)
    return state


def test_a_resumed_training_has_the_state_of_the_saved_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before, after = saved(tmp_path, monkeypatch), training()
    after.resume(tmp_path, {"seed": 3})
    for entry in fields(Progress):
        assert getattr(after, entry.name) == getattr(before, entry.name) != getattr(Progress(), entry.name), entry.name
    assert after.optimizer.steps == {"w": 11} and after.rng.random() == before.rng.random()
    assert (after.model.parameters["w"] == 5).all() and (after.model.state["grid"] == 5).all()
    assert (after.optimizer.first["w"] == 6).all() and (after.optimizer.second["w"] == 7).all()
    assert (after.average.count, after.average.sums["w"].tolist()) == (1, [5.0, 5.0, 5.0])


def test_a_return_to_a_snapshot_removes_later_parameters_from_the_average() -> None:
    state = training(3.0)
    state.average.add()
    state.take_snapshot()
    state.model.parameters["w"][:] = 100
    state.average.add()
    state.restore_snapshot()
    state.average.apply()
    assert state.average.count == 1 and state.model.parameters["w"].tolist() == [3.0, 3.0, 3.0]


def test_a_new_training_starts_from_zero() -> None:
    state = training()
    assert (state.step, state.psnr, state.seconds, state.losses) == (0, 0.0, 0.0, {})
    assert (state.skipped, state.failures, state.rate_scale) == (0, 0, 1.0)


def test_a_checkpoint_of_another_training_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    saved(tmp_path, monkeypatch)
    with pytest.raises(RunFolderError, match=r"belongs to another training \(different seed\); remove it"):
        training().resume(tmp_path, {"seed": 4})
    with pytest.raises(RunFolderError, match=r"\(different seed, views\)"):
        training().resume(tmp_path, {"seed": 4, "views": 2})
    monkeypatch.setattr(checkpoint, "__version__", "0.1.0")
    with pytest.raises(RunFolderError, match=r"\(different version\)"):
        training().resume(tmp_path, {"seed": 3})


@pytest.mark.parametrize(
    "damage", ["missing array", "shape", "nan", "other optimizer", "negative steps", "random state", "cut"]
)
def test_a_damaged_checkpoint_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, damage: str) -> None:
    saved(tmp_path, monkeypatch)
    path = tmp_path / TRAINING_FILE
    arrays, header = read_arrays(path, dict)
    if damage == "missing array":
        del arrays["first/w"]
    elif damage == "shape":
        arrays["state/grid"] = np.zeros(3, np.float32)
    elif damage == "nan":
        arrays["second/w"] = np.full(3, np.nan, np.float32)
    elif damage == "other optimizer":
        header["optimizer_steps"] = {"v": 1}
    elif damage == "negative steps":
        header["optimizer_steps"] = {"w": -1}
    elif damage == "random state":
        header["rng"] = {"bit_generator": "MT19937"}
    write_arrays(path, arrays, header)
    if damage == "cut":
        path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(DataError, match=r"training\.safetensors is damaged.* remove (it|the file) to start"):
        training().resume(tmp_path, {"seed": 3})


def test_no_step_of_the_optimizer_is_valid(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    state = training()
    state.resume(tmp_path, {})
    monkeypatch.setattr(checkpoint, "SAVE_EVERY", 0.0)
    state.save_periodically(tmp_path)
    training().resume(tmp_path, {})


def test_checkpoints_are_20_seconds_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [100.0]
    monkeypatch.setattr(checkpoint, "time", SimpleNamespace(perf_counter=lambda: clock[0]))
    state, path = training(), tmp_path / TRAINING_FILE
    state.resume(tmp_path, {})
    for now, exists in ((119.9, False), (120.0, True), (139.9, False), (140.0, True)):
        clock[0] = now
        state.save_periodically(tmp_path)
        assert path.exists() == exists, now
        path.unlink(missing_ok=True)


def test_no_checkpoint_is_written_after_a_failed_step(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    state, path = saved(tmp_path, monkeypatch), tmp_path / TRAINING_FILE
    before = path.read_bytes()
    state.model.parameters["w"][:], state.failures = np.nan, 1
    state.save_periodically(tmp_path)
    assert path.read_bytes() == before and not state.is_finite()


def test_a_snapshot_brings_back_parameters_and_moments_and_halves_the_rate() -> None:
    state = training(1.0)
    state.restore_snapshot()
    assert state.rate_scale == 0.5 and (state.model.parameters["w"] == 1).all(), "nothing to return to"
    state.optimizer.steps["w"] = 4
    state.take_snapshot()
    for array in (state.model.parameters["w"], state.model.state["grid"], state.optimizer.first["w"]):
        array[:] = np.nan
    state.optimizer.second["w"][:], state.optimizer.steps["w"] = -1, 9
    state.restore_snapshot()
    assert state.rate_scale == 0.25 and state.optimizer.steps == {"w": 4}
    assert (state.model.parameters["w"] == 1).all() and (state.model.state["grid"] == 1).all()
    assert (state.optimizer.first["w"] == 2).all() and (state.optimizer.second["w"] == 3).all()


def header(**change: object) -> dict:
    point = [0.0, 0.0, 0.0]
    camera = {"width": 2, "height": 1, "fl_x": 1.0, "fl_y": 1.0, "cx": 1.0, "cy": 0.5}
    return {
        **{"settings": {}, "box": {"center": point, "half": point, "shell": 1.0}, "classes": 16, "meta": {}},
        **{"frame": {"origin": point, "unit": 1.0}, "intrinsics": camera},
        **{"visibility": {"origin": point, "voxel": 0.05, "shape": [1, 1, 1]}, **change},
    }


def test_a_saved_field_ends_its_training(tmp_path: Path) -> None:
    (tmp_path / TRAINING_FILE).touch()
    save_parts(tmp_path, {"a": np.arange(3)}, header())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["nerf.json", FIELD_FILE]
    arrays, found = load_parts(tmp_path)
    assert arrays["a"].tolist() == [0, 1, 2] and found.classes == 16 and found.package is None
    assert json.loads((tmp_path / "nerf.json").read_text()) == {"version": 5, **header()}


@pytest.mark.parametrize(("name", "value"), [("write_arrays", 0), ("write_json", 1)])
def test_an_interrupted_save_leaves_the_old_or_the_new_field(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, value: int
) -> None:
    save_parts(tmp_path, {"a": np.zeros(3)}, header(classes=0))
    (tmp_path / TRAINING_FILE).touch()

    def full(*_: object) -> None:
        raise DataError("the disk is full")

    with monkeypatch.context() as patch, pytest.raises(DataError, match="full"):
        patch.setattr(checkpoint, name, full)
        save_parts(tmp_path, {"a": np.ones(3)}, header(classes=1))
    arrays, found = load_parts(tmp_path)
    assert arrays["a"].tolist() == 3 * [value] and found.classes == value
    assert (tmp_path / TRAINING_FILE).exists()


def test_a_header_without_a_json_representation_leaves_the_old_field(tmp_path: Path) -> None:
    save_parts(tmp_path, {"a": np.zeros(3)}, header())
    with pytest.raises(DataError, match=r"cannot write .*nerf\.safetensors: .*JSON"):
        save_parts(tmp_path, {"a": np.ones(3)}, header(meta={"train_psnr": float("nan")}))
    assert load_parts(tmp_path)[0]["a"].tolist() == [0, 0, 0]


def test_files_of_another_version_are_refused(tmp_path: Path) -> None:
    save_parts(tmp_path, {"a": np.arange(3)}, header(version=6))
    with pytest.raises(DataError, match=r"nerf\.safetensors has version 6, this release reads 5; fit again"):
        load_parts(tmp_path)
    write_arrays(tmp_path / FIELD_FILE, {"a": np.arange(3)})  # as before version 4, with the header in nerf.json
    with pytest.raises(DataError, match=r"nerf\.safetensors has version 3 or lower, this release reads 5; fit again"):
        load_parts(tmp_path)


def test_settings_are_written_as_json_reads_them() -> None:
    settings = settings_to_json(SETTINGS["smoke"])
    assert json.loads(json.dumps(settings)) == settings and any(isinstance(v, list) for v in settings.values())
