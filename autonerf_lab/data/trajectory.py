"""A walk: poses and images, in memory and as a folder.

The folder is a nerfstudio dataset as it stands: ``transforms.json`` (OpenGL camera-to-world), ``images/`` (PNG),
``depth/`` (16-bit PNG, millimetres, 0 = none) and ``semantics/`` (8-bit PNG, class index). Everything nerfstudio has no
word for lives under the key ``autonerf_lab``. ``transforms.json`` is written last: a folder without it is unfinished.
"""

import io
import os
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from autonerf_lab.data.images import one_channel, parallel, to_classes, to_metres
from autonerf_lab.data.transforms import FORMAT_VERSION, number, read_frames, read_meta, read_path, side
from autonerf_lab.errors import DataError
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.utils import storage

MAX_BYTES = 2 << 30  # of decoded images
_FOLDERS = {"file_path": "images", "depth_file_path": "depth", "semantics_file_path": "semantics"}
_MAX_DEPTH_MM = 65535


@dataclass(frozen=True)
class Trajectory:
    """What the robot saw on one walk. Frame t is what it saw when it chose its action t."""

    poses: np.ndarray  # (T, 4, 4) float64, camera-to-world, OpenGL
    rgb: np.ndarray  # (T, H, W, 3) uint8
    depth: np.ndarray | None  # (T, H, W) float32, metres along the optical axis, 0 = none
    semantics: np.ndarray | None  # (T, H, W) uint8, class index
    intrinsics: Intrinsics
    meta: dict[str, Any] = field(default_factory=dict)  # JSON: scene, policy, seed, actions, coverage curves, ...

    def __len__(self) -> int:
        return len(self.poses)

    def save(self, folder: str | Path) -> None:
        """Write it to ``folder``: see :func:`save`."""
        save(self, folder)


def save(trajectory: Trajectory, folder: str | Path) -> None:
    """Write a trajectory folder; one that is already there is replaced.

    Depth is rounded to the millimetre, and depth beyond 65.535 m becomes 0, "none".

    Args:
        trajectory: the walk.
        folder: made when it does not exist.

    Raises:
        DataError: a file could not be written, or the arrays do not belong together.

    Example:
        >>> import tempfile
        >>> walk = Trajectory(np.eye(4)[None], np.zeros((1, 4, 6, 3), np.uint8), None, None, Intrinsics.from_fov(6, 4))
        >>> save(walk, tempfile.mkdtemp() + "/walk")
    """
    folder = Path(folder)
    _check_arrays(trajectory)
    layers: dict[str, np.ndarray] = {"file_path": trajectory.rgb}
    if trajectory.depth is not None:
        millimetres = np.rint(trajectory.depth * np.float32(1000))
        layers["depth_file_path"] = np.where(millimetres <= _MAX_DEPTH_MM, millimetres, 0).astype(np.uint16)
    if trajectory.semantics is not None:
        layers["semantics_file_path"] = trajectory.semantics
    try:
        # An old transforms.json beside half of the new images would look finished.
        (folder / "transforms.json").unlink(missing_ok=True)
        for name in _FOLDERS.values():
            for stale in (folder / name).glob("frame_*.png"):
                stale.unlink()
        for key in layers:
            (folder / _FOLDERS[key]).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"cannot write {folder}: {error.strerror or error}; choose another folder") from error
    parallel(lambda t: _write_frame(folder, layers, t), len(trajectory))
    k = trajectory.intrinsics
    storage.write_json(
        folder / "transforms.json",
        {
            "camera_model": "OPENCV",
            **{"w": k.width, "h": k.height, "fl_x": k.fl_x, "fl_y": k.fl_y, "cx": k.cx, "cy": k.cy},
            **{"k1": k.k1, "k2": k.k2, "k3": k.k3, "p1": k.p1, "p2": k.p2},
            "autonerf_lab": {"version": FORMAT_VERSION, **trajectory.meta},
            "frames": [
                {**{key: _frame_path(key, t) for key in layers}, "transform_matrix": pose.tolist()}
                for t, pose in enumerate(trajectory.poses)
            ],
        },
    )


def load_trajectory(folder: str | Path, max_bytes: int = MAX_BYTES) -> Trajectory:
    """Read a trajectory folder; depth and semantics are None where the frames name none.

    Args:
        folder: holds ``transforms.json``.
        max_bytes: refuse folders whose decoded images would take more memory than this.

    Raises:
        DataError: a file is missing, damaged or does not belong; the message names it.

    Example:
        >>> load_trajectory("/nowhere")
        Traceback (most recent call last):
        autonerf_lab.errors.DataError: /nowhere/transforms.json does not exist; is this a trajectory folder, \
and was it finished?
    """
    folder = Path(folder)
    path = folder / "transforms.json"
    if not path.exists():
        raise DataError(f"{path} does not exist; is this a trajectory folder, and was it finished?")
    content = storage.read_json(path)
    intrinsics = _read_intrinsics(content, path)
    meta = read_meta(content, path)
    frames = read_frames(content, path)
    poses = np.stack([_read_pose(frame.get("transform_matrix"), t, path) for t, frame in enumerate(frames)])
    shape = (intrinsics.height, intrinsics.width)
    size = len(frames) * shape[0] * shape[1] * 8
    if size > max_bytes:
        raise DataError(f"{path}: {size} bytes of images are more than max_bytes={max_bytes}; raise it if it is right")
    layers: dict[str, tuple[list[Path], np.ndarray]] = {}
    for key, tail, dtype in (
        ("file_path", (3,), "u1"),
        ("depth_file_path", (), "f4"),
        ("semantics_file_path", (), "u1"),
    ):
        files = _read_paths(frames, key, folder, path)
        if files:
            _check_png(files[0], shape)  # before memory is taken on the word of the JSON
            layers[key] = files, np.empty((len(frames), *shape, *tail), dtype)

    def read(t: int) -> None:
        for key, (files, array) in layers.items():
            array[t] = _read_image(files[t], key, shape)

    parallel(read, len(frames))
    depth, semantics = (layers[key][1] if key in layers else None for key in ("depth_file_path", "semantics_file_path"))
    return Trajectory(poses, layers["file_path"][1], depth, semantics, intrinsics, meta)


