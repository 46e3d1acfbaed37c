"""Readers of two scanning apps for phones: raw exports of Polycam and RGB-D exports of Record3D.

Both store ARKit's poses: camera axes as OpenGL, y up. The world is turned so that z is up.
"""

from pathlib import Path

import msgspec
import numpy as np

from autonerf_lab.data.posed_frames import PosedFrames, fit_camera
from autonerf_lab.data.readers.text import Y_UP, quaternion_pose
from autonerf_lab.data.transforms import read_pose
from autonerf_lab.errors import DataError
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.utils.storage import read_json

_ROWS = [[f"t_{row}{column}" for column in range(4)] for row in range(3)]


def read_polycam(folder: Path) -> PosedFrames:
    """Read a raw export of Polycam (developer mode): ``keyframes/`` with corrected or original images and cameras."""
    keyframes = folder / "keyframes"
    kind = "corrected_" if (keyframes / "corrected_cameras").is_dir() else ""
    poses, files, cameras, depths = [], [], [], []
    for path in sorted((keyframes / f"{kind}cameras").glob("*.json")):
        content = read_json(path, dict[str, float | str | bool | list | dict | None])
        values = {}
        for key in ("fx", "fy", "cx", "cy", "width", "height", *(key for row in _ROWS for key in row)):
            value = content.get(key)
            if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e9:
                raise DataError(f"{path}: {key!r} must be a finite number")
            values[key] = float(value)
        pose = np.eye(4)
        pose[:3] = [[values[key] for key in row] for row in _ROWS]
        poses.append(read_pose((Y_UP @ pose).tolist(), path))
        files.append(_existing(keyframes / f"{kind}images/{path.stem}.jpg", path))
        if (keyframes / "depth").is_dir():  # phones without a depth sensor have none
            depths.append(_existing(keyframes / f"depth/{path.stem}.png", path))
        size = int(values["width"]), int(values["height"])
        focal, center = (values["fx"], values["fy"]), (values["cx"], values["cy"])
        cameras.append(_camera(size, focal, center, path, files[-1]))
    if not files:
        raise DataError(f"{keyframes / f'{kind}cameras'} holds no *.json")
    return PosedFrames(folder, np.stack(poses), files, cameras, {"format": "Polycam"}, True, depths or None)


class _Metadata(msgspec.Struct):
    w: int
    h: int
    K: list[float]  # 3x3 in columns
    poses: list[list[float]]  # x y z w, x y z


def read_record3d(folder: Path) -> PosedFrames:
    """Read an export "EXR + RGB" of Record3D: ``metadata.json`` and ``rgb/``. Its EXR depth is not read."""
    path = folder / "metadata.json"
    data = read_json(path, _Metadata)
    if len(data.K) != 9:
        raise DataError(f"{path}: 'K' must have 9 numbers")
    found = sorted((f for f in (folder / "rgb").iterdir() if f.stem.isdecimal()), key=lambda f: int(f.stem))
    if len(found) != len(data.poses):
        raise DataError(f"{path} has {len(data.poses)} poses, but rgb/ has {len(found)} images; export the scan again")
    poses, cameras = [], []
    for t, (values, file) in enumerate(zip(data.poses, found, strict=True)):
        where = f"{path}: poses[{t}]"
        if len(values) != 7 or not all(abs(value) < 1e9 for value in values):
            raise DataError(f"{where} must have 7 finite numbers: a quaternion x y z w and a position")
        poses.append(read_pose((Y_UP @ quaternion_pose(values[:4], values[4:], where)).tolist(), where))
        cameras.append(_camera((data.w, data.h), (data.K[0], data.K[4]), (data.K[6], data.K[7]), path, file))
    if not poses:
        raise DataError(f"{path} has no pose")
    return PosedFrames(folder, np.stack(poses), found, cameras, {"format": "Record3D"}, True)


def _camera(
    size: tuple[int, int], focal: tuple[float, float], center: tuple[float, float], path: Path, file: Path
) -> Intrinsics:
    if not all(1 <= side <= 16384 for side in size) or min(focal) < 1:
        raise DataError(
            f"{path}: the image size {size[0]}x{size[1]} or the focal length {min(focal):g} is not plausible"
        )
    return fit_camera(Intrinsics(*size, *focal, *center), file)


def _existing(file: Path, source: Path) -> Path:
    if not file.is_file():
        raise DataError(f"{file} does not exist, but {source.name} describes it")
    return file
