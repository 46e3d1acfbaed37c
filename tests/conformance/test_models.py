"""Conformance suite of all models: quality, determinism, checkpoints, files and gradients."""

import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from toy_scene import two_rooms
from toy_trajectory import toy_trajectory

from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.errors import DataError, UnknownNameError
from autonerf_lab.geometry import Intrinsics, camera_rays
from autonerf_lab.nerf import MODELS, NeRF, checkpoint, fit, load_nerf, model_spec
from autonerf_lab.nerf.model import ModelSpec
from autonerf_lab.nerf.ray_batch import Rays, to_numpy
from autonerf_lab.simulator import Simulator
from autonerf_lab.simulator.depth_noise import redwood

CAMERA = Intrinsics.from_fov(24, 24)
# Share of the colour variance that may remain. The walls have random colours; a deep network needs far more steps for
# these than a hash table.
REMAINING_VARIANCE = {"semantic-nerf": 0.98}
OPTIONS = {
    "depth": {"depth_weight": 2.25},
    "pose offsets": {"refine_cameras": True},
    "no view dependence": {"view_dependent": False},
}
EXAMPLE = "dense-grid"  # of examples/tiny_model.py: a model outside the package must pass the same suite
EXAMPLES = Path(__file__).parents[2] / "examples"
every_model = pytest.mark.parametrize("name", [*MODELS, EXAMPLE])


