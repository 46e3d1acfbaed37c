"""Invalid input of :func:`load_dataset`: always a DataError that names the file or the frame."""

import copy
import json
import random
import warnings
import zlib

import numpy as np
import pytest
from PIL import Image
from toy_capture import POSES, edit, make, put

from autonerf_lab.data.dataset import load_dataset
from autonerf_lab.errors import DataError


@pytest.fixture
def capture(tmp_path):
    return make(tmp_path / "capture")


SHEARED = [[1, 0.1, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
MIRRORED = [[-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (put("frames", []), "at least one frame"),
        (put("frames", {"0": 1}), "at least one frame"),
        (put("frames", 0, 7), "JSON object"),
        (lambda content: content["frames"].__delitem__(slice(1, None)), "two different poses"),
        (lambda content: [f.update(transform_matrix=POSES[0].tolist()) for f in content["frames"]], "different poses"),
        (put("frames", 1, "transform_matrix", SHEARED), "frame 1: .*not a rigid"),
        (put("frames", 1, "transform_matrix", MIRRORED), "frame 1: .*mirrored"),
        (put("frames", 1, "transform_matrix", np.zeros((3, 4)).tolist()), "frame 1: .*not a rigid"),
        (put("frames", 1, "transform_matrix", np.eye(3).tolist()), "3 or 4 rows of 4"),
        (put("frames", 1, "transform_matrix", POSES[1].T.tolist()), "frame 1: .*transposed"),
        (put("frames", 1, "transform_matrix", 0, 3, float("nan")), "not readable JSON"),
        (put("frames", 1, "transform_matrix", 0, 3, 10**400), "frame 1: .*finite number"),
        (put("frames", 1, "transform_matrix", 0, 3, "0"), "frame 1: .*finite number"),
        (put("frames", 1, "transform_matrix", None), "3 or 4 rows of 4"),
        (put("frames", 0, "file_path", "../capture/a.png"), "frame 0: .*is outside the folder"),
        (put("frames", 0, "file_path", "..\\capture\\a.png"), "frame 0: .*is outside the folder"),
        (put("frames", 0, "file_path", "/etc/passwd"), "frame 0: .*is outside the folder"),
        (put("frames", 0, "file_path", "C:\\a.png"), "frame 0: .*is outside the folder"),
        (put("frames", 0, "file_path", ["a.png"]), "frame 0: .*must be a path"),
        (put("frames", 0, "file_path", "a\0.png"), "frame 0: .*must be a path"),
        (put("frames", 0, "file_path", "x" * 5000), "does not exist"),
        (put("frames", 0, "file_path", "no.png"), "'no.png' does not exist, and 1 of 3"),
        (put("frames", 0, "file_path", "./b.png"), "frames 0 and 1 share"),
        (put("frames", 0, "file_path", "b"), "frames 0 and 1 share"),
        (put("frames", 1, "w", 9), "b.png has 12x8 pixels"),
        (put("w", 8.5), "whole number"),
        (put("w", 10**6), "whole number"),
        (put("h", None), "'h' must be"),
        (put("fl_x", 0), "must be positive"),
        (put("fl_x", -3.0), "must be positive"),
        (put("fl_x", 1e8), "do not go with 12x8"),
        (put("fl_x", 1e-3), "do not go with 12x8"),
        (put("fl_x", True), "finite number"),
        (put("cx", 1e5), "far outside"),
        (put("k1", "0.1"), "'k1' must be a finite number"),
        (put("k4", 0.01), "'k4' is not zero.*undistort"),
        (put("camera_model", "EQUIRECTANGULAR"), "'EQUIRECTANGULAR' is not one of.*undistort"),
        (put("frames", 2, "camera_model", "EQUIRECTANGULAR"), "frame 2: .*'EQUIRECTANGULAR'"),
        (put("camera_model", ["OPENCV"]), "is not one of"),
        (put("frames", 2, "camera_angle_x", 4.0), "frame 2: .*between 0 and pi"),
        (lambda content: (content.pop("fl_x"), content.pop("fl_y")), "add 'fl_x' in pixels or 'camera_angle_x'"),
        (put("autonerf_lab", []), "must be a JSON object"),
        (put("autonerf_lab", {"version": 99}), "format version"),
    ],
)
def test_bad_json_is_named(capture, change, message):
    edit(capture, change)
    with pytest.raises(DataError, match=message):
        load_dataset(capture)


def test_missing_images_are_counted(capture):
    (capture / "a.png").unlink()
    (capture / "c.png").unlink()
    with pytest.raises(DataError, match=r"'a\.png' does not exist, and 2 of 3 files of 'file_path' are missing"):
        load_dataset(capture)


def test_a_path_that_is_no_folder_and_no_json_file_is_named(capture):
    with pytest.raises(DataError, match=r"a\.png is no JSON file; give a folder"):
        load_dataset(capture / "a.png")
    with pytest.raises(DataError, match=r"gone does not exist; give a folder"):
        load_dataset(capture / "gone")


@pytest.mark.parametrize("damage", ["truncated", "text", "empty", "flipped"])
def test_a_damaged_image_is_named(capture, damage):
    file = capture / "b.png"
    data = file.read_bytes()
    flipped = data[:60] + bytes(255 - b for b in data[60:70]) + data[70:]
    file.write_bytes({"truncated": data[: len(data) // 2], "text": b"hello", "empty": b"", "flipped": flipped}[damage])
    with pytest.raises(DataError, match=r"b\.png"):
        load_dataset(capture)


@pytest.mark.parametrize("side", [10000, 30000])
def test_a_decompression_bomb_is_refused_by_its_header(capture, side):
    """Pillow warns about the smaller one and raises for the larger one; both are refused."""
    data = bytearray((capture / "a.png").read_bytes())
    data[16:24] = side.to_bytes(4, "big") * 2
    data[29:33] = zlib.crc32(data[12:29]).to_bytes(4, "big")
    (capture / "a.png").write_bytes(bytes(data))
    edit(capture, put("frames", 0, "w", 8))
    with pytest.raises(DataError, match=r"a\.png has too many pixels"):
        load_dataset(capture)


JUNK = [None, True, 0, -1, 1e-320, 1e308, 10**30, float("nan"), float("inf"), "", "a.png", "..", "\ud800", [], {}, [[]]]


def _mutate(value, rng):
    """Replace, remove or duplicate a random value."""
    holders = [value]
    for holder in holders:
        children = holder.values() if isinstance(holder, dict) else holder
        holders += [child for child in children if isinstance(child, dict | list) and child]
    holder = rng.choice(holders)
    key = rng.choice(list(holder) if isinstance(holder, dict) else range(len(holder)))
    kind = rng.randrange(4)
    if kind == 0:
        del holder[key]
    elif kind == 1 and isinstance(holder, list):
        holder.insert(key, copy.deepcopy(holder[key]))
    elif kind == 2 and isinstance(holder[key], float | int):
        holder[key] *= rng.choice([-1, 2, 1.01, 1e3, 1e-3])
    else:
        holder[key] = copy.deepcopy(rng.choice(JUNK))


def test_mutated_files_raise_nothing_but_data_error(capture):
    valid = json.loads((capture / "transforms.json").read_text())
    valid |= {"k1": 0.1, "k4": 0, "camera_model": "OPENCV", "train_filenames": ["a.png"], "is_fisheye": False}
    valid["frames"][1] |= {"camera_angle_x": 1.0, "w": 12, "h": 8}
    for frame in valid["frames"]:
        frame |= {"depth_file_path": "d/" + frame["file_path"], "semantics_file_path": "s/" + frame["file_path"]}
    for kind, dtype in (("d", np.uint16), ("s", np.uint8)):
        (capture / kind).mkdir()
        for name in "abc":
            Image.fromarray(np.ones((8, 12), dtype)).save(capture / kind / f"{name}.png")
    rng, outcomes = random.Random(0), {True: 0, False: 0}
    for _ in range(500):
        content = copy.deepcopy(valid)
        for _ in range(rng.choice([1, 1, 2])):
            _mutate(content, rng)
        (capture / "transforms.json").write_text(json.dumps(content))
        try:
            data = load_dataset(capture)
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", "the lens distortion cannot be inverted")
                assert all(np.isfinite(camera.directions()).all() for camera in data.intrinsics)
            data.split()
            outcomes[True] += 1
        except DataError as error:
            assert str(capture) in str(error) or "filenames" in str(error) or "held out" in str(error)
            outcomes[False] += 1
    assert min(outcomes.values()) > 50


@pytest.mark.parametrize("text", ["", "[]", "{", "null", '{"frames": [' + "[" * 100000, '{"w": ' + "9" * 5000 + "}"])
def test_invalid_json_is_named(capture, text):
    (capture / "transforms.json").write_text(text)
    with pytest.raises(DataError, match=r"transforms\.json"):
        load_dataset(capture)
