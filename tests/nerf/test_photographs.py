"""Fields trained on posed photographs: any scale, origin and camera, distant background, no labels."""

from dataclasses import replace

import numpy as np
import pytest
import toy_photos as toy
from PIL import Image as Pillow

import autonerf_lab as lab
from autonerf_lab.data.dataset import Dataset, load_dataset
from autonerf_lab.errors import DataError
from autonerf_lab.evaluators import NearestView, semantic_mesh
from autonerf_lab.evaluators.rendering import psnr
from autonerf_lab.geometry import Intrinsics, planar_pose, so3_exp
from autonerf_lab.nerf import NeRF, fit, load_nerf
from autonerf_lab.nerf.field_frame import SPREAD, FieldFrame
from autonerf_lab.nerf.models import MODELS
from autonerf_lab.nerf.models.semantic_nerfacto import SETTINGS
from autonerf_lab.nerf.pixel_sampler import PixelSampler
from autonerf_lab.nerf.settings import OccupancySettings
from autonerf_lab.viz.camera_paths import trajectory_path
from autonerf_lab.viz.point_cloud import point_cloud
from autonerf_lab.viz.video import save_video
from autonerf_lab.viz.viewer.live import LiveViewer
from autonerf_lab.viz.viewer.viewer import nerf_viewer

SMALL = replace(SETTINGS["smoke"], rays=512, steps=120)
FAR_AWAY = (4e6, -5e5, 120.0)  # metres, as in map coordinates


def train(data: Dataset, steps: int = SMALL.steps) -> NeRF:
    return fit(data, settings=replace(SMALL, steps=steps), preset="smoke", progress=False)


def held_out_psnr(nerf: NeRF, data: Dataset) -> float:
    return lab.evaluate(nerf, data, progress=False)["held_out", "psnr"]


@pytest.fixture(scope="module")
def halves() -> tuple[Dataset, Dataset]:
    return toy.photographs(toy.orbit()).split()


@pytest.fixture(scope="module")
def field(halves) -> NeRF:
    return train(halves[0])


# --- coordinates of the field ---------------------------------------------------------------------------------------


def posed(poses):
    """Return a dataset with given poses and minimal images."""
    one = np.zeros((2, 2, 3), np.uint8)
    camera = Intrinsics.from_fov(2, 2)
    return Dataset(poses, [one] * len(poses), [camera] * len(poses), None, None, [""] * len(poses), {}, False)


@pytest.mark.parametrize("poses", [toy.orbit(), toy.outward()])
def test_field_coordinates_do_not_depend_on_scale_and_origin(poses):
    here = FieldFrame.from_dataset(posed(poses)).poses_to_field(poses)
    for scale, shift in ((37.0, np.zeros(3)), (0.01, np.array([5.0, 0, -1])), (2.0, np.array(FAR_AWAY))):
        data = toy.moved(posed(poses), scale, shift)
        frame = FieldFrame.from_dataset(data)
        np.testing.assert_allclose(frame.poses_to_field(data.poses), here, atol=1e-6)
        np.testing.assert_allclose(frame.poses_to_world(frame.poses_to_field(data.poses)), data.poses, rtol=1e-12)


def test_the_scale_of_an_orbit_is_its_distance_to_the_focus():
    """Cameras on an arc of 20 degrees, 50 units from the origin: the distance is the scale, not the size of the arc."""
    arc = [toy.looking((50 * np.cos(a), 50 * np.sin(a), 0), (0, 0, 0)) for a in np.radians(np.linspace(-10, 10, 8))]
    arc.append(toy.looking((40, 0, 30), (0, 0, 0)))
    assert FieldFrame.from_dataset(posed(np.stack(arc))).unit == pytest.approx(50 / SPREAD)


def test_a_focus_behind_the_cameras_is_ignored():
    """Viewing directions diverge by 2 degrees over a metre: the axes meet 29 m behind the cameras."""
    fan = np.stack([planar_pose(0, y, np.radians(2 * y)) for y in np.linspace(-0.5, 0.5, 9)])
    fan[::2, 2, 3] += 0.1
    assert FieldFrame.from_dataset(posed(fan)).unit < 1


def test_an_outlier_pose_does_not_change_the_scale(halves):
    """A pose that is a thousand times too far away changes neither the box nor the memory of the grid."""
    data = halves[0]
    poses = data.poses.copy()
    poses[5, :3, 3] *= 1000
    lost = replace(data, poses=poses)
    assert FieldFrame.from_dataset(lost).unit == pytest.approx(FieldFrame.from_dataset(data).unit, rel=0.1)
    nerf = train(lost, 3)
    assert nerf.model.box.half.max() < 5 and nerf.visibility.seen.size < 1 << 24


