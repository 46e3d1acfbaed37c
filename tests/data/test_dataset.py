from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from toy_capture import CAMERA, POSES, edit, image, make, put

import autonerf_lab as lab
from autonerf_lab.data.dataset import Dataset, load_dataset
from autonerf_lab.data.trajectory import Trajectory, load_trajectory
from autonerf_lab.errors import DataError
from autonerf_lab.geometry import Intrinsics, planar_pose


@pytest.fixture
def capture(tmp_path):
    return make(tmp_path / "capture")


def _trajectory(frames=3):
    rng = np.random.default_rng(0)
    return Trajectory(
        np.stack([planar_pose(t, 2 * t, 0.5 * t) for t in range(frames)]),
        rng.integers(0, 256, (frames, 6, 8, 3), dtype=np.uint8),
        rng.integers(0, 9000, (frames, 6, 8)).astype(np.float32) / np.float32(1000),
        rng.integers(0, 16, (frames, 6, 8), dtype=np.uint8),
        Intrinsics.from_fov(8, 6),
        {"scene": "toy", "actions": [0, 1, 2]},
    )


def test_photographs_are_read_unchanged(capture):
    data = lab.load_dataset(capture)
    assert isinstance(data, lab.Dataset)
    np.testing.assert_array_equal(data.poses, POSES)
    np.testing.assert_array_equal(data.images, [image(t) for t in range(3)])
    assert data.intrinsics == [Intrinsics(12, 8, 10.0, 11.0, 6.5, 3.5)] * 3
    assert (data.semantics, data.depths, data.metric, data.names) == (None, None, False, ["a.png", "b.png", "c.png"])
    assert len(data) == 3
    assert load_dataset(capture / "transforms.json").intrinsics == data.intrinsics


def test_a_trajectory_folder_is_read_unchanged(tmp_path):
    trajectory = _trajectory()
    trajectory.save(tmp_path)
    again, same = load_dataset(tmp_path), Dataset.from_trajectory(trajectory)
    for name in ("poses", "images", "semantics", "depths"):
        mine, theirs = getattr(again, name), getattr(same, name)
        np.testing.assert_array_equal(mine, theirs)
        assert mine[0].dtype == theirs[0].dtype
    assert (again.intrinsics, again.meta, again.metric) == (same.intrinsics, same.meta, True)
    assert again.names[1] == "images/frame_00001.png"


def test_from_trajectory_shares_arrays():
    trajectory = _trajectory()
    data = Dataset.from_trajectory(trajectory)
    assert data.depths is not None and data.semantics is not None
    for array, whole in (
        (data.images[1], trajectory.rgb),
        (data.depths[1], trajectory.depth),
        (data.semantics[1], trajectory.semantics),
    ):
        assert np.shares_memory(array, whole)
    assert Dataset.from_trajectory(replace(trajectory, depth=None, semantics=None)).depths is None


def test_lens_distortion_is_saved(tmp_path):
    trajectory = replace(_trajectory(), intrinsics=replace(Intrinsics.from_fov(8, 6), k1=0.1, k3=0.01))
    trajectory.save(tmp_path)
    assert load_dataset(tmp_path).intrinsics[0] == trajectory.intrinsics
    with pytest.raises(DataError, match="load_dataset"):
        load_trajectory(tmp_path)


def test_camera_keys_of_a_frame_override_those_of_the_file(capture):
    def change(content):
        content["k1"] = 0.1
        content["frames"][1] |= {"fl_x": 20, "cx": 5, "k1": 0.2, "p2": 0.01}

    cameras = load_dataset(edit(capture, change)).intrinsics
    assert cameras[0] == Intrinsics(12, 8, 10.0, 11.0, 6.5, 3.5, k1=0.1)
    assert cameras[1] == Intrinsics(12, 8, 20.0, 20.0, 5.0, 3.5, k1=0.2, p2=0.01)  # not the fl_y of the file


