"""Saving and loading of trajectories."""

import json
import zlib

import numpy as np
import pytest

from autonerf_lab.data.trajectory import Trajectory, load_trajectory
from autonerf_lab.errors import DataError
from autonerf_lab.geometry import Intrinsics, planar_pose


def _trajectory(frames: int = 3) -> Trajectory:
    rng = np.random.default_rng(0)
    return Trajectory(
        np.stack([planar_pose(t, 2 * t, 0.5 * t) for t in range(frames)]),
        rng.integers(0, 256, (frames, 6, 8, 3), dtype=np.uint8),
        rng.integers(0, 9000, (frames, 6, 8)).astype(np.float32) / np.float32(1000),
        rng.integers(0, 16, (frames, 6, 8), dtype=np.uint8),
        Intrinsics.from_fov(8, 6),
        {"scene": "toy", "actions": [0, 1, 2]},
    )


@pytest.fixture
def folder(tmp_path):
    _trajectory().save(tmp_path / "trajectory")
    return tmp_path / "trajectory"


def _edit(folder, change):
    content = json.loads((folder / "transforms.json").read_text())
    change(content)
    (folder / "transforms.json").write_text(json.dumps(content))


def test_save_and_load(folder):
    trajectory, again = _trajectory(), load_trajectory(folder)
    for name in ("poses", "rgb", "depth", "semantics"):
        np.testing.assert_array_equal(getattr(again, name), getattr(trajectory, name))
        assert getattr(again, name).dtype == getattr(trajectory, name).dtype
    assert again.intrinsics == trajectory.intrinsics
    assert again.meta == trajectory.meta
    assert len(again) == 3
    assert repr(again).split("\n")[1] == "  3 frames of 8x6 pixels; layers: rgb, depth, semantics"


def test_folder_is_a_nerfstudio_dataset(folder):
    content = json.loads((folder / "transforms.json").read_text())
    assert content["camera_model"] == "OPENCV"
    assert (content["w"], content["h"], content["fl_x"], content["cx"]) == (8, 6, 4.0, 4.0)
    assert content["frames"][1]["file_path"] == "images/frame_00001.png"
    assert content["frames"][1]["depth_file_path"] == "depth/frame_00001.png"
    assert np.array(content["frames"][1]["transform_matrix"])[:2, 3].tolist() == [1, 2]
    assert all((folder / frame["semantics_file_path"]).exists() for frame in content["frames"])


def test_depth_is_rounded_to_millimetres_and_distant_depth_is_none(tmp_path):
    trajectory = _trajectory(1)
    depth = np.zeros((1, 6, 8), np.float32)
    depth[0, 0, :3] = 1.2344, 1.2346, 70.0
    Trajectory(trajectory.poses, trajectory.rgb, depth, None, trajectory.intrinsics).save(tmp_path)
    again = load_trajectory(tmp_path)
    assert again.depth is not None
    np.testing.assert_allclose(again.depth[0, 0, :4], [1.234, 1.235, 0, 0], rtol=0, atol=1e-6)
    assert again.semantics is None


def test_saving_again_leaves_no_old_frame(folder):
    _trajectory(2).save(folder)
    assert len(list((folder / "images").iterdir())) == 2
    assert len(load_trajectory(folder)) == 2


def test_every_frame_is_complete_or_absent(tmp_path, monkeypatch):
    class Killed(BaseException):
        pass

    def kill(*_):
        raise Killed

    with monkeypatch.context() as patch, pytest.raises(Killed):
        patch.setattr("os.replace", kill)
        _trajectory(1).save(tmp_path)
    assert not list(tmp_path.rglob("frame_*")) and list((tmp_path / "images").iterdir())  # a temporary file is left
    _trajectory(1).save(tmp_path)
    names = [f"{layer}/frame_00000.png" for layer in ("depth", "images", "semantics")]
    found = sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file())
    assert found == [*names, "transforms.json"]


