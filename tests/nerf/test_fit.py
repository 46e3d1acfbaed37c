"""Training on a small scene: quality, determinism, checkpoints, callbacks and errors."""

import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from toy_scene import two_rooms
from toy_trajectory import toy_trajectory

from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.errors import (
    DataError,
    DeviceError,
    MissingPackageError,
    RunFolderError,
    UnknownNameError,
)
from autonerf_lab.exploration import explore
from autonerf_lab.geometry import Intrinsics, camera_rays
from autonerf_lab.nerf import NeRF, checkpoint, fit, load_nerf
from autonerf_lab.nerf.model import Model
from autonerf_lab.nerf.models import model_spec
from autonerf_lab.nerf.models.semantic_nerfacto import SETTINGS
from autonerf_lab.nerf.ray_batch import to_numpy
from autonerf_lab.simulator import Simulator
from autonerf_lab.utils.storage import read_arrays, write_arrays

CAMERA = Intrinsics.from_fov(32, 32)
SETTINGS_SMALL = replace(SETTINGS["smoke"], rays=512, steps=250)


@pytest.fixture(scope="module")
def trajectory() -> Trajectory:
    return toy_trajectory(Simulator(two_rooms(), CAMERA, supersample=1), 80)


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
    settings = replace(SETTINGS_SMALL, steps=30, averaged=0.8)
    whole = fit(trajectory, settings=settings, preset="smoke", progress=False)

    def interrupt(step: int, model: Model) -> None:
        if step == 12:
            raise KeyboardInterrupt

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
    for layer in ("rgb", "semantics"):
        other = replace(trajectory, **{layer: getattr(trajectory, layer)[::-1].copy()})
        with pytest.raises(RunFolderError, match="views"):
            fit(other, settings=settings, preset="smoke", progress=False, checkpoint=tmp_path)


def test_the_field_has_the_mean_of_the_last_parameters(trajectory: Trajectory) -> None:
    seen: list[dict[str, np.ndarray]] = []

    def record(step: int, model: Model) -> None:
        if step in (20, 24, 28):
            seen.append({name: np.array(value) for name, value in model.parameters.items()})

    settings = replace(SETTINGS_SMALL, steps=30, averaged=0.4)
    nerf = fit(trajectory, settings=settings, preset="smoke", progress=False, callback=record)
    for name, value in nerf.model.parameters.items():
        mean = np.mean([parameters[name] for parameters in seen], axis=0)
        np.testing.assert_allclose(value, mean, rtol=1e-5, atol=1e-7, err_msg=name)
        assert not value.size or (seen[0][name] != seen[2][name]).any()


def test_a_model_in_torch_has_the_mean_of_the_last_parameters_too(trajectory: Trajectory) -> None:
    settings = replace(SETTINGS_SMALL, steps=12, rays=64, averaged=0.5)
    nerf = fit(trajectory, settings=settings, preset="smoke", device="cpu", progress=False)
    other = fit(trajectory, settings=replace(settings, averaged=0.0), preset="smoke", device="cpu", progress=False)
    found, raw = (np.concatenate([to_numpy(v).ravel() for v in n.model.parameters.values()]) for n in (nerf, other))
    assert np.isfinite(found).all() and (found != raw).any()


@pytest.mark.parametrize("seconds", [0, -1.0, float("nan"), float("inf")])
def test_a_duration_that_never_ends_is_refused(trajectory: Trajectory, seconds: float) -> None:
    with pytest.raises(DataError, match="seconds must be a finite number above 0"):
        fit(trajectory, seconds=seconds, progress=False)