@pytest.mark.parametrize(
    ("top", "focal"),
    [
        ({"camera_angle_x": np.pi / 2}, (6, 6)),  # 12 / 2 / tan(45 degrees)
        ({"camera_angle_y": np.pi / 2}, (4, 4)),
        ({"camera_angle_x": np.pi / 2, "camera_angle_y": 2 * np.arctan(4 / 5)}, (6, 5)),
        ({"fl_x": 9}, (9, 9)),
        ({"fl_y": 9, "w": 12.0, "h": 8.0}, (9, 9)),
        ({"fl_x": 9, "camera_angle_x": 1.0, "camera_angle_y": 2 * np.arctan(4 / 5)}, (9, 5)),
    ],
)
def test_focal_lengths_and_angles(tmp_path, top, focal):
    assert load_dataset(make(tmp_path, **top)).intrinsics[0] == Intrinsics(12, 8, *focal, 6.0, 4.0)


def test_blender_and_instant_ngp(tmp_path):
    """No image size, no extension, './', and unknown keys."""
    names = ("train/r_0.png", "train/r_1.png", "train/r_2.1.png")
    top = {"camera_angle_x": np.pi / 2, "aabb_scale": 4, "k4": 0, "is_fisheye": False, "applied_transform": [[1]]}
    make(tmp_path, names, **top)
    for t, name in enumerate(["./train/r_0", ".\\train\\r_1", "train/r_2.1"]):
        edit(tmp_path, put("frames", t, "file_path", name))
        edit(tmp_path, put("frames", t, "sharpness", 30.5))
    (tmp_path / "transforms.json").rename(tmp_path / "transforms_train.json")
    data = load_dataset(tmp_path / "transforms_train.json")
    assert data.names == list(names)
    assert data.intrinsics[0] == Intrinsics(12, 8, 6.0, 6.0, 6.0, 4.0)
    assert data.meta == {"aabb_scale": 4, "applied_transform": [[1]]}
    assert load_dataset(tmp_path).names == list(names)


def test_extensions_are_tried_in_order(capture):
    edit(capture, put("frames", 0, "file_path", "a"))
    Image.fromarray(image(9)).save(capture / "a.jpg")
    np.testing.assert_array_equal(load_dataset(capture).images[0], image(0))
    (capture / "a.png").unlink()
    assert load_dataset(capture).names[0] == "a.jpg"


def test_intrinsics_are_scaled_to_smaller_images(tmp_path):
    """Nerfstudio's images_2: announced 25 x 17, stored 12 x 8 (rounded down)."""
    top = {"w": 25, "h": 17, "fl_x": 20.0, "fl_y": 30.0, "cx": 12.0, "cy": 9.0, "k1": 0.1}
    camera = load_dataset(make(tmp_path, **top)).intrinsics[0]
    assert camera == Intrinsics(25, 17, 20.0, 30.0, 12.0, 9.0, k1=0.1).resized(12, 8)
    assert camera.fl_x == pytest.approx(20 * 12 / 25) and camera.fl_y == pytest.approx(30 * 8 / 17)


def _save_rotated(file, orientation, array):
    exif = Image.Exif()
    exif[0x0112] = orientation
    Image.fromarray(array).save(file, exif=exif)


@pytest.mark.parametrize(("size", "orientation", "shape"), [((12, 8), 6, (8, 12)), ((8, 12), 6, (12, 8))])
def test_exif_is_used_only_if_the_size_agrees(capture, size, orientation, shape):
    _save_rotated(capture / "a.png", orientation, image())
    edit(capture, lambda content: content["frames"][0].update(w=size[0], h=size[1]))
    data = load_dataset(capture)
    expected = image() if shape == (8, 12) else np.rot90(image(), -1)
    np.testing.assert_array_equal(data.images[0], expected)
    assert (data.intrinsics[0].height, data.intrinsics[0].width) == shape


def _grey16():
    return Image.fromarray(np.full((8, 12), 257 * 100, np.uint16))


def _half_transparent():
    image = Image.new("RGBA", (12, 8), (0, 100, 200, 0))
    image.putpixel((0, 0), (0, 100, 200, 255))
    image.putpixel((1, 0), (0, 100, 200, 51))  # one fifth
    return image


