"""Saving and loading of trajectories."""

import json
import zlib
from dataclasses import replace

import numpy as np
import pytest

from autonerf_lab.data.dataset import Dataset, load_dataset
from autonerf_lab.data.trajectory import Trajectory, load_trajectory
from autonerf_lab.errors import DataError, UnknownNameError
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


def test_depth_is_rounded_to_millimetres_and_depth_that_is_distant_or_no_distance_is_none(tmp_path):
    trajectory = _trajectory(1)
    depth = np.zeros((1, 6, 8), np.float32)
    depth[0, 0, :7] = 1.2344, 1.2346, 70.0, -1.0, np.inf, -np.inf, np.nan
    noisy = Trajectory(trajectory.poses, trajectory.rgb, depth, None, trajectory.intrinsics)
    noisy.save(tmp_path)
    for cleaned in (
        noisy.depth,
        Dataset.from_trajectory(noisy).depths,
        replace(Dataset.from_trajectory(trajectory), depths=list(depth)).depths,
    ):
        np.testing.assert_equal(cleaned[0][0, :7], np.float32([1.2344, 1.2346, 70, 0, 0, 0, 0]))
    assert np.isnan(depth[0, 0, 6]), "the given array stays"
    again = load_trajectory(tmp_path)
    assert again.depth is not None
    np.testing.assert_allclose(again.depth[0, 0, :7], [1.234, 1.235, 0, 0, 0, 0, 0], rtol=0, atol=1e-6)
    assert again.semantics is None


def test_saving_again_leaves_no_old_frame(folder):
    _trajectory(2).save(folder)
    assert len(list((folder / "images").iterdir())) == 2
    assert len(load_trajectory(folder)) == 2


def test_photographs_are_not_replaced_by_a_trajectory(tmp_path):
    """Nerfstudio names the images of its data sets like those of a trajectory."""
    photo = tmp_path / "images/frame_00001.png"
    photo.parent.mkdir()
    photo.touch()
    (tmp_path / "transforms.json").write_text('{"frames": []}')
    with pytest.raises(DataError, match="holds another data set; choose another folder"):
        _trajectory().save(tmp_path)
    assert photo.exists()


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


def _noisy() -> Trajectory:
    """Odometry with true poses beside them, which are 1 m farther along x."""
    trajectory = _trajectory()
    shifted = trajectory.poses.copy()
    shifted[:, 0, 3] += 1.0
    return replace(trajectory, pose_source="odometry", other_poses={"true": shifted})


def test_another_pose_source_becomes_active():
    odometry = _noisy()
    true = odometry.with_poses("true")
    assert (true.poses - odometry.poses)[:, 0, 3].tolist() == [1.0] * 3
    assert (true.pose_source, list(true.pose_sources)) == ("true", ["true", "odometry"])
    estimated = true.with_poses("estimated", true.poses + 0.0)
    assert list(estimated.pose_sources) == ["true", "odometry", "estimated"]
    np.testing.assert_array_equal(estimated.with_poses("odometry").poses, odometry.poses)
    assert estimated.rgb is odometry.rgb
    assert repr(estimated).endswith("; poses: estimated")


def test_pose_sources_that_do_not_exist_are_refused():
    with pytest.raises(DataError, match="there are no 'refined' poses, only true, odometry"):
        _noisy().with_poses("refined")
    with pytest.raises(UnknownNameError, match="unknown pose source 'estimate'; valid names: estimated"):
        _noisy().with_poses("estimate", np.eye(4)[None])
    with pytest.raises(DataError, match="one pose for each frame"):
        _noisy().with_poses("refined", np.eye(4)[None])
    with pytest.raises(DataError, match=r"other_poses\['true'\] has the shape"):
        replace(_noisy(), other_poses={"true": np.eye(4)[None]}).save("/nowhere")


def test_pose_sources_are_saved_and_loaded(tmp_path):
    trajectory = _noisy().with_poses("estimated", _noisy().poses)
    trajectory.save(tmp_path)
    again = load_trajectory(tmp_path)
    assert (again.pose_source, again.meta) == ("estimated", trajectory.meta)
    assert again.other_poses.keys() == {"true", "odometry"}
    for name, poses in trajectory.pose_sources.items():
        np.testing.assert_array_equal(again.pose_sources[name], poses)
    dataset = load_dataset(tmp_path)
    assert (dataset.pose_source, dataset.meta) == ("estimated", trajectory.meta)
    np.testing.assert_array_equal(dataset.true_poses, trajectory.other_poses["true"])
    train, held_out = dataset.split(2)
    np.testing.assert_array_equal(train.true_poses, dataset.true_poses[1:2])
    np.testing.assert_array_equal(held_out.true_poses, dataset.true_poses[::2])


def test_a_trajectory_of_release_0_1_has_its_true_poses(folder):
    rows = [[t, 2.0 * t, 0.5 * t] for t in range(3)]
    _edit(folder, lambda content: content["autonerf_lab"].update(true_poses=rows))
    again = load_trajectory(folder)
    assert again.pose_source == "odometry" and "true_poses" not in again.meta
    np.testing.assert_allclose(again.other_poses["true"], _trajectory().poses)


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"pose_source": "gps"}, "must be one of true, odometry, estimated, refined, not 'gps'"),
        ({"pose_source": ["true"]}, "'pose_source' must be one of"),
        ({"other_poses": []}, "'other_poses' must be a JSON object"),
        ({"other_poses": {"true": []}}, "'true', which is not another pose source"),
        ({"other_poses": {"refined": [[]]}}, "must be a list of 3 poses"),
        ({"other_poses": {"refined": [[[0] * 4] * 4] * 3}}, "frame 0.*is not a rigid"),
        ({"true_poses": [[0, 0, 0]]}, "must be 3 rows of x, y and heading"),
        ({"true_poses": [["a", 0, 0]] * 3}, "must be 3 rows of x, y and heading"),
    ],
)
def test_pose_sources_that_are_not_valid(folder, entries, message):
    _edit(folder, lambda content: content["autonerf_lab"].update(entries))
    with pytest.raises(DataError, match=message):
        load_trajectory(folder)