def test_a_training_of_another_duration_is_not_continued(
    trajectory: Trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The mean would have parameters of the beginning."""
    monkeypatch.setattr(checkpoint, "SAVE_EVERY", 0.0)

    def interrupt(step: int, model: Model) -> None:
        if step == 2:
            raise KeyboardInterrupt

    options: dict[str, Any] = {"settings": SETTINGS_SMALL, "preset": "smoke", "progress": False}
    with pytest.raises(KeyboardInterrupt):
        fit(trajectory, seconds=100, checkpoint=tmp_path, callback=interrupt, **options)
    for seconds in (200, None):
        with pytest.raises(RunFolderError, match="different seconds"):
            fit(trajectory, seconds=seconds, checkpoint=tmp_path, **options)


def test_two_threads_render_what_one_renders(field: NeRF, trajectory: Trajectory) -> None:
    """A viewer renders while the field is evaluated, and the kernels reuse their buffers."""
    poses = trajectory.poses[:6]
    alone = [field.render(pose).rgb for pose in poses]
    with ThreadPoolExecutor(2) as pool:
        together = list(pool.map(lambda k: field.render(poses[k % 6]).rgb, range(24)))
    for k, image in enumerate(together):
        np.testing.assert_array_equal(image, alone[k % 6])


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
    path = tmp_path / "nerf.safetensors"
    arrays, header = read_arrays(path, dict)
    if damage == "cut":
        path.write_bytes(path.read_bytes()[:-100])
    elif damage == "missing":
        path.unlink()
    elif damage == "other":
        write_arrays(path, arrays, header | {"settings": header["settings"] | {"levels": 4}})
    else:
        write_arrays(path, arrays, {"version": header["version"]})
    with pytest.raises(DataError, match=r"nerf\.safetensors"):
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
    with pytest.raises(DeviceError, match="device 'gpu' is not available"):
        fit(trajectory, preset="smoke", device="gpu", progress=False)


def test_the_seen_space_is_that_of_the_corrected_poses(trajectory: Trajectory) -> None:
    def lift(step: int, model: Model) -> None:
        assert model.pose_offsets is not None
        model.pose_offsets.parameters["camera_shift"][:] = [0, 0, 9]

    settings = replace(SETTINGS_SMALL, steps=2, refine_cameras=True, far=4.0)
    field = fit(trajectory, settings=settings, preset="smoke", progress=False, callback=lift)
    assert field.seen(field.poses[:, :3, 3]).all() and not field.seen(trajectory.poses[:, :3, 3]).any()


def test_a_checkpoint_does_not_hold_what_the_depth_shows(
    trajectory: Trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(checkpoint, "SAVE_EVERY", 0.0)
    depth = np.full(trajectory.rgb.shape[:3], 2, np.float32)
    settings = replace(model_spec("semantic-nerfacto-rgbd").settings["smoke"], steps=1, seen_rays=100)
    data, model = replace(trajectory, depth=depth), "semantic-nerfacto-rgbd"
    field = fit(data, model, "smoke", settings=settings, progress=False, checkpoint=tmp_path)
    assert not any("distances" in name for name in read_arrays(tmp_path / checkpoint.TRAINING_FILE, dict)[0])
    field.save(tmp_path)
    assert field.model.observed["distances"].size > 1000
    np.testing.assert_array_equal(load_nerf(tmp_path).model.observed["distances"], field.model.observed["distances"])


@pytest.mark.parametrize("model", ["semantic-nerfacto", "instant-ngp", "semantic-nerf"])
@pytest.mark.parametrize("kind", ["black", "black border", "night", "white", "noise", "two colours"])
def test_hostile_images_leave_a_finite_field(trajectory: Trajectory, model: str, kind: str) -> None:
    """Black images drove the colour logits below -88, where exp overflows in float32."""
    rgb = trajectory.rgb.copy()
    if kind == "black border":
        rgb[:, :4] = rgb[:, -4:] = rgb[:, :, :4] = rgb[:, :, -4:] = 0
    elif kind == "noise":
        rgb = np.random.default_rng(0).integers(0, 256, rgb.shape, dtype=np.uint8)
    else:
        rgb = {"black": rgb * 0, "night": rgb // 40, "white": rgb * 0 + 255, "two colours": (rgb > 127) * 255}[kind]
    data = replace(trajectory, rgb=rgb.astype(np.uint8))
    # a high learning rate reaches the limits in few steps
    settings = replace(model_spec(model).settings["smoke"], steps=60, learning_rate=0.1, rays=256)
    field = fit(data, model, "smoke", settings=settings, progress=False)
    assert field.meta["skipped_steps"] == 0
    for name, value in {**field.model.parameters, **field.model.state}.items():
        assert np.isfinite(to_numpy(value)).all(), name
    assert np.isfinite(field.render(trajectory.poses[0]).rgb).all()
    assert np.isfinite(field.color(np.zeros((1, 3)))).all()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"rays": 0}, "rays must be a whole number from 1"),
        ({"steps": 0}, "steps must be a whole number from 1"),
        ({"samples": 0}, "samples must be a whole number from 1"),
        ({"steps": 2.5}, "steps must be a whole number"),
        ({"rays": True}, "rays must be a whole number"),
        ({"semantic_weight": -1.0}, "semantic_weight must be a number from 0"),
        ({"learning_rate": float("nan")}, "learning_rate must be a number above 0"),
        ({"far": 0.01}, "near must be less than far"),
        ({"rays_by_class": 1.5}, "rays_by_class must be a number from 0 to 1"),
        ({"proposal_samples": ()}, "proposal_samples must be a tuple"),
        ({"log2_entries": 2**63}, "log2_entries must be a whole number"),
        ({"log2_entries": 23}, "exceed 16777216 entries"),
        ({"levels": 33}, "levels must be at most 32"),
        ({"semantic_layers": 3}, "semantic_layers must be 1 or 2"),
        ({"hidden": 30}, "hidden must be a multiple of 4"),
        ({"fine": 2.0}, "fine must be from 0.0001 to coarse"),
        ({"view_dependent": 1}, "view_dependent must be True or False"),
    ],
    ids=str,
)
def test_settings_check_themselves(change: dict, words: str) -> None:
    with pytest.raises(DataError, match=words):
        replace(SETTINGS_SMALL, **change)


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


@pytest.mark.parametrize(
    "model, source, distance, by_class",
    [
        ("instant-ngp-rgbd", "predicted", 1.0, 0.0),
        ("instant-ngp-rgbd", "noisy", 0.0, 0.2),
        ("instant-ngp", "predicted", 0.0, 0.2),  # trains without depth, but for that of the driven floor
    ],
)
def test_the_distance_of_labels_counts_for_predicted_labels_with_depth(
    model: str, source: str, distance: float, by_class: float
) -> None:
    sim = Simulator(two_rooms(), Intrinsics.from_fov(16, 16), supersample=1, semantics=source)
    episode = explore(sim, "random", steps=10, progress=False)
    settings = replace(model_spec(model).settings["smoke"], steps=1, label_distance=1.0)
    found = fit(episode, model, settings=settings, progress=False).model.settings
    assert (found.label_distance, found.rays_by_class) == (distance, by_class)


def test_cuda_trains_what_the_cpu_trains(trajectory: Trajectory) -> None:
    """CUDA trains nearly the same field as torch on the CPU; without CUDA, the error names the device."""
    settings = replace(model_spec("semantic-nerfacto").settings["smoke"], steps=20, rays=256)
    if not torch.cuda.is_available():
        with pytest.raises(DeviceError, match="device 'cuda' is not available"):
            fit(trajectory, settings=settings, device="cuda", progress=False)
        pytest.skip("no CUDA device: only the error was tested")
    fields = [fit(trajectory, settings=settings, device=name, progress=False) for name in ("cpu", "cuda")]
    assert fields[0].meta["train_psnr"] == pytest.approx(fields[1].meta["train_psnr"], abs=0.2)
