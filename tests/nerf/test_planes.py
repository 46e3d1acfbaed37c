"""Planes of a half-trained field: where they are found in rooms, and what a training does with them."""

from dataclasses import asdict, replace

import numpy as np
import pytest

import autonerf_lab as lab
from autonerf_lab.data.dataset import Dataset
from autonerf_lab.errors import DataError
from autonerf_lab.geometry import Intrinsics, planar_pose
from autonerf_lab.nerf import checkpoint, planes
from autonerf_lab.nerf.fit import prepare
from autonerf_lab.nerf.pixel_sampler import PixelSampler
from autonerf_lab.nerf.planes import planar_depth
from autonerf_lab.utils.storage import read_arrays, write_arrays

SIZE = np.array([4.0, 3.0, 2.5])  # of a room with a corner at the origin


@pytest.fixture(scope="module")
def views():
    """Camera centres, directions of depth 1, true depth and colours of 24 views of the empty room."""
    directions = Intrinsics.from_fov(40, 40).directions()
    angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    poses = np.stack([planar_pose(1.5 + np.cos(a) / 2, 1.5 - np.sin(a) / 2, a) for a in angles])
    origins = poses[:, :3, 3]
    rays = np.einsum("tij,hwj->thwi", poses[:, :3, :3], directions)
    with np.errstate(divide="ignore"):
        walls = np.where(rays > 0, SIZE - origins[:, None, None], -origins[:, None, None]) / rays
    depth = walls.min(axis=-1)
    return origins, rays, depth, np.full((*depth.shape, 3), 200, np.uint8)


def bulging(depth, origins, rays):
    """Return depths with errors of up to 4 cm that vary slowly over the surfaces of the room."""
    points = origins[:, None, None] + depth[..., None] * rays
    return depth + 0.04 * np.sin(points @ (5.0, 4.0, 3.0))


def test_bulges_of_walls_vanish(views):
    origins, rays, depth, colors = views
    found = planar_depth(bulging(depth, origins, rays), origins, rays, colors, np.ones(depth.shape, bool))
    known = found > 0
    assert known.mean() > 0.95
    before, after = (np.abs(values - depth)[known] for values in (bulging(depth, origins, rays), found))
    assert np.median(before) > 0.015
    assert np.median(after) < 0.005
    assert np.percentile(after, 95) < 0.03


def test_headings_of_the_walls_do_not_matter(views):
    origins, rays, depth, colors = views
    usable = np.ones(depth.shape, bool)
    turn = planar_pose(0, 0, 0.6)[:3, :3] @ planar_pose(0, 0, 0)[:3, :3].T
    straight = planar_depth(bulging(depth, origins, rays), origins, rays, colors, usable)
    turned = planar_depth(bulging(depth, origins, rays), origins @ turn.T, rays @ turn.T, colors, usable)
    assert np.median(np.abs(turned - depth)) < 0.01
    assert np.abs(turned - straight).mean() < 0.02


@pytest.mark.parametrize(("color", "error"), [(200, 0.0), (40, 0.15)])
def test_haze_before_a_wall_is_recognised_by_its_colour(views, color, error):
    origins, rays, depth, colors = views
    points = origins[:, None, None] + depth[..., None] * rays
    patch = (points[..., 0] > SIZE[0] - 1e-6) & (np.abs(points[..., 1] - 1.5) < 0.5) & (points[..., 2] > 0.8)
    shown, colors = np.where(patch, depth - 0.15 / np.abs(rays[..., 0]), depth), colors.copy()
    colors[patch] = color
    found = planar_depth(shown, origins, rays, colors, np.ones(depth.shape, bool))
    inside = patch & (found > 0)
    assert inside.sum() > 300
    np.testing.assert_allclose(np.median(((depth - found) * np.abs(rays[..., 0]))[inside]), error, atol=0.01)


def test_only_usable_pixels_have_planes(views):
    origins, rays, depth, colors = views
    usable = np.zeros(depth.shape, bool)
    usable[:, :10] = True
    found = planar_depth(depth, origins, rays, colors, usable)
    assert found[usable].any()
    assert not found[~usable].any()
    assert not planar_depth(depth, origins, rays, colors, np.zeros(depth.shape, bool)).any()


@pytest.fixture(scope="module")
def episode():
    sim = lab.Simulator(lab.load_scene("dev-4"), Intrinsics.from_fov(48, 48), supersample=1)
    return lab.explore(sim, "frontier", steps=150, progress=False)


def smoke(**changes):
    return replace(lab.nerf.MODELS["semantic-nerfacto"].settings["smoke"], **{"rays_on_planes": 0.04, **changes})


