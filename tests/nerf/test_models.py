"""One suite for every model: it learns, repeats itself, stops and goes on, is saved and read, and knows its slopes."""

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

from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.errors import DataError, UnknownNameError
from autonerf_lab.geometry import Intrinsics, camera_rays
from autonerf_lab.nerf import MODELS, NeRF, checkpoint, fit, load_nerf, model_spec
from autonerf_lab.nerf.model import ModelSpec
from autonerf_lab.nerf.ray_batch import Rays, to_numpy
from autonerf_lab.simulator import Simulator

CAMERA = Intrinsics.from_fov(24, 24)
# the walls are a patchwork of random colours: a deep network needs far more steps for those than a hash table
UNEXPLAINED = {"semantic-nerf": 0.98}
OPTIONS = {
    "depth": {"depth_weight": 0.05},
    "cameras": {"refine_cameras": True},
    "one colour from everywhere": {"view_dependent": False},
}
EXAMPLE = "dense-grid"  # of examples/tiny_model.py: a model that is not in the package has to do what the others do
EXAMPLES = Path(__file__).parents[2] / "examples"
every_model = pytest.mark.parametrize("name", [*MODELS, EXAMPLE])


@pytest.fixture(scope="module", autouse=True)
def installed_example(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The example's file and what pip would leave of a package that registers it."""
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
def walk() -> Trajectory:
    sim = Simulator(two_rooms(), CAMERA, supersample=1)
    rng = np.random.default_rng(0)
    poses = np.stack([sim.sample_pose(rng) for _ in range(60)])
    frames = [sim.render(pose) for pose in poses]
    rgb, depth, semantics = (np.stack([getattr(f, k) for f in frames]) for k in ("rgb", "depth", "semantics"))
    return Trajectory(poses, rgb, depth, semantics, CAMERA, {"scene": "toy"})


@pytest.fixture(scope="module")
def fields(walk: Trajectory) -> dict[str, NeRF]:
    return {name: fit(walk, name, preset="smoke", progress=False) for name in (*MODELS, EXAMPLE)}


def train(walk: Trajectory, name: str, steps: int, **options: object) -> NeRF:
    settings = replace(model_spec(name).settings["smoke"], steps=steps, **options)
    return fit(walk, name, preset="smoke", settings=settings, progress=False)


def values(field: NeRF) -> dict[str, np.ndarray]:
    model = field.model
    return {name: to_numpy(value) for name, value in {**model.parameters, **model.state}.items()}


@every_model
def test_it_learns_colours_classes_and_walls(fields: dict[str, NeRF], walk: Trajectory, name: str) -> None:
    field = fields[name]
    mean = walk.rgb.mean(axis=(0, 1, 2)) / 255
    images = [field.render(walk.poses[t]) for t in range(0, 60, 6)]
    error = np.mean([(image.rgb - walk.rgb[6 * i] / 255) ** 2 for i, image in enumerate(images)])
    assert error < UNEXPLAINED.get(name, 0.5) * np.mean((walk.rgb / 255 - mean) ** 2)
    depth = np.stack([image.depth for image in images])
    wall = walk.depth[::6] if walk.depth is not None else depth
    assert np.median(np.abs(depth - wall)) < np.median(np.abs(np.median(wall) - wall))
    semantics = np.stack([image.semantics for image in images])
    assert (semantics == walk.semantics[::6]).mean() >= (walk.semantics[::6] == 0).mean()


@every_model
def test_images_and_queries_have_their_shapes(fields: dict[str, NeRF], walk: Trajectory, name: str) -> None:
    field = fields[name]
    image = field.render(walk.poses[0], Intrinsics.from_fov(13, 7))  # no whole block of rays
    assert image.rgb.shape == (7, 13, 3) and image.depth.shape == image.opacity.shape == (7, 13)
    assert image.rgb.dtype == image.depth.dtype == np.float32 and image.semantics is not None
    assert image.semantics.dtype == np.uint8
    points = np.random.default_rng(0).uniform(-1, 3, (51, 3))
    assert field.density(points).shape == (51,) and (field.density(points) >= 0).all()
    assert field.color(points).shape == (51, 3) and 0 <= field.color(points).min() <= field.color(points).max() <= 1
    np.testing.assert_allclose(field.semantics(points).sum(axis=1), 1, atol=1e-5)
    assert field.density(points[:0]).shape == (0,)


@every_model
def test_same_seed_same_bits_and_another_seed_others(walk: Trajectory, name: str) -> None:
    first, second = values(train(walk, name, 4)), values(train(walk, name, 4))
    for key, value in first.items():
        np.testing.assert_array_equal(value, second[key], err_msg=key)
    settings = replace(model_spec(name).settings["smoke"], steps=4)
    other = values(fit(walk, name, preset="smoke", settings=settings, seed=1, progress=False))
    assert any((value != other[key]).any() for key, value in first.items())


@every_model
def test_stopped_and_resumed_it_is_the_same(
    walk: Trajectory, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(checkpoint, "SAVE_EVERY", 0.0)
    settings = replace(model_spec(name).settings["smoke"], steps=8)

    def interrupt(step: int, model: object) -> None:
        if step == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fit(walk, name, "smoke", settings=settings, progress=False, checkpoint=tmp_path, callback=interrupt)
    resumed = fit(walk, name, "smoke", settings=settings, progress=False, checkpoint=tmp_path)
    expected = values(train(walk, name, 8))
    for key, value in values(resumed).items():
        np.testing.assert_array_equal(value, expected[key], err_msg=key)


@every_model
def test_saved_and_read_it_is_the_same(fields: dict[str, NeRF], walk: Trajectory, name: str, tmp_path: Path) -> None:
    fields[name].save(tmp_path)
    loaded = load_nerf(tmp_path)
    for a, b in zip(*(vars(f.render(walk.poses[3])).values() for f in (fields[name], loaded)), strict=True):
        np.testing.assert_array_equal(a, b)
    assert loaded.meta == fields[name].meta


@every_model
def test_a_device_reads_what_the_kernels_trained(
    fields: dict[str, NeRF], walk: Trajectory, name: str, tmp_path: Path
) -> None:
    fields[name].save(tmp_path)
    on_device = load_nerf(tmp_path, device="cpu")
    found, wanted = on_device.render(walk.poses[3]), fields[name].render(walk.poses[3])
    assert np.abs(found.rgb - wanted.rgb).mean() < 0.01  # kernels leave out samples of little weight
    assert np.median(np.abs(found.depth - wanted.depth)) < 0.01


@every_model
def test_it_trains_in_torch_as_on_cuda(walk: Trajectory, name: str) -> None:
    settings = replace(model_spec(name).settings["smoke"], steps=12, rays=256, warmup=0.0)
    seen: list[float] = []
    fit(walk, name, "smoke", settings=settings, device="cpu", progress=False,
        callback=lambda step, model: seen.append(model.field.parameters is not None))  # fmt: skip
    assert len(seen) == 12


@every_model
@pytest.mark.parametrize("option", OPTIONS)
def test_options_train(walk: Trajectory, name: str, option: str) -> None:
    field = train(walk, name, 3, **OPTIONS[option])
    assert np.isfinite(field.render(walk.poses[0]).rgb).all()
    if option.startswith("one"):
        points, d = np.zeros((2, 3)), np.eye(3)[:2]
        np.testing.assert_allclose(field.color(points, d)[0], field.color(points, d)[1], atol=1e-6)
    if option == "cameras":
        moved = np.abs(field.cameras - walk.poses).max()
        assert 0 < moved < 0.05


@every_model
def test_slopes_of_rays_are_those_of_the_error(fields: dict[str, NeRF], walk: Trajectory, name: str) -> None:
    model, rng = fields[name].model, np.random.default_rng(0)
    rays_o, rays_d = (a.reshape(-1, 3).astype(np.float32) for a in camera_rays(CAMERA, walk.poses[0]))
    rays_d /= np.linalg.norm(rays_d, axis=1, keepdims=True)
    target = rng.random(rays_o.shape, dtype=np.float32)
    samples = model.sampler.sample(Rays(rays_o, rays_d), np.full(len(rays_o), 0.5, np.float32))

    def error(rays_o: np.ndarray, rays_d: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return model.field.ray_gradients(Rays(np.float32(rays_o), np.float32(rays_d)), samples, target)

    _, d_o, d_d = error(rays_o, rays_d)
    step = np.float32(1e-4) * rng.normal(size=rays_o.shape).astype(np.float32)
    for slope, ahead, behind in (
        (d_o, (rays_o + step, rays_d), (rays_o - step, rays_d)),
        (d_d, (rays_o, rays_d + step), (rays_o, rays_d - step)),
    ):
        found, expected = (error(*ahead)[0] - error(*behind)[0]) / 2, (slope * step).sum(axis=1)
        assert np.corrcoef(found, expected)[0, 1] > 0.95  # cells of the hash tables have kinks
        assert (found @ expected) / (expected @ expected) == pytest.approx(1, abs=0.1)


def test_a_model_of_ones_own_is_passed_as_it_is(walk: Trajectory, tmp_path: Path) -> None:
    built_in = MODELS["semantic-nerfacto"]
    mine = ModelSpec({"smoke": replace(built_in.settings["smoke"], steps=3)}, built_in.build, "mine")
    field = fit(walk, mine, "smoke", progress=False)
    assert field.meta["model"] == "mine"
    field.save(tmp_path)
    with pytest.raises(DataError, match="needs the model 'mine', which is not installed; pass it"):
        load_nerf(tmp_path)
    assert load_nerf(tmp_path, model=mine).meta == field.meta
    with pytest.raises(UnknownNameError, match="preset of mine"):
        fit(walk, mine, "fast", progress=False)
    assert model_spec(mine) is mine


@pytest.mark.parametrize("name", list(MODELS))
def test_rays_in_pieces_have_the_same_gradients(walk: Trajectory, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from autonerf_lab.nerf import model as module

    nerf = train(walk, name, 2, seen_rays=500)
    rng = np.random.default_rng(0)
    rays_d, target = rng.normal(size=(300, 3)).astype(np.float32), rng.random((300, 3)).astype(np.float32)
    rays_o = np.repeat(walk.poses[:1, :3, 3], 300, axis=0).astype(np.float32)
    whole = nerf.ray_gradients(rays_o, rays_d, target)
    monkeypatch.setattr(module, "GRADIENT_PIECE", 128)  # the last piece is no whole one
    for found, wanted in zip(nerf.ray_gradients(rays_o, rays_d, target), whole, strict=True):
        assert found.shape == wanted.shape
        np.testing.assert_allclose(found, wanted, rtol=1e-4, atol=1e-6)


def test_the_example_is_passed_as_it_is_too(walk: Trajectory) -> None:
    from tiny_model import SPEC

    settings = replace(SPEC.settings["smoke"], steps=2)
    assert fit(walk, SPEC, "smoke", settings=settings, progress=False).meta["model"] == EXAMPLE


def test_the_example_interpolates_between_the_corners() -> None:
    from tiny_model import interpolate

    # values that are linear in the position, over 2 x 3 x 4 voxels of the unit cube
    cells = np.array([2, 3, 4])
    corners = np.stack(np.meshgrid(*(np.arange(n + 1) / n for n in cells), indexing="ij"), axis=-1).reshape(-1, 3)
    slopes = np.array([[1.0, -2.0], [10.0, 0.0], [100.0, 5.0]])
    x = np.random.default_rng(0).random((50, 3))
    x[0], x[1] = 0, 1  # both ends belong to the grid
    found = interpolate(torch.from_numpy(x), torch.from_numpy(corners @ slopes), cells)
    np.testing.assert_allclose(found.numpy(), x @ slopes, rtol=1e-9)


def test_the_example_runs_as_a_script(tmp_path: Path) -> None:
    command = [sys.executable, str(EXAMPLES / "tiny_model.py"), "--steps", "20", "--out", str(tmp_path / "views.png")]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    assert "NeRF(dense-grid, scene=train-00, " in result.stdout and " dB in 2 frames held out" in result.stdout
    with Image.open(tmp_path / "views.png") as picture:
        assert picture.size == (2 * 96, 4 * 96)