@pytest.mark.parametrize(
    ("image", "pixels"),
    [
        (Image.new("L", (12, 8), 100), [(100,) * 3] * 3),
        (_grey16(), [(100,) * 3] * 3),
        (Image.new("1", (12, 8), 1), [(255,) * 3] * 3),
        (Image.new("RGB", (12, 8), (1, 2, 3)).quantize(4), [(1, 2, 3)] * 3),
        (Image.new("LA", (12, 8), (7, 0)), [(255,) * 3] * 3),
        (_half_transparent(), [(0, 100, 200), (204, 224, 244), (255, 255, 255)]),
    ],
)
def test_all_pixel_formats_become_rgb(capture, image, pixels):
    image.save(capture / "a.png")
    read = load_dataset(capture).images[0]
    assert (read.shape, read.dtype) == ((8, 12, 3), np.uint8)
    assert [tuple(p) for p in read[0, :3].tolist()] == pixels


def test_a_transparent_palette_is_composited(capture):
    image = Image.new("P", (12, 8), 1)
    image.putpalette([10, 20, 30, 40, 50, 60])
    image.putpixel((0, 0), 0)
    image.save(capture / "a.png", transparency=b"\x00\xff")
    assert load_dataset(capture).images[0][0, :2].tolist() == [[255] * 3, [40, 50, 60]]


@pytest.mark.parametrize("name", ["x.jpg", "x.JPEG", "x.webp"])
def test_other_formats(tmp_path, name):
    flat = np.full((8, 12, 3), 90, np.uint8)
    data = load_dataset(make(tmp_path, (name, "b.png"), [flat, flat], **CAMERA))
    assert np.abs(data.images[0].astype(int) - 90).max() <= 3


def test_depth_and_semantics_are_read_when_every_frame_has_them(capture):
    """Layers may be smaller than the image, as phones store depth: each value covers four pixels."""
    depth = np.arange(24, dtype=np.uint16).reshape(4, 6) * 1000
    classes = (np.arange(24) % 16).astype(np.uint8).reshape(4, 6)
    for t in range(3):
        Image.fromarray(depth).save(capture / f"d{t}.png")
        Image.fromarray(classes).save(capture / f"s{t}.png")
        edit(capture, put("frames", t, "depth_file_path", f"d{t}.png"))
        edit(capture, put("frames", t, "semantics_file_path", f"s{t}.png"))
    data = load_dataset(capture)
    assert data.depths is not None and data.semantics is not None
    np.testing.assert_array_equal(data.depths[1], depth.repeat(2, 0).repeat(2, 1) / np.float32(1000))
    np.testing.assert_array_equal(data.semantics[1], classes.repeat(2, 0).repeat(2, 1))
    assert (data.depths[0].dtype, data.semantics[0].dtype) == (np.float32, np.uint8)
    edit(capture, lambda content: content["frames"][2].pop("depth_file_path"))
    assert load_dataset(capture).depths is None
    Image.fromarray(np.full((8, 12), 16, np.uint8)).save(capture / "s1.png")
    with pytest.raises(DataError, match=r"s1\.png contains the class 16"):
        load_dataset(capture)
    Image.fromarray(np.zeros((8, 8), np.uint8)).save(capture / "s1.png")
    with pytest.raises(DataError, match=r"s1\.png must have the aspect ratio"):
        load_dataset(capture)


def test_8_bit_depth_is_refused(capture):
    for t in range(3):
        Image.fromarray(np.zeros((8, 12), np.uint8)).save(capture / f"d{t}.png")
        edit(capture, put("frames", t, "depth_file_path", f"d{t}.png"))
    with pytest.raises(DataError, match=r"d0\.png must be a 16-bit PNG"):
        load_dataset(capture)


