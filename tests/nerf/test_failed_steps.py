"""Steps that are not finite: skipped, returned from, and never in a checkpoint, a mean or a field."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from toy_scene import two_rooms
from toy_trajectory import toy_trajectory

from autonerf_lab.data.dataset import Dataset
from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.errors import TrainingError
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.nerf import checkpoint, fit
from autonerf_lab.nerf.fit import prepare, train_step
from autonerf_lab.nerf.model import Model
from autonerf_lab.nerf.models import model_spec
from autonerf_lab.nerf.models.semantic_nerfacto import SETTINGS
from autonerf_lab.nerf.pixel_sampler import PixelSampler
from autonerf_lab.nerf.pose_offsets import pose_rate
from autonerf_lab.simulator import Simulator
from autonerf_lab.utils.storage import read_arrays

CAMERA = Intrinsics.from_fov(32, 32)
SETTINGS_SMALL = replace(SETTINGS["smoke"], rays=512, steps=250)


@pytest.fixture(scope="module")
def trajectory() -> Trajectory:
    return toy_trajectory(Simulator(two_rooms(), CAMERA, supersample=1), 20)


def test_a_training_that_keeps_failing_stops_and_names_the_images(trajectory: Trajectory, tmp_path: Path) -> None:
    def poison(step: int, model: Model) -> None:
        model.parameters["density_1"][0, 0] = np.nan

    with pytest.raises(TrainingError, match=r"40 steps in a row up to step 41.*images: frame 0, frame 1"):
        fit(trajectory, settings=SETTINGS_SMALL, preset="smoke", progress=False, callback=poison)


def test_a_training_returns_to_its_snapshot_after_failed_steps(trajectory: Trajectory) -> None:
    rates = []

    def poison_once(step: int, model: Model) -> None:
        rates.append(float(np.abs(model.parameters["density_1"]).sum()))
        if step == 60:
            model.parameters["density_1"][0, 0] = np.nan

    settings = replace(SETTINGS_SMALL, steps=120)
    field = fit(trajectory, settings=settings, preset="smoke", progress=False, callback=poison_once)
    assert field.meta["skipped_steps"] == 10 and np.isfinite(rates[-1])
    assert np.isnan(rates[60:69]).all() and np.isfinite(rates[70:]).all(), "the tenth failure restores the snapshot"
    assert np.isfinite(field.render(trajectory.poses[0]).rgb).all()


@pytest.mark.parametrize("averaged", [0.0, 0.5])
def test_a_training_that_ends_with_failed_steps_returns_to_its_snapshot(
    trajectory: Trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, averaged: float
) -> None:
    """The last five of 30 steps fail. The checkpoint is that of step 25, the field the snapshot of step 20."""
    monkeypatch.setattr(checkpoint, "SAVE_EVERY", 0.0)
    monkeypatch.setattr(sys.modules["autonerf_lab.nerf.fit"], "SNAPSHOT_EVERY", 10)
    kept: dict[str, np.ndarray] = {}

    def poison(step: int, model: Model) -> None:
        if step == 20:
            kept.update({name: value.copy() for name, value in model.parameters.items()})
        if step == 25:
            model.parameters["density_1"][0, 0] = np.nan

    settings = replace(SETTINGS_SMALL, steps=30, averaged=averaged)
    field = fit(trajectory, settings=settings, preset="smoke", progress=False, checkpoint=tmp_path, callback=poison)
    assert field.meta["skipped_steps"] == 5
    arrays, header = read_arrays(tmp_path / checkpoint.TRAINING_FILE, checkpoint.TrainingHeader)
    assert header.progress.step == 25 and all(np.isfinite(array).all() for array in arrays.values())
    for name, value in field.model.parameters.items():
        assert np.isfinite(value).all(), name
        assert averaged or (value == kept[name]).all(), name


@pytest.mark.parametrize("last", [25, 30])
def test_a_training_without_a_finite_end_stops_and_its_checkpoint_continues(
    trajectory: Trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, last: int
) -> None:
    """The only snapshot is that of the initial parameters, and after the last step nothing restores it."""
    monkeypatch.setattr(checkpoint, "SAVE_EVERY", 0.0)

    def poison(step: int, model: Model) -> None:
        if step == last:
            model.parameters["table"][0] = model.parameters["density_1"][0, 0] = np.nan

    options: dict[str, Any] = {"settings": replace(SETTINGS_SMALL, steps=30), "preset": "smoke", "progress": False}
    words = f"no finite trained parameters are left after 30 steps, of which {30 - last} were skipped"
    with pytest.raises(TrainingError, match=words):
        fit(trajectory, checkpoint=tmp_path, callback=poison, **options)
    field = fit(trajectory, checkpoint=tmp_path, **options)
    assert np.isfinite(field.render(trajectory.poses[0]).rgb).all() and field.meta["steps"] == 30


def test_a_return_to_a_snapshot_halves_the_learning_rate_of_the_poses_too(trajectory: Trajectory) -> None:
    """The first step of Adam moves values by the learning rate."""
    moved = []
    for scale in (1.0, 0.5):
        settings = replace(SETTINGS_SMALL, refine_cameras=True)
        state, pixels = prepare(Dataset.from_trajectory(trajectory), model_spec("semantic-nerfacto"), settings)
        state.rate_scale = scale
        train_step(state, pixels, 0.1)
        moved.append({name: np.abs(value).max() for name, value in state.model.pose_offsets.parameters.items()})
    for name, distance in moved[0].items():
        assert distance == pytest.approx(pose_rate(0.1), rel=1e-3), name
        assert moved[1][name] == pytest.approx(distance / 2, rel=1e-3), name


def test_one_batch_that_is_not_finite_changes_nothing(trajectory: Trajectory, monkeypatch: pytest.MonkeyPatch) -> None:
    """The gradients of a skipped batch do not leak into the next step."""
    settings = replace(SETTINGS_SMALL, steps=6)
    original, calls = Model.train_step, []

    def spoiled(model: Model, rays: object, targets: object, rng: object) -> object:
        calls.append({name: value.copy() for name, value in model.parameters.items()})
        gradients, losses = original(model, rays, targets, rng)
        return gradients, losses | {"mse": np.nan} if len(calls) == 3 else losses

    monkeypatch.setattr(Model, "train_step", spoiled)
    field = fit(trajectory, settings=settings, preset="smoke", progress=False)
    assert field.meta["skipped_steps"] == 1
    for name, value in calls[2].items():
        np.testing.assert_array_equal(calls[3][name], value, err_msg=name)


@pytest.mark.parametrize("levels", [6, 7])
def test_the_step_after_a_batch_with_nan_in_the_images_is_finite(
    trajectory: Trajectory, monkeypatch: pytest.MonkeyPatch, levels: int
) -> None:
    """With an odd number of levels, the features are padded: nothing of the batch may stay in the padding."""
    original, calls = PixelSampler.targets, []

    def spoiled(pixels: PixelSampler, chosen: np.ndarray) -> object:
        calls.append(chosen)
        targets = original(pixels, chosen)
        return replace(targets, color=np.full_like(targets.color, np.nan)) if len(calls) == 3 else targets

    monkeypatch.setattr(PixelSampler, "targets", spoiled)
    settings = replace(SETTINGS_SMALL, steps=6, levels=levels, proposal_levels=levels)
    assert fit(trajectory, settings=settings, preset="smoke", progress=False).meta["skipped_steps"] == 1


def test_the_mean_of_the_parameters_leaves_out_skipped_steps(
    trajectory: Trajectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The mean takes the parameters after steps 4 and 8; step 8 is skipped, so the mean is that after step 4."""
    original, added = Model.train_step, {}

    def spoiled(model: Model, rays: object, targets: object, rng: object) -> object:
        gradients, losses = original(model, rays, targets, rng)
        return gradients, losses | {"mse": np.nan} if len(seen) == 7 else losses

    def record(step: int, model: Model) -> None:
        seen.append(step)
        if step == 4:
            added.update({name: value.copy() for name, value in model.parameters.items()})

    seen: list[int] = []
    monkeypatch.setattr(Model, "train_step", spoiled)
    settings = replace(SETTINGS_SMALL, steps=9, averaged=0.9)
    field = fit(trajectory, settings=settings, preset="smoke", progress=False, callback=record)
    assert field.meta["skipped_steps"] == 1
    for name, value in added.items():
        np.testing.assert_array_equal(field.model.parameters[name], value, err_msg=name)