def test_photographs_from_a_tripod_have_a_scale():
    """Six of ten photographs from one position: the median distance is zero, but the scale is not."""
    poses = np.stack([planar_pose(0, 0, a) for a in range(6)] + [planar_pose(100 * a, 0, a) for a in range(1, 5)])
    poses[:, :3, 3] *= 0.01
    assert 0.001 < FieldFrame.from_dataset(posed(poses)).unit < 2


# --- cameras --------------------------------------------------------------------------------------------------------

LENS = Intrinsics(40, 30, 24.0, 25.0, 20.5, 14.0, k1=-0.3, k2=0.1, k3=-0.01, p1=0.01, p2=-0.02)
MIXED = [toy.CAMERA, LENS, Intrinsics(24, 36, 30.0, 28.0, 11.0, 19.0), Intrinsics.from_fov(50, 26, 100)]


def test_each_pixel_has_the_ray_of_its_own_camera():
    poses = toy.moved(posed(toy.orbit(8)), 5.0, (100, 0, 0)).poses
    cameras = (MIXED * 2)[:8]
    images = [np.zeros((c.height, c.width, 3), np.uint8) for c in cameras]
    depths = [np.full((c.height, c.width), 10.0, np.float32) for c in cameras]
    data = replace(posed(poses), images=images, intrinsics=cameras, depths=depths)
    pixels = PixelSampler(data, frame := FieldFrame.from_dataset(data))
    rays, targets = pixels.rays(np.arange(len(pixels))), pixels.targets(np.arange(len(pixels)))
    ends = frame.to_world(rays.origins + targets.depth[:, None] * rays.directions)  # 10 units in front of each camera
    first = 0
    for pose, camera in zip(poses, cameras, strict=True):
        u, v = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
        x, y = toy.undistorted(camera, u.ravel(), v.ravel())
        there = 10 * np.stack([x, -y, -np.ones_like(x)], axis=1) @ pose[:3, :3].T + pose[:3, 3]
        np.testing.assert_allclose(ends[first : first + len(x)], there, atol=1e-4)
        first += len(x)
    assert first == len(pixels)


def test_photographs_with_several_cameras_and_sizes(tmp_path):
    """Portrait format, zoom and lens distortion: each frame of the file has its own camera."""
    poses = toy.orbit(48, seed=1)
    data = load_dataset(toy.write(toy.photographs(poses, MIXED * 12), tmp_path))
    assert {image.shape for image in data.images} == {(30, 40, 3), (36, 24, 3), (26, 50, 3)}
    data = replace(data, meta={"test_filenames": data.names[::9]})  # of all cameras
    training, held_out = data.split()
    scores = lab.evaluate(train(training), held_out, trajectory=training, progress=False)
    assert scores["held_out", "psnr"] > scores.baselines["nearest_view"]["held_out", "psnr"] + 4


def test_lens_distortion_is_modelled():
    """The lens moves the corners by several pixels. Renderings with and without distortion match the photographs."""
    poses, straight = toy.orbit(radius=2.5), replace(LENS, k1=0, k2=0, k3=0, p1=0, p2=0)
    bent = toy.photographs(poses, LENS).split()
    nerf = train(bent[0])
    ideal = toy.photographs(poses, straight).split()[1]
    ignored = train(replace(bent[0], intrinsics=[straight] * len(bent[0])))
    through = held_out_psnr(nerf, bent[1])
    assert through > 21 and held_out_psnr(nerf, ideal) > through - 2
    assert held_out_psnr(ignored, ideal) < held_out_psnr(nerf, ideal) - 2


# --- scale, place and background ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("scale", "shift"), [(37.0, (0, 0, 0)), (0.01, FAR_AWAY)])
def test_results_are_in_user_coordinates(field, halves, scale, shift, tmp_path):
    training, held_out = (toy.moved(data, scale, shift) for data in halves)
    nerf = train(training)
    nerf.save(tmp_path)
    nerf = load_nerf(tmp_path)
    assert held_out_psnr(nerf, held_out) == pytest.approx(held_out_psnr(field, halves[1]), abs=1)
    np.testing.assert_array_equal(nerf.poses, training.poses)
    truth = toy.photograph(halves[1].poses[0])[1]
    image = nerf.render(held_out.poses[0], held_out.intrinsics[0])
    near = truth < 10
    assert np.median(np.abs(image.depth / scale - truth)[near]) < 0.3
    # Opaque inside the large ball and empty beside it; seen at the cameras, unseen behind the sky.
    inside = np.random.default_rng(0).normal(size=(200, 3))
    inside *= 0.95 / np.linalg.norm(inside, axis=1, keepdims=True)
    density = [scale * np.median(nerf.density(scale * points + np.array(shift))) for points in (inside, 2.5 * inside)]
    assert density[0] > 1 and density[0] > 10 * density[1]
    assert nerf.seen(training.poses[:, :3, 3]).all() and not nerf.seen(training.poses[:, :3, 3] + 500 * scale).any()
    error, d_o, d_d = nerf.ray_gradients(training.poses[:8, :3, 3], -training.poses[:8, :3, 2], np.zeros((8, 3)))
    assert np.isfinite([error, *d_o.T, *d_d.T]).all()
    cloud = point_cloud(nerf, 3000).points
    there = (cloud - np.array(shift)) / scale
    on_balls = np.min([np.abs(np.linalg.norm(there - c, axis=1) - r) for *c, r in toy.BALLS], axis=0)
    if shift == (0, 0, 0):  # float32 cannot resolve a ball of a centimetre at a distance of 4000 km
        close = np.linalg.norm(there, axis=1) < 2.5  # the other points are on the sky
        assert close.sum() > 200 and np.mean(on_balls[close] < 0.3) > 0.8