def test_unfinished_save_is_not_a_trajectory(folder, monkeypatch):
    def full(*_):
        raise DataError("disk full")

    monkeypatch.setattr("autonerf_lab.data.trajectory._write_frame", full)
    with pytest.raises(DataError, match="disk full"):
        _trajectory().save(folder)
    with pytest.raises(DataError, match=r"transforms\.json does not exist"):
        load_trajectory(folder)


def test_inconsistent_arrays_are_refused(tmp_path):
    trajectory = _trajectory()
    with pytest.raises(DataError, match=r"trajectory\.rgb has the shape"):
        Trajectory(trajectory.poses, trajectory.rgb[:2], None, None, trajectory.intrinsics).save(tmp_path)
    with pytest.raises(DataError, match="without frames"):
        Trajectory(trajectory.poses[:0], trajectory.rgb[:0], None, None, trajectory.intrinsics).save(tmp_path)


def _set(*keys_and_value):
    *keys, last, value = keys_and_value

    def change(content):
        for key in keys:
            content = content[key]
        content[last] = value

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_set("frames", []), "at least one frame"),
        (_set("frames", 3), "at least one frame"),
        (_set("frames", 0, 7), "JSON object"),
        (_set("frames", 1, "transform_matrix", [[1, 2], [3]]), "4 rows of 4"),
        (_set("frames", 1, "transform_matrix", 0, 0, float("nan")), "not readable JSON"),
        (_set("frames", 1, "transform_matrix", 0, 0, 10**400), "finite number"),
        (_set("frames", 1, "transform_matrix", 0, 0, "1"), "finite number"),
        (_set("frames", 1, "transform_matrix", 0, 0, 3.0), "not a rigid"),
        (_set("frames", 0, "file_path", "../../etc/passwd"), "is outside the folder"),
        (_set("frames", 0, "file_path", "/etc/passwd"), "is outside the folder"),
        (_set("frames", 0, "file_path", None), "must be a path"),
        (_set("frames", 0, "file_path", "images/frame_00001.png"), "frames 0 and 1 share"),
        (_set("frames", 0, "depth_file_path", None), "must be a path"),
        (_set("w", 8.5), "whole number"),
        (_set("w", 16), "pixels"),
        (_set("h", 10**6), "whole number"),
        (_set("fl_x", 0), "positive"),
        (_set("k1", 0.1), "distortion"),
        (_set("autonerf_lab", []), "must be a JSON object"),
        (_set("autonerf_lab", "version", 99), "format version"),
    ],
)
def test_bad_json_is_named(folder, change, message):
    _edit(folder, change)
    with pytest.raises(DataError, match=message):
        load_trajectory(folder)


@pytest.mark.parametrize("name", ["images/frame_00001.png", "depth/frame_00000.png", "semantics/frame_00002.png"])
@pytest.mark.parametrize("damage", ["missing", "truncated", "text", "flipped"])
def test_bad_image_is_named(folder, name, damage):
    file = folder / name
    data = file.read_bytes()
    if damage == "missing":
        file.unlink()
    elif damage == "truncated":
        file.write_bytes(data[: len(data) // 2])
    elif damage == "flipped":
        file.write_bytes(data[:60] + bytes(255 - b for b in data[60:70]) + data[70:])
    else:
        file.write_bytes(b"hello")
    with pytest.raises(DataError, match=name):
        load_trajectory(folder)


def test_a_decompression_bomb_is_refused_by_its_header(folder):
    data = bytearray((folder / "images/frame_00000.png").read_bytes())
    data[16:24] = (30000).to_bytes(4, "big") * 2
    data[29:33] = zlib.crc32(data[12:29]).to_bytes(4, "big")
    (folder / "images/frame_00000.png").write_bytes(bytes(data))
    with pytest.raises(DataError, match="too many pixels"):
        load_trajectory(folder)
    with pytest.raises(DataError, match="max_bytes"):
        load_trajectory(folder, max_bytes=100)


def test_class_out_of_range_is_named(folder):
    from PIL import Image

    Image.fromarray(np.full((6, 8), 16, np.uint8)).save(folder / "semantics/frame_00000.png")
    with pytest.raises(DataError, match="class 16"):
        load_trajectory(folder)
