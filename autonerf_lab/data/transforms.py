"""The words of a ``transforms.json``, and what is refused in one: shared by all who read it.

Each function is given ``where``, the file and frame that its error names.
"""

from pathlib import PurePosixPath, PureWindowsPath
from typing import Any

import numpy as np

from autonerf_lab.errors import DataError
from autonerf_lab.geometry import Intrinsics

FORMAT_VERSION = 1
MAX_SIDE = 16384  # pixels
_MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
_LENS = ("k1", "k2", "k3", "p1", "p2")
_BEYOND = ("k4", "k5", "k6")  # of OpenCV's rational model, or of a fisheye
_FOCAL_X, _FOCAL_Y = ("fl_x", "camera_angle_x"), ("fl_y", "camera_angle_y")
_UNDISTORT = "undistort the images first, for example with COLMAP's image_undistorter"

CAMERA_KEYS = {"camera_model", "is_fisheye", "w", "h", "cx", "cy", *_FOCAL_X, *_FOCAL_Y, *_LENS, *_BEYOND}


def number(value: object, name: str, where: object) -> float:
    """A finite number below 1e9.

    Example:
        >>> number("1", "cx", "a.json")
        Traceback (most recent call last):
        autonerf_lab.errors.DataError: a.json: 'cx' must be a finite number, not '1'
    """
    # Python prints no integer of more than 4300 digits
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e9:
        shown = "a huge integer" if isinstance(value, int) and abs(value) >= 1e9 else repr(str(value)[:40])
        raise DataError(f"{where}: {name!r} must be a finite number, not {shown}")
    return float(value)


def side(value: object, name: str, where: object) -> int:
    """A number of pixels, 1 to :data:`MAX_SIDE`."""
    pixels = number(value, name, where)
    if pixels != int(pixels) or not 1 <= pixels <= MAX_SIDE:
        raise DataError(f"{where}: {name!r} must be a whole number between 1 and {MAX_SIDE}")
    return int(pixels)


def read_frames(content: dict, where: object) -> list[dict]:
    """The frames, at least one."""
    frames = content.get("frames")
    if not isinstance(frames, list) or not frames:
        raise DataError(f"{where}: 'frames' must be a list of at least one frame")
    if not all(isinstance(frame, dict) for frame in frames):
        raise DataError(f"{where}: every frame must be a JSON object")
    return frames


def read_meta(content: dict, where: object) -> dict[str, Any]:
    """What a walk of this project says about itself; empty for others."""
    meta = content.get("autonerf_lab", {"version": FORMAT_VERSION})
    if not isinstance(meta, dict):
        raise DataError(f"{where}: 'autonerf_lab' must be a JSON object")
    if meta.get("version") != FORMAT_VERSION:
        raise DataError(
            f"{where}: format version {str(meta.get('version'))[:40]!r}; this release reads version {FORMAT_VERSION}"
        )
    return {key: value for key, value in meta.items() if key != "version"}


def read_path(value: object, key: str, where: object) -> str:
    r"""A path inside the folder, with forward slashes and without ``./``.

    Example:
        >>> read_path(".\\images\\a.png", "file_path", "a.json")
        'images/a.png'
        >>> read_path("../a.png", "file_path", "a.json")
        Traceback (most recent call last):
        autonerf_lab.errors.DataError: a.json: 'file_path' leaves the folder: '../a.png'; move the files into it
    """
    if not isinstance(value, str) or not value or "\0" in value:
        raise DataError(f"{where}: {key!r} must be a path")
    path = PurePosixPath(value.replace("\\", "/"))
    if path.is_absolute() or PureWindowsPath(value).anchor or ".." in path.parts:
        raise DataError(f"{where}: {key!r} leaves the folder: {value[:80]!r}; move the files into it")
    return str(path)


def announced_size(content: dict, frame: dict, where: object) -> tuple[int, int] | None:
    """(width, height) in pixels; the frame's own come first. None when there are none."""
    values = [frame.get(key, content.get(key)) for key in ("w", "h")]
    if values == [None, None]:
        return None
    return side(values[0], "w", where), side(values[1], "h", where)


