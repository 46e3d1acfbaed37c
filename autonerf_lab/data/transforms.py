"""Reader of ``transforms.json``, shared by trajectories and photographs.

Functions take ``where``, the file or frame that an error message names.
"""

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

import numpy as np

from autonerf_lab.errors import DataError
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.utils.storage import read_json

FORMAT_VERSION = 1  # of the key ``autonerf_lab``
MAX_SIDE = 16384  # pixels
_EXTENSIONS = (".png", ".jpg", ".jpeg", ".JPG", ".PNG", ".JPEG", ".webp", ".WEBP")
_MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
_DISTORTION = ("k1", "k2", "k3", "p1", "p2")
_UNSUPPORTED = ("k4", "k5", "k6")  # of OpenCV's rational model, or of a fisheye
_FOCAL_X, _FOCAL_Y = ("fl_x", "camera_angle_x"), ("fl_y", "camera_angle_y")
_UNDISTORT = "undistort the images first, for example with COLMAP's image_undistorter"

CAMERA_KEYS = {"camera_model", "is_fisheye", "w", "h", "cx", "cy", *_FOCAL_X, *_FOCAL_Y, *_DISTORTION, *_UNSUPPORTED}


@dataclass(frozen=True)
class Transforms:
    """Content of a ``transforms.json`` with validated frames and poses."""

    path: Path
    content: dict[str, Any]  # the whole JSON object
    frames: list[dict]  # T JSON objects
    poses: np.ndarray  # (T, 4, 4) float64 camera-to-world
    meta: dict[str, Any]  # content of the key ``autonerf_lab``; empty for other files

    def where(self, t: int) -> str:
        """Return the name of a frame for messages."""
        return f"{self.path}: frame {t}"

    def files(self, key: str) -> list[Path]:
        """Return the file of each frame under a key, such as ``file_path``.

        Raises:
            DataError: a file does not exist, or two frames share one.
        """
        files = self._found(key, range(len(self.frames)))
        first: dict[Path, int] = {}
        for t, file in files.items():
            if first.setdefault(file, t) != t:
                name = self.frames[t][key]
                raise DataError(
                    f"{self.path}: frames {first[file]} and {t} share the {key!r} {name!r}; remove one of them"
                )
        return [*files.values()]

    def optional_files(self, key: str) -> list[Path | None] | None:
        """Return the file of each frame under a key that some frames have; they may share one. None: no frame has it.

        Raises:
            DataError: a file does not exist.
        """
        files = self._found(key, [t for t, frame in enumerate(self.frames) if frame.get(key) is not None])
        return [files.get(t) for t in range(len(self.frames))] if files else None

    def _found(self, key: str, frames: Iterable[int]) -> dict[int, Path]:
        names = {t: read_path(self.frames[t].get(key), key, self.where(t)) for t in frames}
        found = {t: _find(self.path.parent / name) for t, name in names.items()}
        missing = [names[t] for t, file in found.items() if file is None]
        if missing:
            raise DataError(
                f"{self.path}: {missing[0][:200]!r} does not exist, and {len(missing)} of {len(names)} files of "
                f"{key!r} are missing (also with {' '.join(_EXTENSIONS)}); add them, or remove their frames"
            )
        return {t: file for t, file in found.items() if file}


def read_transforms(path: Path, *, strict: bool = False) -> Transforms:
    """Read the frames, poses and metadata of a ``transforms.json``.

    Args:
        path: the JSON file.
        strict: accept rigid 4x4 poses only; otherwise nearly rigid poses are corrected, see :func:`read_pose`.

    Raises:
        DataError: the file is missing or damaged, or a frame or pose is not valid.
    """
    content = read_json(path, dict[str, Any])
    meta, frames = read_meta(content, path), read_frames(content, path)
    read = read_rigid_pose if strict else read_pose
    poses = [read(frame.get("transform_matrix"), f"{path}: frame {t}") for t, frame in enumerate(frames)]
    return Transforms(path, content, frames, np.stack(poses), meta)


def number(value: object, name: str, where: object) -> float:
    """Return a finite number below 1e9 as a float.

    Example:
        >>> number("1", "cx", "a.json")
        Traceback (most recent call last):
        autonerf_lab.errors.DataError: a.json: 'cx' must be a finite number, not '1'
    """
    # Python does not print integers of more than 4300 digits
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e9:
        shown = "a huge integer" if isinstance(value, int) and abs(value) >= 1e9 else repr(str(value)[:40])
        raise DataError(f"{where}: {name!r} must be a finite number, not {shown}")
    return float(value)


def side(value: object, name: str, where: object) -> int:
    """Return a number of pixels, 1 to :data:`MAX_SIDE`."""
    pixels = number(value, name, where)
    if pixels != int(pixels) or not 1 <= pixels <= MAX_SIDE:
        raise DataError(f"{where}: {name!r} must be a whole number between 1 and {MAX_SIDE}")
    return int(pixels)


def read_frames(content: dict, where: object) -> list[dict]:
    """Return the frames, at least one."""
    frames = content.get("frames")
    if not isinstance(frames, list) or not frames:
        raise DataError(f"{where}: 'frames' must be a list of at least one frame")
    if not all(isinstance(frame, dict) for frame in frames):
        raise DataError(f"{where}: every frame must be a JSON object")
    return frames