@pytest.fixture(scope="module", autouse=True)
def installed_example(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Make the example importable, with the metadata of an installed package that registers it."""
    site = tmp_path_factory.mktemp("site")
    info = site / "tiny_model-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: tiny-model\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[autonerf_lab.models]\n{EXAMPLE} = tiny_model:SPEC\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(EXAMPLES)
        patch.syspath_prepend(site)
        yield


@pytest.fixture(scope="module")
def trajectory() -> Trajectory:
    return toy_trajectory(Simulator(two_rooms(), CAMERA, supersample=1), 60, depth=True)


@pytest.fixture(scope="module")
def fields(trajectory: Trajectory) -> dict[str, NeRF]:

    class Fields(dict[str, NeRF]):
        def __missing__(self, name: str) -> NeRF:  # only those that the tests of this process need
            self[name] = fit(trajectory, name, preset="smoke", progress=False)
            return self[name]

    return Fields()


def train(trajectory: Trajectory, name: str, steps: int, **options: object) -> NeRF:
    settings = replace(model_spec(name).settings["smoke"], steps=steps, **options)
    return fit(trajectory, name, preset="smoke", settings=settings, progress=False)


def values(field: NeRF) -> dict[str, np.ndarray]:
    model = field.model
    return {name: to_numpy(value) for name, value in {**model.parameters, **model.state}.items()}


@every_model
def test_training_learns_colours_classes_and_depth(fields: dict[str, NeRF], trajectory: Trajectory, name: str) -> None:
    field = fields[name]
    mean = trajectory.rgb.mean(axis=(0, 1, 2)) / 255
    images = [field.render(trajectory.poses[t]) for t in range(0, 60, 6)]
    error = np.mean([(image.rgb - trajectory.rgb[6 * i] / 255) ** 2 for i, image in enumerate(images)])
    assert error < REMAINING_VARIANCE.get(name, 0.5) * np.mean((trajectory.rgb / 255 - mean) ** 2)
    depth = np.stack([image.depth for image in images])
    truth = trajectory.depth[::6] if trajectory.depth is not None else depth
    assert np.median(np.abs(depth - truth)) < np.median(np.abs(np.median(truth) - truth))
    semantics = np.stack([image.semantics for image in images])
    assert (semantics == trajectory.semantics[::6]).mean() >= (trajectory.semantics[::6] == 0).mean()


@pytest.mark.parametrize("name", [name for name in MODELS if name.endswith("-rgbd")])
def test_depth_may_be_noisy_and_have_holes(trajectory: Trajectory, name: str) -> None:
    """The noise of a structured-light sensor, and a third of each image without depth."""
    assert trajectory.depth is not None
    rng = np.random.default_rng(0)
    depth = np.stack([redwood(image, rng) for image in trajectory.depth])
    depth[:, :, :8] = 0
    field = fit(replace(trajectory, depth=depth), name, preset="smoke", progress=False)
    errors = [field.render(trajectory.poses[t]).depth - trajectory.depth[t] for t in range(0, 60, 6)]
    assert np.median(np.abs(errors)) < 0.1


@every_model
def test_images_and_queries_have_their_shapes(fields: dict[str, NeRF], trajectory: Trajectory, name: str) -> None:
    field = fields[name]
    image = field.render(trajectory.poses[0], Intrinsics.from_fov(13, 7))
    assert image.rgb.shape == (7, 13, 3) and image.depth.shape == image.opacity.shape == (7, 13)
    assert image.rgb.dtype == image.depth.dtype == np.float32 and image.semantics is not None
    assert image.semantics.dtype == np.uint8
    points = np.random.default_rng(0).uniform(-1, 3, (51, 3))
    assert field.density(points).shape == (51,) and (field.density(points) >= 0).all()
    assert field.color(points).shape == (51, 3) and 0 <= field.color(points).min() <= field.color(points).max() <= 1
    np.testing.assert_allclose(field.semantics(points).sum(axis=1), 1, atol=1e-5)
    assert field.density(points[:0]).shape == (0,)


@every_model
def test_the_seed_decides_the_bits(trajectory: Trajectory, name: str) -> None:
    first, second = values(train(trajectory, name, 4)), values(train(trajectory, name, 4))
    for key, value in first.items():
        np.testing.assert_array_equal(value, second[key], err_msg=key)
    settings = replace(model_spec(name).settings["smoke"], steps=4)
    other = values(fit(trajectory, name, preset="smoke", settings=settings, seed=1, progress=False))
    assert any((value != other[key]).any() for key, value in first.items())


@every_model
def test_resumed_training_has_the_same_bits(
    trajectory: Trajectory, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(checkpoint, "SAVE_EVERY", 0.0)
    settings = replace(model_spec(name).settings["smoke"], steps=8)

    def interrupt(step: int, model: object) -> None:
        if step == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fit(trajectory, name, "smoke", settings=settings, progress=False, checkpoint=tmp_path, callback=interrupt)
    resumed = fit(trajectory, name, "smoke", settings=settings, progress=False, checkpoint=tmp_path)
    expected = values(train(trajectory, name, 8))
    for key, value in values(resumed).items():
        np.testing.assert_array_equal(value, expected[key], err_msg=key)


@every_model
def test_saved_field_is_loaded_unchanged(
    fields: dict[str, NeRF], trajectory: Trajectory, name: str, tmp_path: Path
) -> None:
    fields[name].save(tmp_path)
    loaded = load_nerf(tmp_path)
    for a, b in zip(*(vars(f.render(trajectory.poses[3])).values() for f in (fields[name], loaded)), strict=True):
        np.testing.assert_array_equal(a, b)
    assert loaded.meta == fields[name].meta


@every_model
def test_a_field_trained_by_kernels_loads_on_a_device(
    fields: dict[str, NeRF], trajectory: Trajectory, name: str, tmp_path: Path
) -> None:
    fields[name].save(tmp_path)
    on_device = load_nerf(tmp_path, device="cpu")
    found, wanted = on_device.render(trajectory.poses[3]), fields[name].render(trajectory.poses[3])
    assert np.abs(found.rgb - wanted.rgb).mean() < 0.01  # kernels skip samples of little weight
    assert np.median(np.abs(found.depth - wanted.depth)) < 0.01


@every_model
def test_training_in_torch(trajectory: Trajectory, name: str) -> None:
    settings = replace(model_spec(name).settings["smoke"], steps=12, rays=256, warmup=0.0)
    seen: list[float] = []
    fit(trajectory, name, "smoke", settings=settings, device="cpu", progress=False,
        callback=lambda step, model: seen.append(model.field.parameters is not None))  # fmt: skip
    assert len(seen) == 12


@every_model
@pytest.mark.parametrize("option", OPTIONS)
def test_training_with_options(trajectory: Trajectory, name: str, option: str) -> None:
    field = train(trajectory, name, 3, **OPTIONS[option])
    assert np.isfinite(field.render(trajectory.poses[0]).rgb).all()
    if option == "no view dependence":
        points, d = np.zeros((2, 3)), np.eye(3)[:2]
        np.testing.assert_allclose(field.color(points, d)[0], field.color(points, d)[1], atol=1e-6)
    if option == "pose offsets":
        moved = np.abs(field.poses - trajectory.poses).max()
        assert 0 < moved < 0.05


@every_model
def test_ray_gradients_agree_with_finite_differences(
    fields: dict[str, NeRF], trajectory: Trajectory, name: str
) -> None:
    model, rng = fields[name].model, np.random.default_rng(0)
    rays_o, rays_d = (a.reshape(-1, 3).astype(np.float32) for a in camera_rays(CAMERA, trajectory.poses[0]))
    rays_d /= np.linalg.norm(rays_d, axis=1, keepdims=True)
    target = rng.random(rays_o.shape, dtype=np.float32)
    samples = model.sampler.sample(Rays(rays_o, rays_d), np.full(len(rays_o), 0.5, np.float32))

    def error(rays_o: np.ndarray, rays_d: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return model.field.ray_gradients(Rays(np.float32(rays_o), np.float32(rays_d)), samples, target)

    middle, d_o, d_d = error(rays_o, rays_d)
    step = np.float32(3e-5) * rng.normal(size=rays_o.shape).astype(np.float32)
    for slope, ahead, behind in (
        (d_o, (rays_o + step, rays_d), (rays_o - step, rays_d)),
        (d_d, (rays_o, rays_d + step), (rays_o, rays_d - step)),
    ):
        right, left = error(*ahead)[0] - middle, middle - error(*behind)[0]
        found, expected = (right + left) / 2, (slope * step).sum(axis=1)
        smooth = np.abs(right - left) < 0.4 * np.abs(found)  # the slope jumps at faces of cells and at kinks of layers
        assert smooth.mean() > 0.6
        found, expected = found[smooth], expected[smooth]
        assert np.corrcoef(found, expected)[0, 1] > 0.99
        assert (found @ expected) / (expected @ expected) == pytest.approx(1, abs=0.06)


def test_a_custom_model_is_trained_saved_and_loaded(trajectory: Trajectory, tmp_path: Path) -> None:
    built_in = MODELS["semantic-nerfacto"]
    mine = ModelSpec({"smoke": replace(built_in.settings["smoke"], steps=3)}, built_in.build, "mine")
    field = fit(trajectory, mine, "smoke", progress=False)
    assert field.meta["model"] == "mine"
    field.save(tmp_path)
    with pytest.raises(DataError, match="needs the model 'mine', which is not installed; pass it"):
        load_nerf(tmp_path)
    assert load_nerf(tmp_path, model=mine).meta == field.meta
    with pytest.raises(UnknownNameError, match="preset of mine"):
        fit(trajectory, mine, "fast", progress=False)
    assert model_spec(mine) is mine


@pytest.mark.parametrize("name", list(MODELS))
def test_chunks_of_rays_have_the_same_gradients(
    trajectory: Trajectory, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    from autonerf_lab.nerf import model as module

    nerf = train(trajectory, name, 2, seen_rays=500)
    rng = np.random.default_rng(0)
    rays_d, target = rng.normal(size=(300, 3)).astype(np.float32), rng.random((300, 3)).astype(np.float32)
    rays_o = np.repeat(trajectory.poses[:1, :3, 3], 300, axis=0).astype(np.float32)
    whole = nerf.ray_gradients(rays_o, rays_d, target)
    monkeypatch.setattr(module, "GRADIENT_CHUNK", 128)  # the last chunk is smaller
    for found, wanted in zip(nerf.ray_gradients(rays_o, rays_d, target), whole, strict=True):
        assert found.shape == wanted.shape
        np.testing.assert_allclose(found, wanted, rtol=1e-4, atol=1e-6)


def test_the_example_is_trained_without_registration(trajectory: Trajectory) -> None:
    from tiny_model import SPEC

    settings = replace(SPEC.settings["smoke"], steps=2)
    assert fit(trajectory, SPEC, "smoke", settings=settings, progress=False).meta["model"] == EXAMPLE


def test_the_example_interpolates_linear_functions_exactly() -> None:
    from tiny_model import interpolate

    # Values that are linear in the position, on 2 x 3 x 4 voxels of the unit cube.
    cells = np.array([2, 3, 4])
    corners = np.stack(np.meshgrid(*(np.arange(n + 1) / n for n in cells), indexing="ij"), axis=-1).reshape(-1, 3)
    slopes = np.array([[1.0, -2.0], [10.0, 0.0], [100.0, 5.0]])
    x = np.random.default_rng(0).random((50, 3))
    x[0], x[1] = 0, 1  # both ends of the grid
    found = interpolate(torch.from_numpy(x), torch.from_numpy(corners @ slopes), cells)
    np.testing.assert_allclose(found.numpy(), x @ slopes, rtol=1e-9)


def test_the_example_runs_as_a_script(tmp_path: Path) -> None:
    command = [sys.executable, str(EXAMPLES / "tiny_model.py"), "--steps", "20", "--out", str(tmp_path / "views.png")]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    assert "NeRF(dense-grid, scene=train-00, " in result.stdout and " dB in 2 held-out frames" in result.stdout
    with Image.open(tmp_path / "views.png") as image:
        assert image.size == (2 * 96, 4 * 96)