def test_distant_background():
    """The sky is 400 times as far away as the cameras are apart; the balls keep their depth."""
    data = toy.photographs(toy.outward(60))
    training, held_out = data.split()
    nerf = train(training)
    scores = lab.evaluate(nerf, held_out, trajectory=training, progress=False)
    assert scores["held_out", "psnr"] > scores.baselines["nearest_view"]["held_out", "psnr"] + 6
    depth = np.stack([nerf.render(pose).depth for pose in held_out.poses])
    truth = np.stack([toy.photograph(pose, fine=1)[1] for pose in held_out.poses])
    sky = truth > 100
    assert 0.3 < sky.mean() < 0.99
    assert np.median(depth[sky]) > 4 * np.median(depth[~sky])
    assert nerf.visibility.seen.size < 1 << 24


@pytest.mark.parametrize("model", [name for name in MODELS if not name.endswith("-rgbd")])
def test_every_model_trains_on_photographs(halves, model):
    settings = replace(MODELS[model].settings["smoke"], steps=2, rays=64, seen_rays=500)
    if isinstance(settings, OccupancySettings):
        settings = replace(settings, cell=0.5)  # a small grid
    nerf = fit(toy.moved(halves[0], 0.01, FAR_AWAY), model, settings=settings, preset="smoke", progress=False)
    image = nerf.render(nerf.poses[0], nerf.intrinsics.resized(8, 6))
    assert image.semantics is None and np.isfinite(image.rgb).all() and (image.depth > 0).all()


# --- fields without classes -----------------------------------------------------------------------------------------


def test_views_of_a_field_without_classes(field, halves, tmp_path):
    assert field.classes == 0 and field.render(field.poses[0]).semantics is None
    cloud = point_cloud(field, 500)
    assert cloud.classes is None and len(cloud) == len(cloud.points) > 100
    assert b"label" not in cloud.save(tmp_path / "a.ply").read_bytes()[:500]
    path = trajectory_path(field, 3)
    wide = save_video(field, path, tmp_path / "all.gif", layer="all", progress=False)
    with Pillow.open(wide) as video:
        assert video.size == (80, 30)  # colours and depth
    with pytest.raises(DataError, match="no classes"):
        save_video(field, path, tmp_path / "semantics.gif", layer="semantics", progress=False)
    with nerf_viewer(field) as viewer:
        assert "semantics" not in viewer._layer.options and "rgb" in viewer._layer.options


def test_live_viewer_of_photographs(halves):
    """The viewer renders during training in user coordinates, without classes."""
    data = toy.moved(halves[0], 37.0)
    shown = []
    with LiveViewer(data) as viewer:
        pose = viewer.frame.poses_to_field(data.poses)[3]
        np.testing.assert_allclose(viewer.frame.poses_to_world(pose), data.poses[3])
        viewer._draw = lambda render, *rest: not shown.append(render(data.poses[3], data.intrinsics[3]))
        nerf = fit(data, settings=replace(SMALL, steps=2), preset="smoke", progress=False, callback=viewer)
        viewer._rest_until = 0.0
        viewer(2, nerf.model)
    again = nerf.render(data.poses[3], data.intrinsics[3])
    assert shown[-1].semantics is None
    np.testing.assert_array_equal(shown[-1].depth, again.depth)
    np.testing.assert_array_equal(shown[-1].rgb, again.rgb)