def read_meta(content: dict, where: object) -> dict[str, Any]:
    """Return the metadata of a trajectory of this package; empty for other files."""
    meta = content.get("autonerf_lab", {"version": FORMAT_VERSION})
    if not isinstance(meta, dict):
        raise DataError(f"{where}: 'autonerf_lab' must be a JSON object")
    if meta.get("version") != FORMAT_VERSION:
        raise DataError(
            f"{where}: format version {str(meta.get('version'))[:40]!r}; this release reads version {FORMAT_VERSION}"
        )
    return {key: value for key, value in meta.items() if key != "version"}


def read_path(value: object, key: str, where: object) -> str:
    r"""Return a path inside the folder, with forward slashes and without ``./``.

    Example:
        >>> read_path(".\\images\\a.png", "file_path", "a.json")
        'images/a.png'
        >>> read_path("../a.png", "file_path", "a.json")
        Traceback (most recent call last):
        autonerf_lab.errors.DataError: a.json: 'file_path' is outside the folder: '../a.png'; move the files into it
    """
    if not isinstance(value, str) or not value or "\0" in value:
        raise DataError(f"{where}: {key!r} must be a path")
    path = PurePosixPath(value.replace("\\", "/"))
    if path.is_absolute() or PureWindowsPath(value).anchor or ".." in path.parts:
        raise DataError(f"{where}: {key!r} is outside the folder: {value[:80]!r}; move the files into it")
    return str(path)


def announced_size(content: dict, frame: dict, where: object) -> tuple[int, int] | None:
    """Return (width, height) in pixels of a frame, or else of the file; None if neither has a size."""
    values = [frame.get(key, content.get(key)) for key in ("w", "h")]
    if values == [None, None]:
        return None
    return side(values[0], "w", where), side(values[1], "h", where)


def read_camera(content: dict, frame: dict, size: tuple[int, int], where: object) -> Intrinsics:
    """Return the intrinsics of a frame; its own values override those of the file.

    Args:
        content: JSON object of the file: ``fl_x`` (pixels) or ``camera_angle_x`` (radians), and the same for y where
            pixels are not square; ``cx`` and ``cy`` (pixels; default: image centre); distortion ``k1 k2 k3 p1 p2``.
        frame: JSON object of the frame, which may have any of these keys.
        size: (width, height) in pixels to which the values refer.
        where: file and frame, for messages.

    Raises:
        DataError: the focal length is missing, a value is implausible, or the camera is a fisheye or panorama.

    Example:
        >>> read_camera({"camera_angle_x": np.pi / 2}, {"k1": 0.1}, (8, 6), "a.json")
        Intrinsics(width=8, height=6, fl_x=4.0, fl_y=4.0, cx=4.0, cy=3.0, k1=0.1, k2=0.0, k3=0.0, p1=0.0, p2=0.0)
    """
    both = {**content, **frame}
    if both.get("camera_model", "OPENCV") not in _MODELS:
        model = str(both["camera_model"])[:40]
        raise DataError(f"{where}: the camera model {model!r} is not one of {', '.join(_MODELS)}; {_UNDISTORT}")
    if both.get("is_fisheye") not in (None, False):
        raise DataError(f"{where}: 'is_fisheye' is set, and a trajectory has no fisheye lens; {_UNDISTORT}")
    for name in _UNSUPPORTED:
        if number(both.get(name, 0), name, where):
            raise DataError(
                f"{where}: {name!r} is not zero, and only {', '.join(_DISTORTION)} are supported; {_UNDISTORT}"
            )
    # A focal length of the frame also overrides an angle of the file, and the other way round.
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
        raise DataError(f"{where}: the principal point (cx, cy) = ({cx:g}, {cy:g}) is far outside the image")
    return Intrinsics(*size, fl_x, fl_y, cx, cy, *(number(both.get(key, 0), key, where) for key in _DISTORTION))


def _focal(source: dict, keys: tuple[str, str], pixels: int, where: object) -> float | None:
    """Return the focal length of one axis in pixels, given directly or by the angle of view; None if neither is."""
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
    """Return a (4, 4) float64 camera-to-world pose given by 3 or 4 rows.

    A scale of the rotation is removed, and the rotation is made orthogonal if it is so within 2 %. A rigid pose keeps
    all its bits.

    Raises:
        DataError: the matrix is not a pose, or is mirrored or sheared.

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


def read_rigid_pose(matrix: object, where: object) -> np.ndarray:
    """Return a (4, 4) float64 camera-to-world pose given by 4 rows, unchanged.

    Raises:
        DataError: the matrix is not a rigid pose.
    """
    name = "'transform_matrix'"
    if not isinstance(matrix, list) or [len(row) if isinstance(row, list) else 0 for row in matrix] != [4] * 4:
        raise DataError(f"{where}: {name} must be 4 rows of 4 numbers")
    pose = np.array([[number(value, "transform_matrix", where) for value in row] for row in matrix])
    rigid = np.allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-4) and np.linalg.det(pose[:3, :3]) > 0
    if not rigid or not np.allclose(pose[3], (0, 0, 0, 1)):
        raise DataError(f"{where}: {name} is not a rigid camera-to-world pose")
    return pose


def _find(file: Path) -> Path | None:
    # False for a name that is too long, where Path.is_file raises
    return next((f for f in (file, *(Path(f"{file}{end}") for end in _EXTENSIONS)) if os.path.isfile(f)), None)
