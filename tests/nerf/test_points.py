"""Extreme inputs of trained fields: points and rays that are not finite are refused, all others give finite values."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.errors import DataError
from autonerf_lab.geometry import Intrinsics, planar_pose
from autonerf_lab.nerf import MODELS, NeRF, fit
from autonerf_lab.nerf.models import model_spec
from autonerf_lab.nerf.ray_batch import Rays, Samples, assign, to_numpy
from autonerf_lab.nerf.rendering import LOG_SIGMA_START
from autonerf_lab.nerf.scene_box import SceneBox

CAMERA = Intrinsics.from_fov(8, 8)
POSE = planar_pose(0.0, 0.5, 0.0)
DOWN = np.array([[0.0, 0.0, -1.0]])


@pytest.fixture(scope="module", params=list(MODELS))
def field(request: pytest.FixtureRequest) -> NeRF:
    rng = np.random.default_rng(0)
    poses = np.stack([planar_pose(x, 0.5, 0.1 * x) for x in range(4)])
    rgb = rng.integers(0, 255, (4, 8, 8, 3), dtype=np.uint8)
    depth, classes = rng.uniform(1, 3, (4, 8, 8)).astype(np.float32), rng.integers(0, 16, (4, 8, 8), dtype=np.uint8)
    trajectory = Trajectory(poses, rgb, depth, classes, CAMERA, {"scene": "x"})
    settings = replace(model_spec(request.param).settings["smoke"], steps=2, rays=32)
    return fit(trajectory, request.param, settings=settings, preset="smoke", progress=False)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e38, 1e300])
@pytest.mark.parametrize(
    "call",
    [
        lambda field, bad: field.density(bad),
        lambda field, bad: field.color(bad),
        lambda field, bad: field.color(np.zeros((20, 3)), bad),
        lambda field, bad: field.semantics(bad),
        lambda field, bad: field.seen(bad),
        lambda field, bad: field.render(POSE + np.pad(bad[3:6], ((0, 1), (1, 0)))),
        lambda field, bad: field.ray_gradients(bad, np.repeat(DOWN, 20, axis=0), np.zeros((20, 3))),
        lambda field, bad: field.ray_gradients(np.zeros((20, 3)), bad, np.zeros((20, 3))),
    ],
    ids=["density", "color", "directions", "semantics", "seen", "render", "origins", "ray directions"],
)
def test_points_and_rays_that_are_not_finite_are_refused(
    field: NeRF, call: Callable[[NeRF, np.ndarray], Any], value: float
) -> None:
    bad = np.zeros((20, 3))
    bad[5, 1] = value
    with pytest.raises(DataError, match=r"(points|rays|directions) must be finite and below 1e\+09; the largest"):
        call(field, bad)


def test_a_ray_without_a_direction_is_refused(field: NeRF) -> None:
    with pytest.raises(DataError, match="a ray has a direction of length zero"):
        field.ray_gradients(np.zeros((2, 3)), np.zeros((2, 3)), np.zeros((2, 3)))


@pytest.mark.parametrize("scale", [0.0, 1e-40, 1.0, -1.0, 30.0, -1e4, 1e6])
def test_extreme_parameters_and_coordinates_give_finite_values(field: NeRF, scale: float) -> None:
    """Logarithms of densities, logits and encodings leave the range of exponentials when parameters are scaled."""
    if "trunk_7" in field.model.parameters:  # ten layers of larger factors leave the range of float32 themselves
        scale = float(np.clip(scale, -30, 30))
    kept = {name: to_numpy(value).copy() for name, value in field.model.parameters.items()}
    points = np.array([[0, 0, 0], [1e-45, -1e-38, 1e-30], [9e8, -9e8, 9e8], [1e4, 0, 0], [1, 0.5, 0.9]])
    try:
        for name, value in field.model.parameters.items():
            assign(value, kept[name] * np.float32(scale))
        found = [field.density(points), field.color(points), field.semantics(points)]
        for pose in (POSE, planar_pose(1e4, -1e4, 0.3), planar_pose(8e8, 0, 1.0)):
            image = field.render(pose, CAMERA)
            found += [image.rgb, image.depth, image.opacity]
        rays = np.repeat(DOWN, 5, axis=0)
        found += field.ray_gradients(np.clip(points, -5, 5), rays, np.full((5, 3), 0.5))
        assert all(np.isfinite(values).all() for values in found)
    finally:
        for name, value in field.model.parameters.items():
            assign(value, kept[name])


def test_the_number_of_rays_at_once_changes_no_value(field: NeRF, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    origins, directions, target = rng.normal(size=(3, 60, 3)).astype(np.float32)
    rays = origins, directions / np.linalg.norm(directions, axis=1, keepdims=True)
    found = []
    for size in (60, 7):
        monkeypatch.setattr(field.model.field, "rays_at_once", size, raising=False)
        found.append((*field.model.render_rays(*rays), *field.model.ray_gradients(*rays, target)))
    for together, apart in zip(*found, strict=True):
        np.testing.assert_allclose(apart, together, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("name", ["semantic-nerf", "semantic-nerfacto"])
def test_a_torch_field_has_the_densities_of_its_forward_function(name: str) -> None:
    spec, box = model_spec(name), SceneBox(np.zeros(3, np.float32), np.ones(3, np.float32), 1.0)
    model = spec.build(spec.settings["smoke"], box, 1, 16, np.random.default_rng(0), "cpu")
    points = np.random.default_rng(1).uniform(-2, 2, (9, 5, 3)).astype(np.float32)
    rays = Rays(points[:, 0], points[:, 1] / np.linalg.norm(points[:, 1], axis=1, keepdims=True))
    samples = Samples.between(np.tile(np.linspace(0.1, 3, 7, dtype=np.float32), (9, 1)))
    for field in {model.field, getattr(model.sampler, "coarse", model.field)}:
        with torch.no_grad():
            raw = field.forward(torch.from_numpy(points), torch.from_numpy(rays.directions), None)[0].numpy()
        density = np.exp(raw + LOG_SIGMA_START).ravel()
        np.testing.assert_allclose(field.density(points.reshape(-1, 3)), density, rtol=1e-5)
        np.testing.assert_allclose(field.weights(rays, samples), field.render(rays, samples).weights, rtol=1e-5)