def _check_arrays(trajectory: Trajectory) -> None:
    shape = (len(trajectory), trajectory.intrinsics.height, trajectory.intrinsics.width)
    for name, array, want in (
        ("poses", trajectory.poses, (len(trajectory), 4, 4)),
        ("rgb", trajectory.rgb, (*shape, 3)),
        ("depth", trajectory.depth, shape),
        ("semantics", trajectory.semantics, shape),
    ):
        if array is not None and array.shape != want:
            raise DataError(f"trajectory.{name} has the shape {array.shape}, not {want}")
    if not len(trajectory):
        raise DataError("a trajectory without frames cannot be saved")


def _frame_path(key: str, t: int) -> str:
    return f"{_FOLDERS[key]}/frame_{t:05d}.png"


def _write_frame(folder: Path, layers: dict[str, np.ndarray], t: int) -> None:
    for key, array in layers.items():
        path = folder / _frame_path(key, t)
        buffer = io.BytesIO()
        Image.fromarray(array[t]).save(buffer, "PNG", compress_level=1)
        try:
            path.write_bytes(buffer.getvalue())
        except OSError as error:
            raise DataError(f"cannot write {path}: {error.strerror or error}; free some space") from error


def _read_intrinsics(content: dict, path: Path) -> Intrinsics:
    width, height = (side(content.get(name), name, path) for name in ("w", "h"))
    fl_x, fl_y, cx, cy = (number(content.get(name), name, path) for name in ("fl_x", "fl_y", "cx", "cy"))
    if min(fl_x, fl_y) <= 0:
        raise DataError(f"{path}: the focal lengths 'fl_x' and 'fl_y' must be positive")
    for name in ("k1", "k2", "k3", "k4", "p1", "p2"):
        if name in content and number(content[name], name, path) != 0:
            raise DataError(f"{path}: a walk has no lens distortion ({name!r}); read photographs with load_dataset")
    return Intrinsics(width, height, fl_x, fl_y, cx, cy)


def _read_pose(matrix: object, t: int, path: Path) -> np.ndarray:
    name = f"frame {t}: 'transform_matrix'"
    if not isinstance(matrix, list) or [len(row) if isinstance(row, list) else 0 for row in matrix] != [4] * 4:
        raise DataError(f"{path}: {name} must be 4 rows of 4 numbers")
    pose = np.array([[number(value, name, path) for value in row] for row in matrix])
    rigid = np.allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-4) and np.linalg.det(pose[:3, :3]) > 0
    if not rigid or not np.allclose(pose[3], (0, 0, 0, 1)):
        raise DataError(f"{path}: {name} is not a rigid camera-to-world pose")
    return pose


def _read_paths(frames: list[dict], key: str, folder: Path, path: Path) -> list[Path]:
    names = [frame.get(key) for frame in frames]
    if key != "file_path" and all(name is None for name in names):
        return []
    files = [read_path(name, key, f"{path}: frame {t}") for t, name in enumerate(names)]
    if len(set(files)) != len(files):
        raise DataError(f"{path}: two frames share one {key!r}")
    return [folder / file for file in files]


def _check_png(file: Path, shape: tuple[int, int]) -> bytes:
    """The bytes of a PNG that has the announced size; read from the header, so that a bomb is never unpacked."""
    try:
        limit = 4096 + 16 * shape[0] * shape[1]
        if os.path.getsize(file) > limit:
            raise DataError(f"{file} is larger than an image of {shape[1]}x{shape[0]} can be")
        data = file.read_bytes()
    except OSError as error:
        raise DataError(f"cannot read {file}: {error.strerror or error}") from error
    if len(data) < 33 or data[:8] != b"\x89PNG\r\n\x1a\n" or data[12:16] != b"IHDR":
        raise DataError(f"{file} is not a PNG image")
    width, height = struct.unpack(">II", data[16:24])
    if (height, width) != shape:
        raise DataError(f"{file} has {width}x{height} pixels, transforms.json says {shape[1]}x{shape[0]}")
    return data


def _read_image(file: Path, key: str, shape: tuple[int, int]) -> np.ndarray:
    data = _check_png(file, shape)
    try:
        with Image.open(io.BytesIO(data), formats=["PNG"]) as image:
            if key == "file_path":
                return np.asarray(image.convert("RGB"))
            array = np.asarray(image)
    # Pillow raises whatever its decoder met: ValueError, SyntaxError, struct.error, zlib.error, OSError, ...
    except Exception as error:
        raise DataError(f"{file} is damaged: {error}") from error
    one_channel(array, file)
    return to_metres(array) if key == "depth_file_path" else to_classes(array, file)