def test_meshes_are_in_user_coordinates(field, halves):
    mesh = lab.extract_mesh(field, voxel=0.2)
    assert len(mesh.faces) and "semantics" not in mesh.vertex_attributes
    with pytest.raises(DataError, match="no classes"):
        semantic_mesh(mesh)
    frame = FieldFrame(37 * field.frame.origin, 37 * field.frame.unit)
    big = NeRF(field.model, 37 * field.poses, field.intrinsics, field.visibility, {}, frame, 0)
    bounds = np.array([[-1.5] * 3, [1.5] * 3])
    small, large = lab.extract_mesh(field, 0.1, bounds=bounds), lab.extract_mesh(big, 3.7, bounds=37 * bounds)
    assert len(small.faces) == len(large.faces) > 100
    np.testing.assert_allclose(large.vertices, 37 * small.vertices, atol=0.02)


# --- held-out scores ------------------------------------------------------------------------------------------------


def test_held_out_scores_are_means_over_photographs(field, halves):
    training, held_out = halves
    scores = lab.evaluate(field, held_out, trajectory=training, progress=False)
    by_hand = [
        psnr(np.clip(field.render(p).rgb, 0, 1), i / 255) for p, i in zip(held_out.poses, held_out.images, strict=True)
    ]
    np.testing.assert_allclose(scores.artifacts["held_out"]["psnr"], by_hand, atol=1e-6)
    assert scores["held_out", "psnr"] == pytest.approx(np.mean(by_hand))
    assert scores["held_out", "ssim"] == pytest.approx(scores.artifacts["held_out"]["ssim"].mean())
    assert [(row.metric, row.unit, row.n) for row in scores] == [("psnr", "dB", 5), ("ssim", "", 5), ("flip", "", 5)]
    assert scores.artifacts["held_out"]["names"] == held_out.names
    nearest = scores.baselines["nearest_view"]
    assert nearest["held_out", "psnr"] < scores["held_out", "psnr"] - 4
    assert "paper" not in scores.table() and "nearest_view" in scores.table()
    same = lab.evaluate(field, toy.moved(held_out, 1.0, (0, 0, 1.0)), progress=False)
    assert same["held_out", "psnr"] < scores["held_out", "psnr"] - 4  # from another position
    with pytest.raises(DataError, match="no ground truth"):
        lab.evaluate(field, held_out, tasks=["maps"])


def test_held_out_labels_are_scored(field, halves):
    class Labelled:
        meta = field.meta

        def render(self, c2w, intrinsics):
            shape = intrinsics.height, intrinsics.width
            return replace(field.render(c2w, intrinsics), semantics=np.full(shape, 4, np.uint8))

    layers = [np.full(image.shape[:2], 4, np.uint8) for image in halves[1].images]
    layers[0][:15] = 7
    scores = lab.evaluate(Labelled(), replace(halves[1], semantics=layers), progress=False)
    assert scores["held_out", "per_class_accuracy"] == 50
    assert scores["held_out", "miou"] == pytest.approx(100 * (1 - 0.1) / 2)
    unknown = lab.evaluate(field, replace(halves[1], semantics=layers), progress=False)
    assert [row.metric for row in unknown] == ["psnr", "ssim", "flip"]


def test_the_nearest_view_in_any_scale_and_direction(halves):
    training, _ = halves
    for scale in (0.01, 37.0):
        view = NearestView(toy.moved(training, scale))
        for t in (0, 7, 20):
            near = view.data.poses[t].copy()
            near[:3, 3] += 0.05 * scale
            assert view.nearest(near) == t
    rolled = np.stack([np.eye(4)] * 2)  # a level camera, and one rotated about its axis
    rolled[1, :3, :3] = so3_exp(np.array([0, 0, np.pi / 2]))
    view = NearestView(replace(posed(rolled), metric=True))
    turned = np.eye(4)
    turned[:3, :3] = so3_exp(np.array([0, 0, np.radians(50)]))
    assert view.nearest(turned) == 1 and view.nearest(np.eye(4)) == 0


def test_custom_datasets_are_checked(halves):
    data = halves[0]

    def changed(index, pose):
        poses = data.poses.copy()
        poses[index] = pose
        return replace(data, poses=poses)

    with pytest.raises(DataError, match=r"004\.png: .*rigid"):
        train(changed(3, np.full((4, 4), np.nan)))
    with pytest.raises(DataError, match=r"003\.png: .*rigid"):
        train(changed(2, np.diag([1.0, 1, 0, 1])))
    with pytest.raises(DataError, match=r"002\.png: 40x30 pixels, but intrinsics of 20x15"):
        train(replace(data, intrinsics=[data.intrinsics[0], data.intrinsics[0].resized(20, 15), *data.intrinsics[2:]]))
    with pytest.raises(DataError, match="one view"):
        train(replace(data, poses=np.repeat(data.poses[:1], len(data), axis=0)))
    with pytest.raises(DataError, match="one view"):
        train(data._take([0]))