def planes_of(monkeypatch, data, settings):
    """Train, and return what the pixels learned of planes: a list of calls."""
    found = []
    learn = PixelSampler.learn_planes

    def record(self, pixels, depth):
        found.append((pixels, depth))
        learn(self, pixels, depth)

    monkeypatch.setattr(PixelSampler, "learn_planes", record)
    lab.fit(data, settings=settings, progress=False)
    return found


def test_fit_looks_for_planes_once_where_a_robot_drove_without_depth(monkeypatch, episode):
    [(pixels, depth)] = planes_of(monkeypatch, episode, smoke(steps=300))
    true = np.concatenate([image.reshape(-1) for image in episode.depth])[pixels]
    labels = np.concatenate([image.reshape(-1) for image in episode.semantics])[pixels]
    assert len(pixels) > 5000
    assert not labels.any()
    assert np.median(np.abs(depth - true)) < 0.25  # the field has learned for 150 steps
    assert planes_of(monkeypatch, episode, smoke(steps=8, rays_on_planes=0.0)) == []
    assert planes_of(monkeypatch, episode, smoke(steps=8, floor_weight=0.0)) == []
    assert planes_of(monkeypatch, episode, smoke(steps=8, depth_weight=1.0)) == []
    elsewhere = replace(episode, meta={**episode.meta, "actions": []})
    assert planes_of(monkeypatch, elsewhere, smoke(steps=8)) == []


def test_training_interrupted_after_planes_were_found_has_the_same_bits(monkeypatch, episode, tmp_path):
    monkeypatch.setattr(checkpoint, "SAVE_EVERY", 0.0)
    options = {"settings": smoke(steps=120, rays=512), "progress": False}

    def interrupt(step, model):
        if step == 80:
            raise KeyboardInterrupt

    whole = lab.fit(episode, **options)
    with pytest.raises(KeyboardInterrupt):
        lab.fit(episode, checkpoint=tmp_path, callback=interrupt, **options)
    file = tmp_path / checkpoint.TRAINING_FILE
    arrays, header = read_arrays(file, checkpoint.TrainingHeader)
    assert len(arrays["planes/pixels"]) == len(arrays["planes/depth"]) > 1000
    for name, wrong, message in (("depth", np.float32("nan"), "damaged"), ("pixels", 10**9, "of other images")):
        write_arrays(file, {**arrays, f"planes/{name}": arrays[f"planes/{name}"] + wrong}, asdict(header))
        with pytest.raises(DataError, match=message):
            lab.fit(episode, checkpoint=tmp_path, **options)
    write_arrays(file, arrays, asdict(header))
    resumed = lab.fit(episode, checkpoint=tmp_path, **options)
    for name, value in whole.model.parameters.items():
        np.testing.assert_array_equal(value, resumed.model.parameters[name], err_msg=name)


def test_masked_pixels_and_pixels_of_objects_or_of_known_depth_are_left_out(monkeypatch, episode):
    monkeypatch.setattr(planes, "planar_depth", lambda depth, origins, rays, colors, usable: usable.astype(np.float32))
    data = Dataset.from_trajectory(episode)
    left = np.zeros(data.images[0].shape[:2], bool)
    left[:, :24] = True
    state, pixels = prepare(replace(data, masks=[left] * len(data)), lab.nerf.MODELS["semantic-nerfacto"], smoke())
    found = planes.planar_pixels(state.model, pixels)["pixels"]
    assert len(found) > 1000
    assert (found % 48 < 24).all()
    assert not pixels.labels[found].any()
    assert not pixels.depth[found].any()


def test_views_are_rendered_at_their_corrected_poses_and_depths_that_are_not_finite_are_left_out(monkeypatch, episode):
    settings = smoke(refine_cameras=True)
    state, pixels = prepare(Dataset.from_trajectory(episode), lab.nerf.MODELS["semantic-nerfacto"], settings)
    assert state.model.pose_offsets is not None
    state.model.pose_offsets.parameters["camera_shift"][:] = (0.5, 0, 0)
    rendered = []

    def render(origins, directions):
        rendered.append(origins)
        depth = np.full(len(origins), np.nan, np.float32)
        return np.zeros((len(origins), 3)), np.zeros((len(origins), 1)), depth, np.ones(len(origins))

    monkeypatch.setattr(state.model, "render_rays", render)
    found = planes.planar_pixels(state.model, pixels)
    assert len(found["pixels"]) == len(found["depth"]) == 0
    shift = rendered[0] - pixels.rays(pixels.grid(planes.VIEWS, planes.PER_VIEW).ravel()).origins
    np.testing.assert_allclose(shift, np.tile([0.5, 0, 0], (len(shift), 1)), atol=1e-5)
