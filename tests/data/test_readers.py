"""Readers of posed images: each reads a small capture that is written here by the specification of its format."""

import json
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

import autonerf_lab as lab
from autonerf_lab.data.dataset import Dataset, load_dataset
from autonerf_lab.data.fisheye import Fisheye, rectify
from autonerf_lab.data.readers import FORMATS, find_format
from autonerf_lab.errors import DataError
from autonerf_lab.geometry import Intrinsics, planar_pose

T, W, H = 4, 16, 12
POSES = np.stack([planar_pose(1 + 0.5 * t, 2 - 0.2 * t, 0.4 * t) for t in range(T)])  # OpenGL, z up
OPENCV = POSES @ np.diag([1.0, -1, -1, 1])
Z_TO_Y_UP = np.array([[0.0, 1, 0, 0], [0, 0, 1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])  # ARKit's world
RGB = np.random.default_rng(0).integers(0, 256, (T, H, W, 3), dtype=np.uint8)
DEPTH = np.random.default_rng(1).integers(500, 4000, (T, H, W)).astype(np.uint16)  # millimetres


def put(path: Path, array: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(array).save(path, quality=100) if path.suffix == ".jpg" else Image.fromarray(array).save(path)


def write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


def rows(matrix: np.ndarray) -> str:
    return "\n".join(" ".join(f"{v:.17g}" for v in row) for row in matrix)


def quaternion(pose: np.ndarray) -> list[float]:
    """Return x y z w."""
    return Rotation.from_matrix(pose[:3, :3]).as_quat().tolist()


def write_tum(folder: Path) -> None:
    lists: dict[str, list[str]] = {"rgb": ["# color images"], "depth": ["# depth maps"], "groundtruth": ["# poses"]}
    for t in range(T):
        put(folder / f"rgb/{t}.png", RGB[t])
        put(folder / f"depth/{t}.png", (DEPTH[t] * 5).astype(np.uint16))
        lists["rgb"].append(f"{100 + t:.4f} rgb/{t}.png")
        lists["depth"].append(f"{100.012 + t:.4f} depth/{t}.png")
        values = [*OPENCV[t, :3, 3], *quaternion(OPENCV[t])]
        lists["groundtruth"].append(f"{99.99 + t:.4f} " + " ".join(f"{v:.12f}" for v in values))
        lists["groundtruth"].append(f"{99.9 + t:.4f} 9 9 9 0 0 0 1")
    put(folder / "rgb/lost.png", RGB[0])
    lists["rgb"].append("500.0 rgb/lost.png")
    for name, lines in lists.items():
        write(folder / f"{name}.txt", "\n".join(lines))
    write(folder / "camera.txt", f"{W} {H} 10 11 7.5 5.5\n")


def write_scannet(folder: Path) -> None:
    k = np.diag([10.0, 11, 1, 1])
    k[:2, 2] = 7.5, 5.5
    write(folder / "intrinsic/intrinsic_color.txt", rows(k))
    write(folder / "intrinsic/intrinsic_depth.txt", rows(k))
    for t in range(T):
        put(folder / f"color/{10 * t}.png", RGB[t])
        put(folder / f"depth/{10 * t}.png", DEPTH[t])
        write(folder / f"pose/{10 * t}.txt", rows(OPENCV[t]))
    put(folder / "color/99.png", RGB[0])
    write(folder / "pose/99.txt", "\n".join(["-inf -inf -inf -inf"] * 4))


def write_replica(folder: Path) -> None:
    for t in range(T):
        put(folder / f"office0/results/frame{t:06d}.png", RGB[t])
        put(folder / f"office0/results/depth{t:06d}.png", (DEPTH[t] * 2).astype(np.uint16))
    write(folder / "office0/traj.txt", "\n".join(" ".join(f"{v:.17g}" for v in pose.ravel()) for pose in OPENCV))
    camera = {"w": W, "h": H, "fx": 10.0, "fy": 11.0, "cx": 7.5, "cy": 5.5, "scale": 2000.0}
    write(folder / "cam_params.json", json.dumps({"camera": camera}))


def write_polycam(folder: Path) -> None:
    for t in range(T):
        put(folder / f"keyframes/corrected_images/{t}.jpg", RGB[t])
        put(folder / f"keyframes/depth/{t}.png", DEPTH[t, ::2, ::2])
        pose = Z_TO_Y_UP @ POSES[t]
        camera = {"fx": 10.0, "fy": 11.0, "cx": 8.0, "cy": 6.0, "width": W, "height": H, "blur_score": 3.5}
        camera |= {f"t_{i}{j}": pose[i, j] for i in range(3) for j in range(4)}
        write(folder / f"keyframes/corrected_cameras/{t}.json", json.dumps(camera))


def write_record3d(folder: Path) -> None:
    world = Z_TO_Y_UP @ POSES
    poses = [[*quaternion(pose), *pose[:3, 3].tolist()] for pose in world]
    for t in range(T):
        put(folder / f"rgb/{t}.png", RGB[t])
    write(folder / "metadata.json", json.dumps({"w": W, "h": H, "K": [10, 0, 0, 0, 11, 0, 8, 6, 1], "poses": poses}))


def world_to_camera(t: int) -> tuple[list[float], list[float]]:
    """Return w x y z and the translation of COLMAP."""
    inverse = np.linalg.inv(OPENCV[t])
    x, y, z, w = quaternion(inverse)
    return [w, x, y, z], inverse[:3, 3].tolist()


def write_colmap_text(folder: Path) -> None:
    write(folder / "sparse/0/cameras.txt", f"# Camera list\n1 PINHOLE {W} {H} 10 11 8 6\n")
    lines = ["# Image list with two lines of data per image:"]
    for t in reversed(range(T)):
        put(folder / f"images/view {t}.png", RGB[t])
        q, p = world_to_camera(t)
        lines += [f"{t + 1} " + " ".join(f"{v:.17g}" for v in [*q, *p]) + f" 1 view {t}.png", "1.5 2.5 -1" if t else ""]
    write(folder / "sparse/0/images.txt", "\n".join(lines) + "\n")


def write_colmap_binary(folder: Path) -> None:
    write_colmap_text(folder)
    for name in ("cameras", "images"):
        (folder / f"sparse/0/{name}.txt").unlink()
    data = struct.pack("<QiiQQ4d", 1, 1, 1, W, H, 10, 11, 8, 6)
    (folder / "sparse/0/cameras.bin").write_bytes(data)
    data = struct.pack("<Q", T)
    for t in range(T):
        q, p = world_to_camera(t)
        data += struct.pack("<i7di", t + 1, *q, *p, 1) + f"view {t}.png\0".encode() + struct.pack("<Q", t)
        data += struct.pack("<ddq", 1.5, 2.5, -1) * t
    (folder / "sparse/0/images.bin").write_bytes(data)


def write_blender(folder: Path) -> None:
    for name, frames in (("train", (0, 1)), ("val", (2,)), ("test", (3,))):
        entries = [{"file_path": f"./{name}/r_{t}", "transform_matrix": POSES[t].tolist()} for t in frames]
        for t in frames:
            put(folder / f"{name}/r_{t}.png", RGB[t])
        angle = 2 * np.arctan(W / 2 / 10)
        write(folder / f"transforms_{name}.json", json.dumps({"camera_angle_x": angle, "frames": entries}))


CAPTURES: dict[str, tuple[Callable[[Path], None], str, str]] = {  # writer, folder of the capture, name of the format
    "tum": (write_tum, ".", "TUM RGB-D"),
    "scannet": (write_scannet, ".", "ScanNet"),
    "replica": (write_replica, "office0", "Replica"),
    "polycam": (write_polycam, ".", "Polycam"),
    "record3d": (write_record3d, ".", "Record3D"),
    "colmap-text": (write_colmap_text, ".", "COLMAP"),
    "colmap-binary": (write_colmap_binary, ".", "COLMAP"),
    "blender": (write_blender, ".", "Blender"),
}


@pytest.mark.parametrize("name", CAPTURES)
def test_a_capture_is_read(tmp_path: Path, name: str) -> None:
    writer, place, form = CAPTURES[name]
    writer(tmp_path)
    found = find_format(tmp_path / place)
    assert found is not None and found.name == form
    data = lab.load_dataset(tmp_path / place)
    np.testing.assert_allclose(data.poses, POSES, atol=1e-9)
    fl_y = 10.0 if name == "blender" else 11.0
    for camera in data.intrinsics:
        np.testing.assert_allclose((camera.fl_x, camera.fl_y, camera.cx, camera.cy), (10, fl_y, 8, 6), atol=1e-6)
        assert (camera.width, camera.height) == (W, H)
    if name != "polycam":  # its images are JPEG
        np.testing.assert_array_equal(data.images, RGB)
    depth = name in ("tum", "scannet", "replica", "polycam")
    assert (data.depths is not None) == depth and data.metric == (depth or name == "record3d")
    if depth and data.depths is not None:
        true = DEPTH[:, ::2, ::2].repeat(2, axis=1).repeat(2, axis=2) if name == "polycam" else DEPTH
        np.testing.assert_allclose(data.depths, true / 1000, atol=1e-6)
    train, held_out = data.split(every=2)
    assert (len(train), len(held_out)) == ((2, 1) if name == "blender" else (2, 2))
    if name in ("tum", "scannet"):
        assert data.meta["left_out"] == 1


def test_every_format_is_tested() -> None:
    assert {form.name for form in FORMATS} == {entry[2] for entry in CAPTURES.values()} | {"nerfstudio"}


def test_a_folder_without_poses_says_what_was_looked_for_and_found(tmp_path: Path) -> None:
    put(tmp_path / "IMG_1.png", RGB[0])
    with pytest.raises(DataError, match=r"looked for transforms\.json .*COLMAP\); found IMG_1\.png"):
        load_dataset(tmp_path)


def change(path: str, old: str, new: str) -> Callable[[Path], None]:
    def edit(folder: Path) -> None:
        text = (folder / path).read_text()
        assert old in text
        (folder / path).write_text(text.replace(old, new, 1))

    return edit


@pytest.mark.parametrize(
    ("name", "edit", "message"),
    [
        ("tum", change("rgb.txt", "rgb/0.png", "../0.png"), r"rgb\.txt: line 2: 'rgb\.txt' is outside"),
        ("tum", change("rgb.txt", "rgb/0.png", "rgb/gone.png"), r"line 2: 'rgb/gone\.png' does not exist"),
        ("tum", change("rgb.txt", "rgb/0.png", "x" * 5000), r"line 2: 'x+' does not exist"),
        ("tum", change("groundtruth.txt", "0 0 0 1", "0 0 1 1"), r"groundtruth\.txt: line 3: .*not a unit quaternion"),
        ("tum", change("groundtruth.txt", "9 9 9", "9 nan 9"), r"line 3 must have 8 finite numbers"),
        ("tum", lambda folder: write(folder / "groundtruth.txt", "1 0 0 0 0 0 0 1"), r"no image of rgb\.txt has a"),
        ("scannet", change("pose/0.txt", "0", "x"), r"pose/0\.txt must have 4 rows of 4 numbers"),
        ("scannet", lambda folder: (folder / "depth/10.png").unlink(), r"depth/10\.png does not exist"),
        ("replica", lambda folder: (folder / "office0/results/frame000001.png").unlink(), r"frame000001\.jpg does not"),
        ("replica", change("cam_params.json", "2000.0", "0"), r"cam_params\.json: w, h, fx, fy and scale must be"),
        ("polycam", change("keyframes/corrected_cameras/1.json", '"fx": 10.0', '"fx": "x"'), r"1\.json: 'fx' must be"),
        ("polycam", lambda folder: (folder / "keyframes/depth/2.png").unlink(), r"depth/2\.png does not exist, but"),
        ("record3d", lambda folder: (folder / "rgb/3.png").unlink(), r"has 4 poses, but rgb/ has 3 images"),
        ("colmap-text", change("sparse/0/cameras.txt", "PINHOLE", "FOV"), r"line 2: the camera model 'FOV' is not one"),
        ("colmap-text", change("sparse/0/cameras.txt", "1 PINHOLE", "2 PINHOLE"), r"has the camera 1, which does not"),
        ("colmap-text", change("sparse/0/images.txt", "view 3", "x" * 5000), r"x+\.png does not exist; put the phot"),
        ("colmap-text", change("sparse/0/images.txt", "view 3", "../view 3"), r"is outside the folder"),
        ("colmap-text", lambda folder: (folder / "images/view 2.png").unlink(), r"view 2\.png does not exist; put"),
        ("blender", lambda folder: (folder / "val/r_2.png").unlink(), r"transforms_val\.json: '.*r_2' does not"),
    ],
)  # fmt: skip
def test_damaged_captures_are_refused(tmp_path: Path, name: str, edit: Callable[[Path], None], message: str) -> None:
    writer, place, _ = CAPTURES[name]
    writer(tmp_path)
    edit(tmp_path)
    with pytest.raises(DataError, match=message):
        load_dataset(tmp_path / place)


def test_every_cut_of_a_binary_model_is_refused(tmp_path: Path) -> None:
    write_colmap_binary(tmp_path)
    for name in ("cameras.bin", "images.bin"):
        data = (tmp_path / "sparse/0" / name).read_bytes()
        for length in range(0, len(data), 5):
            (tmp_path / "sparse/0" / name).write_bytes(data[:length])
            with pytest.raises(DataError, match=rf"{name} is"):
                load_dataset(tmp_path)
        (tmp_path / "sparse/0" / name).write_bytes(data)


def test_a_mirrored_pose_is_refused(tmp_path: Path) -> None:
    write_replica(tmp_path)
    mirrored = OPENCV[1] @ np.diag([-1.0, 1, 1, 1])
    lines = (tmp_path / "office0/traj.txt").read_text().splitlines()
    lines[1] = " ".join(f"{v:.17g}" for v in mirrored.ravel())
    write(tmp_path / "office0/traj.txt", "\n".join(lines))
    with pytest.raises(DataError, match=r"traj\.txt: line 2: .*is mirrored"):
        load_dataset(tmp_path / "office0")


def test_depth_of_another_camera_is_looked_up_by_its_rays(tmp_path: Path) -> None:
    """The depth camera of ScanNet has another aspect ratio and half the focal length: 8 x 8 pixels."""
    write_scannet(tmp_path)
    k = np.diag([5.0, 5.5, 1, 1])
    k[:2, 2] = 3.5, 3.5
    write(tmp_path / "intrinsic/intrinsic_depth.txt", rows(k))
    for t in range(T):
        put(tmp_path / f"depth/{10 * t}.png", DEPTH[t, :8, :8])
    depths = load_dataset(tmp_path).depths
    assert depths is not None
    # pixel (column, row) of the image sees pixel (column / 2, row / 2 + 1) of the depth camera
    expected = DEPTH[2, :8, :8][np.arange(H)[:, None] // 2 + 1, np.arange(W) // 2] / 1000
    np.testing.assert_allclose(depths[2], expected, atol=1e-6)


def test_masks_are_honoured(tmp_path: Path) -> None:
    write_colmap_text(tmp_path)
    mask = np.zeros((H, W), np.uint8)
    mask[:, :5] = 255
    put(tmp_path / "masks/view 1.png.png", mask)
    data = load_dataset(tmp_path)
    assert data.masks is not None
    np.testing.assert_array_equal(data.masks[1], mask > 0)
    assert data.masks[0].all() and data.split(every=2)[0].masks is not None


def test_a_frame_without_a_mask_is_used_as_a_whole(tmp_path: Path) -> None:
    mask = np.zeros((H, W), np.uint8)
    mask[:, :5] = 255
    put(tmp_path / "mask.png", mask)
    frames: list[dict] = [{"file_path": f"{t}.png", "transform_matrix": POSES[t].tolist()} for t in range(T)]
    for t in range(T):
        put(tmp_path / f"{t}.png", RGB[t])
    frames[1]["mask_path"] = frames[2]["mask_path"] = "mask.png"
    write(tmp_path / "transforms.json", json.dumps({"fl_x": 10, "frames": frames}))
    data = load_dataset(tmp_path)
    assert data.masks is not None and [int(used.sum()) for used in data.masks] == [W * H, 5 * H, 5 * H, W * H]
    frames[3]["mask_path"] = "gone.png"
    write(tmp_path / "transforms.json", json.dumps({"fl_x": 10, "frames": frames}))
    with pytest.raises(DataError, match=r"'gone\.png' does not exist, and 1 of 3 files of 'mask_path' are missing"):
        load_dataset(tmp_path)


def test_split_files_keep_their_masks_and_lenses(tmp_path: Path) -> None:
    write_blender(tmp_path)
    mask = np.zeros((H, W), np.uint8)
    mask[:, :5] = 255
    put(tmp_path / "mask.png", mask)
    changes: dict[str, dict] = {"train": {"mask_path": "mask.png"}, "test": {"is_fisheye": True, "k1": 0.3}}
    for name, keys in changes.items():
        content = json.loads((tmp_path / f"transforms_{name}.json").read_text())
        for frame in content["frames"]:
            frame.update(keys)
        write(tmp_path / f"transforms_{name}.json", json.dumps(content))
    data = load_dataset(tmp_path)
    expected, inside = rectify(RGB[3], data.intrinsics[3], Fisheye(0.3))
    assert data.masks is not None
    for used, want in zip(data.masks, (mask > 0, mask > 0, mask >= 0, inside), strict=True):
        np.testing.assert_array_equal(used, want)
    np.testing.assert_array_equal(data.images[3], expected)
    np.testing.assert_array_equal(data.images[2], RGB[2])


def test_split_files_keep_all_true_poses(tmp_path: Path) -> None:
    """A noisy trajectory in several files: each frame has its estimate and its true pose."""
    write_blender(tmp_path)
    for name, frames in (("train", (0, 1)), ("val", (2,)), ("test", (3,))):
        file = tmp_path / f"transforms_{name}.json"
        true = {"true": [POSES[3 - t].tolist() for t in frames]}
        own = {"autonerf_lab": {"version": 1, "pose_source": "odometry", "other_poses": true}}
        write(file, json.dumps(json.loads(file.read_text()) | own))
    data = load_dataset(tmp_path)
    assert data.pose_source == "odometry"
    assert data.true_poses is not None
    np.testing.assert_allclose(data.true_poses, POSES[::-1])
    change("transforms_test.json", "odometry", "refined")(tmp_path)
    with pytest.raises(DataError, match=r"transforms_test\.json has poses of the source 'refined', but .* 'odometry'"):
        load_dataset(tmp_path)


def test_only_unmasked_pixels_are_sampled_and_scored() -> None:
    from autonerf_lab.evaluators.rendering import evaluate_rendering, photographed_views, psnr
    from autonerf_lab.nerf.field_frame import FieldFrame
    from autonerf_lab.nerf.pixel_sampler import PixelSampler
    from autonerf_lab.types import Rendering

    camera = Intrinsics.from_fov(W, H)
    labels = [np.arange(H * W, dtype=np.uint8).reshape(H, W) % 3] * T
    masks = [np.random.default_rng(t).random((H, W)) < 0.3 for t in range(T)]
    data = Dataset(POSES, list(RGB), [camera] * T, labels, None, [str(t) for t in range(T)], {}, True, masks)
    sampler = PixelSampler(data, FieldFrame(), by_class=0.5, by_contrast=0.3)
    pixels = sampler.sample(4000, np.random.default_rng(0))
    assert np.concatenate([mask.ravel() for mask in masks])[pixels].all()

    class Grey:
        def render(self, c2w: np.ndarray, intrinsics: Intrinsics) -> Rendering:
            return Rendering(np.full((H, W, 3), 0.5, np.float32), np.ones((H, W), np.float32), None, np.ones((H, W)))

    result = evaluate_rendering(Grey(), photographed_views(data))  # type: ignore[arg-type]
    expected = [psnr(np.full((n := mask.sum(), 3), 0.5), rgb[mask] / 255) for mask, rgb in zip(masks, RGB, strict=True)]
    assert n and np.allclose(result.artifact["psnr"], expected, atol=1e-4)


def test_a_fisheye_is_rectified_by_opencvs_model() -> None:
    """Colour of a pixel = direction of its ray; after rectification it is the direction of the pinhole camera."""
    camera, lens = Intrinsics(60, 40, 30.0, 28.0, 31.0, 19.0), Fisheye(0.05, -0.02, 0.003, -0.001)
    u, v = np.meshgrid(np.arange(60) + 0.5, np.arange(40) + 0.5)
    x, y = (u - camera.cx) / camera.fl_x, (v - camera.cy) / camera.fl_y
    radius = np.hypot(x, y)
    angles = np.linspace(0, 1.5, 20001)
    angle = np.interp(radius, lens.radius(angles), angles)
    sight = np.stack([x, y], axis=-1) * (np.tan(angle) / np.maximum(radius, 1e-9))[..., None]
    image = np.clip(128 + 60 * np.dstack([sight, 0 * x]), 0, 255).round().astype(np.uint8)
    seen, inside = rectify(image, camera, lens)
    expected = 128 + 60 * np.dstack([x, y])
    middle = inside & (radius < 0.9)
    assert middle.sum() > 1000 and np.abs(seen[..., :2] - expected)[middle].max() < 1.6
    assert np.abs(image[..., :2] - expected)[middle].max() > 5  # the lens does matter


def test_fisheye_cameras_are_recognised(tmp_path: Path) -> None:
    write_colmap_text(tmp_path)
    change("sparse/0/cameras.txt", f"PINHOLE {W} {H} 10 11 8 6", f"OPENCV_FISHEYE {W} {H} 10 11 8 6 0.1 0 0 0")(
        tmp_path
    )
    data = load_dataset(tmp_path)
    assert data.masks is not None and not any(data.intrinsics[0].lens)
    expected, inside = rectify(RGB[1], data.intrinsics[1], Fisheye(0.1))
    np.testing.assert_array_equal(data.images[1], expected)
    np.testing.assert_array_equal(data.masks[1], inside)
    frames = [{"file_path": f"images/view {t}.png", "transform_matrix": POSES[t].tolist()} for t in range(T)]
    top = {"camera_model": "OPENCV_FISHEYE", "w": W, "h": H, "fl_x": 10, "fl_y": 11, "cx": 8, "cy": 6, "k1": 0.1}
    write(tmp_path / "transforms.json", json.dumps({**top, "frames": frames}))
    np.testing.assert_array_equal(load_dataset(tmp_path).images[1], expected)