def read_camera(content: dict, frame: dict, size: tuple[int, int], where: object) -> Intrinsics:
    """The camera of a frame, whose own values come before those of the whole file.

    Args:
        content: the file: ``fl_x`` (pixels) or ``camera_angle_x`` (radians), and the same for y where pixels are not
            square; ``cx`` and ``cy`` (pixels; the middle when absent); the lens, ``k1 k2 k3 p1 p2``.
        frame: the frame, which may have any of them too.
        size: (width, height) in pixels, to which those values belong.
        where: the file and frame, for the message.

    Raises:
        DataError: a camera that is not described, not one that a lens can make, or a fisheye or panorama.

    Example:
        >>> read_camera({"camera_angle_x": np.pi / 2}, {"k1": 0.1}, (8, 6), "a.json")
        Intrinsics(width=8, height=6, fl_x=4.0, fl_y=4.0, cx=4.0, cy=3.0, k1=0.1, k2=0.0, k3=0.0, p1=0.0, p2=0.0)
    """
    both = {**content, **frame}
    if both.get("camera_model", "OPENCV") not in _MODELS:
        model = str(both["camera_model"])[:40]
        raise DataError(f"{where}: the camera model {model!r} is not one of {', '.join(_MODELS)}; {_UNDISTORT}")
    if both.get("is_fisheye") not in (None, False):
        raise DataError(f"{where}: 'is_fisheye' is set, and fisheye lenses are not supported; {_UNDISTORT}")
    for name in _BEYOND:
        if number(both.get(name, 0), name, where):
            raise DataError(f"{where}: {name!r} is not zero, and only {', '.join(_LENS)} are supported; {_UNDISTORT}")
    # A focal length of the frame also comes before an angle of the file, and the other way round.
    source = frame if any(key in frame for key in (*_FOCAL_X, *_FOCAL_Y)) else content
    fl_x, fl_y = _focal(source, _FOCAL_X, size[0], where), _focal(source, _FOCAL_Y, size[1], where)
    if fl_x is None and fl_y is None:
        raise DataError(f"{where}: no focal length; add 'fl_x' in pixels or 'camera_angle_x' in radians")
    fl_x, fl_y = fl_x or fl_y or 0.0, fl_y or fl_x or 0.0
    cx, cy = (number(both.get(key, n / 2), key, where) for key, n in zip(("cx", "cy"), size, strict=True))
    longest = max(size)
    if min(fl_x, fl_y) < 0.01 * longest or max(fl_x, fl_y) > 1000 * longest:
        raise DataError(
            f"{where}: focal lengths of {fl_x:g} and {fl_y:g} pixels do not go with {size[0]}x{size[1]} pixels"
        )
    if max(abs(cx), abs(cy)) > 10 * longest:
        raise DataError(f"{where}: the middle of the lens (cx, cy) = ({cx:g}, {cy:g}) is far outside the image")
    return Intrinsics(*size, fl_x, fl_y, cx, cy, *(number(both.get(key, 0), key, where) for key in _LENS))


def _focal(source: dict, keys: tuple[str, str], pixels: int, where: object) -> float | None:
    """The focal length of one axis in pixels, told as such or by the angle of view."""
    length, angle = keys
    if length in source:
        focal = number(source[length], length, where)
        if focal <= 0:
            raise DataError(f"{where}: the focal length {length!r} must be positive")
        return focal
    if angle not in source:
        return None
    view = number(source[angle], angle, where)
    if not 0 < view < np.pi:
        raise DataError(f"{where}: the angle of view {angle!r} must lie between 0 and pi radians")
    return round(pixels / 2 / float(np.tan(view / 2)), 9)


def read_pose(matrix: object, where: object) -> np.ndarray:
    """(4, 4) float64 camera-to-world of a file by other hands: 3 or 4 rows, and a rotation that is nearly one.

    A scale of the rotation is taken out, and so is what keeps it from being orthogonal, up to 2 %. A rigid pose keeps
    all its bits.

    Raises:
        DataError: not a pose, mirrored, or sheared.

    Example:
        >>> read_pose([[2, 0, 0, 5], [0, 2, 0, 6], [0, 0, 2, 7]], "a.json")[0]
        array([1., 0., 0., 5.])
    """
    name = "'transform_matrix'"
    widths = [len(row) if isinstance(row, list) else 0 for row in matrix] if isinstance(matrix, list) else []
    if not isinstance(matrix, list) or widths not in ([4] * 3, [4] * 4):
        raise DataError(f"{where}: {name} must be 3 or 4 rows of 4 numbers")
    pose = np.eye(4)
    pose[: len(matrix)] = [[number(value, "transform_matrix", where) for value in row] for row in matrix]
    if not np.allclose(pose[3], (0, 0, 0, 1)):
        raise DataError(f"{where}: the last row of {name} must be 0 0 0 1; is it camera-to-world, and not transposed?")
    rotation = pose[:3, :3]
    if np.abs(rotation @ rotation.T - np.eye(3)).max() < 1e-9 and np.linalg.det(rotation) > 0:
        return pose
    u, scales, v = np.linalg.svd(rotation)
    scale = float(np.median(scales))
    if scale < 1e-9 or np.abs(scales / scale - 1).max() > 0.02:
        raise DataError(f"{where}: {name} is not a rigid camera-to-world pose: its rotation is not orthogonal")
    if np.linalg.det(u @ v) < 0:
        raise DataError(
            f"{where}: {name} is mirrored; poses are OpenGL camera-to-world, x right, y up, looking along -z"
        )
    pose[:3, :3] = u @ v
    pose[3] = 0, 0, 0, 1
    return pose