def test_images_are_downscaled_to_fit_into_memory(tmp_path):
    """3 frames of 12 x 8 take 864 bytes; at half size 216; at a third, 4 x 3, 108."""
    trajectory = _trajectory()
    make(tmp_path / "photos", **{**CAMERA, "k1": 0.1})
    whole = load_dataset(tmp_path / "photos", max_bytes=864)
    with pytest.warns(UserWarning, match="downscaled 2 times") as caught:
        half = load_dataset(tmp_path / "photos", max_bytes=863)
    assert len(caught) == 1 and caught[0].filename == __file__
    mean = whole.images[0].reshape(4, 2, 6, 2, 3).mean(axis=(1, 3))
    assert np.abs(half.images[0] - mean).max() <= 0.5
    assert half.intrinsics[0] == Intrinsics(6, 4, 5.0, 5.5, 3.25, 1.75, k1=0.1)
    with pytest.warns(UserWarning, match="downscaled 3 times"):
        third = load_dataset(tmp_path / "photos", max_bytes=200)
    assert third.images[0].shape == (3, 4, 3)  # the last row is the mean of two
    assert np.abs(third.images[0][2, 0] - whole.images[0][6:, :3].mean(axis=(0, 1))).max() <= 0.5
    assert third.intrinsics[0].fl_y == pytest.approx(11 / 3) and third.intrinsics[0].height == 3
    with pytest.warns(UserWarning, match="downscaled 8 times"):
        eighth = load_dataset(tmp_path / "photos", max_bytes=20)
    assert eighth.images[0].shape == (1, 2, 3) and (eighth.intrinsics[0].width, eighth.intrinsics[0].height) == (2, 1)
    with pytest.raises(DataError, match="max_bytes=5"):
        load_dataset(tmp_path / "photos", max_bytes=5)
    trajectory.save(tmp_path / "trajectory")
    with pytest.warns(UserWarning, match="downscaled 2 times"):
        small = load_dataset(tmp_path / "trajectory", max_bytes=3 * 8 * 6 * 8 - 1)
    assert small.depths is not None and small.semantics is not None and trajectory.depth is not None
    np.testing.assert_array_equal(small.depths[0], trajectory.depth[0, 1::2, 1::2])
    assert small.semantics[0].shape == small.images[0].shape[:2] == (3, 4)


def test_nearly_rigid_poses_are_made_rigid(capture):
    noise = np.random.default_rng(0).normal(0, 1e-4, (3, 3))
    edit(capture, put("frames", 0, "transform_matrix", POSES[0].astype(np.float32).tolist()))
    scaled = POSES[1].copy()
    scaled[:3, :3] = 0.1 * scaled[:3, :3] @ (np.eye(3) + noise)
    edit(capture, put("frames", 1, "transform_matrix", scaled[:3].tolist()))
    data = load_dataset(capture)
    for pose, truth, tolerance in zip(data.poses, POSES, (1e-6, 1e-3, 0), strict=True):
        np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
        np.testing.assert_allclose(pose, truth, rtol=0, atol=tolerance)


@pytest.mark.parametrize("model", ["OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL"])
def test_camera_models(capture, model):
    assert len(load_dataset(edit(capture, put("camera_model", model)))) == 3


def test_split_by_the_lists_of_the_file(capture):
    def split(**lists):
        return [half.names for half in load_dataset(edit(capture, lambda content: content.update(lists))).split()]

    assert split() == [["b.png", "c.png"], ["a.png"]]
    assert split(val_filenames=["./c.png"]) == [["a.png", "b.png"], ["c.png"]]
    assert split(test_filenames=["b"]) == [["a.png"], ["b.png"]]  # c.png is for validation
    assert split(train_filenames=["a.png", "c.png"]) == [["a.png", "c.png"], ["b.png"]]
    for lists, message in (
        ({"train_filenames": ["b.png"]}, r"b\.png is in 'train_filenames' and held out, too"),
        ({"train_filenames": []}, "0 frames to train on"),
        ({"train_filenames": ["z.png"]}, r"'z\.png', which is not the 'file_path'"),
        ({"train_filenames": [3]}, "must be a path"),
        ({"train_filenames": "a.png"}, "must be a list"),
    ):
        with pytest.raises(DataError, match=message):
            split(**lists)


def test_every_eighth_frame_is_held_out_with_its_layers():
    trajectory = replace(_trajectory(20), meta={"time_stamps": [*range(20)], "refined_covariance": 5})
    train, held_out = Dataset.from_trajectory(trajectory).split()
    assert (
        held_out.meta == {"time_stamps": [0, 8, 16], "refined_covariance": 5} and len(train.meta["time_stamps"]) == 17
    )
    np.testing.assert_array_equal(held_out.images, trajectory.rgb[[0, 8, 16]])
    np.testing.assert_array_equal(held_out.depths, trajectory.depth[[0, 8, 16]])
    np.testing.assert_array_equal(train.poses, np.delete(trajectory.poses, [0, 8, 16], axis=0))
    assert (len(train), len(train.intrinsics), len(train.semantics), train.metric) == (17, 17, 17, True)
    assert len(Dataset.from_trajectory(trajectory).split(2)[1]) == 10
    with pytest.raises(DataError, match="every=2"):
        Dataset.from_trajectory(trajectory).split(1)
