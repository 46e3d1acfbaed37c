"""Training on a small scene: quality, determinism, checkpoints, callbacks and errors."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from toy_scene import two_rooms

from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.errors import (
    DataError,
    DeviceError,
    MissingPackageError,
    RunFolderError,
    TrainingError,
    UnknownNameError,
)
from autonerf_lab.geometry import Intrinsics, camera_rays
from autonerf_lab.nerf import NeRF, checkpoint, fit, load_nerf
from autonerf_lab.nerf.model import Model
from autonerf_lab.nerf.models.semantic_nerfacto import SETTINGS
from autonerf_lab.nerf.settings import HashSettings
from autonerf_lab.simulator import Simulator

CAMERA = Intrinsics.from_fov(32, 32)
SETTINGS_SMALL = replace(SETTINGS["smoke"], rays=512, steps=250)


@pytest.fixture(scope="module")
def trajectory() -> Trajectory:
    sim = Simulator(two_rooms(), CAMERA, supersample=1)
    rng = np.random.default_rng(0)
    poses = np.stack([sim.sample_pose(rng) for _ in range(80)])
    frames = [sim.render(pose) for pose in poses]
    images = np.stack([frame.rgb for frame in frames]), np.stack([frame.semantics for frame in frames])
    return Trajectory(poses, images[0], None, images[1], CAMERA, {"scene": "toy"})


@pytest.fixture(scope="module")
def field(trajectory: Trajectory) -> NeRF:
    return fit(trajectory, settings=SETTINGS_SMALL, preset="smoke", progress=False)


def psnr(field: NeRF, trajectory: Trajectory, frames: range) -> float:
    errors = [np.mean((field.render(trajectory.poses[t]).rgb - trajectory.rgb[t] / 255) ** 2) for t in frames]
    return float(-10 * np.log10(np.mean(errors)))


def test_training_beats_the_mean_colour(field: NeRF, trajectory: Trajectory) -> None:
    mean = trajectory.rgb.mean(axis=(0, 1, 2)) / 255
    baseline = -10 * np.log10(np.mean((trajectory.rgb / 255 - mean) ** 2))
    assert psnr(field, trajectory, range(0, 80, 8)) > baseline + 4
    image = field.render(trajectory.poses[0])
    assert image.rgb.shape == (32, 32, 3) and image.semantics.dtype == np.uint8
    assert np.isfinite(image.depth).all() and (image.depth > 0).all()


def test_same_seed_gives_the_same_bits(field: NeRF, trajectory: Trajectory) -> None:
    again = fit(trajectory, settings=SETTINGS_SMALL, preset="smoke", progress=False)
    for name, value in field.model.parameters.items():
        np.testing.assert_array_equal(value, again.model.parameters[name], err_msg=name)


def test_resumed_training_has_the_same_bits(
    trajectory: Trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(checkpoint, "SAVE_EVERY", 0.0)
    whole = fit(trajectory, settings=replace(SETTINGS_SMALL, steps=30), preset="smoke", progress=False)

    def interrupt(step: int, model: Model) -> None:
        if step == 12:
            raise KeyboardInterrupt

    settings = replace(SETTINGS_SMALL, steps=30)
    with pytest.raises(KeyboardInterrupt):
        fit(trajectory, settings=settings, preset="smoke", progress=False, checkpoint=tmp_path, callback=interrupt)
    steps: list[int] = []
    resumed = fit(
        trajectory,
        settings=settings,
        preset="smoke",
        progress=False,
        checkpoint=tmp_path,
        callback=lambda step, model: steps.append(step),
    )
    assert steps[0] == 13
    for name, value in whole.model.parameters.items():
        np.testing.assert_array_equal(value, resumed.model.parameters[name], err_msg=name)
    with pytest.raises(RunFolderError, match="seed"):
        fit(trajectory, settings=settings, preset="smoke", seed=1, progress=False, checkpoint=tmp_path)
    with pytest.raises(RunFolderError, match="views"):
        other = replace(trajectory, rgb=trajectory.rgb[::-1].copy())
        fit(other, settings=settings, preset="smoke", progress=False, checkpoint=tmp_path)


def test_save_and_load(field: NeRF, trajectory: Trajectory, tmp_path: Path) -> None:
    field.save(tmp_path)
    loaded = load_nerf(tmp_path)
    points = np.random.default_rng(0).uniform(-1, 3, (500, 3))
    np.testing.assert_array_equal(field.density(points), loaded.density(points))
    np.testing.assert_array_equal(field.seen(points), loaded.seen(points))
    np.testing.assert_array_equal(field.poses, loaded.poses)
    np.testing.assert_array_equal(field.render(trajectory.poses[3]).rgb, loaded.render(trajectory.poses[3]).rgb)
    assert loaded.meta == field.meta and loaded.intrinsics == field.intrinsics


@pytest.mark.parametrize("damage", ["cut", "missing", "other", "text"])
def test_damaged_files_are_named(field: NeRF, tmp_path: Path, damage: str) -> None:
    field.save(tmp_path)
    arrays, header = tmp_path / "nerf.safetensors", tmp_path / "nerf.json"
    if damage == "cut":
        arrays.write_bytes(arrays.read_bytes()[:-100])
    elif damage == "missing":
        arrays.unlink()
    elif damage == "other":
        header.write_text(header.read_text().replace('"levels": 6', '"levels": 4'))
    else:
        header.write_text('{"version": 1}')
    with pytest.raises(DataError, match=r"nerf\.(json|safetensors)"):
        load_nerf(tmp_path)


def test_ray_gradients_are_orthogonal_to_directions(field: NeRF, trajectory: Trajectory) -> None:
    rays_o, rays_d = (a.reshape(-1, 3)[:256] for a in camera_rays(CAMERA, trajectory.poses[0]))
    target = np.zeros((256, 3), np.float32)
    error, d_o, d_d = field.ray_gradients(rays_o, rays_d, target)
    assert error.shape == (256,) and d_o.shape == d_d.shape == (256, 3)
    # The error does not depend on the length of a direction.
    np.testing.assert_allclose((d_d * rays_d).sum(axis=1), 0, atol=1e-4 * np.abs(d_d).max())


def test_invalid_input_is_refused(trajectory: Trajectory) -> None:
    with pytest.raises(UnknownNameError, match="semantic-nerfacto"):
        fit(trajectory, "nerfacto", preset="smoke")
    with pytest.raises(UnknownNameError, match="smoke"):
        fit(trajectory, preset="quick")
    with pytest.raises(DataError, match="the class 16"):
        fit(
            replace(trajectory, semantics=np.full(trajectory.rgb.shape[:3], 16, np.uint8)),
            preset="smoke",
            progress=False,
        )
    with pytest.raises(DataError, match="no depth"):
        fit(trajectory, settings=replace(SETTINGS_SMALL, depth_weight=0.1), progress=False)
    still = Trajectory(trajectory.poses[:1], trajectory.rgb[:1], None, None, CAMERA)
    with pytest.raises(DataError, match="one view"):
        fit(still, preset="smoke", progress=False)
    with pytest.raises(ValueError, match="multiple of 4"):
        HashSettings(hidden=30)
    with pytest.raises(DeviceError, match="device 'gpu' is not available"):
        fit(trajectory, preset="smoke", device="gpu", progress=False)


def test_nan_stops_the_training(trajectory: Trajectory) -> None:
    def poison(step: int, model: Model) -> None:
        model.parameters["density_1"][0, 0] = np.nan

    with pytest.raises(TrainingError, match="step 1"):
        fit(trajectory, settings=SETTINGS_SMALL, preset="smoke", progress=False, callback=poison)


def test_training_without_semantics(trajectory: Trajectory) -> None:
    short = replace(SETTINGS_SMALL, steps=5)
    field = fit(replace(trajectory, semantics=None), settings=short, preset="smoke", progress=False)
    assert field.render(trajectory.poses[0]).semantics is None
    assert not field.model.parameters["semantic_0"].size
    with pytest.raises(DataError, match="without semantics"):
        field.semantics(np.zeros((1, 3)))


def test_losses_are_logged_to_tensorboard(trajectory: Trajectory, tmp_path: Path) -> None:
    event_accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    short = replace(SETTINGS_SMALL, steps=3)
    last: dict[str, float] = {}
    field = fit(
        trajectory,
        settings=short,
        preset="smoke",
        progress=False,
        log_dir=tmp_path,
        callback=lambda step, model: last.update(model.losses),
    )
    log = event_accumulator.EventAccumulator(str(tmp_path))
    log.Reload()
    assert {tag.removeprefix("loss/") for tag in log.Tags()["scalars"]} == set(last) == set(field.model.losses)
    assert [event.step for event in log.Scalars("loss/mse")] == [1, 2, 3]
    assert log.Scalars("loss/mse")[-1].value == pytest.approx(last["mse"])


def test_log_dir_without_tensorboard_names_the_extra(
    trajectory: Trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    with pytest.raises(MissingPackageError, match=r"autonerf-lab\[training\]"):
        fit(trajectory, settings=replace(SETTINGS_SMALL, steps=1), preset="smoke", progress=False, log_dir=tmp_path)
