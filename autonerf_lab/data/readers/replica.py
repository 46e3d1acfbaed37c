"""Reader of Replica as rendered for iMAP and NICE-SLAM: ``traj.txt``, ``results/`` and ``cam_params.json``."""

from pathlib import Path

import msgspec
import numpy as np

from autonerf_lab.data.posed_frames import PosedFrames, fit_camera
from autonerf_lab.data.readers.text import numbers, opencv_pose, read_lines
from autonerf_lab.errors import DataError
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.utils.storage import read_json


class _Camera(msgspec.Struct):
    w: int
    h: int
    fx: float
    fy: float
    cx: float
    cy: float
    scale: float  # steps of the depth images per metre


class _Parameters(msgspec.Struct):
    camera: _Camera


def read_replica(folder: Path) -> PosedFrames:
    """Read a scene; ``cam_params.json`` lies in its folder or in the one above."""
    path = next((p for p in (folder / "cam_params.json", folder.parent / "cam_params.json") if p.is_file()), None)
    if path is None:
        raise DataError(f"{folder}: cam_params.json is missing, here and in the folder above")
    c = read_json(path, _Parameters).camera
    if min(c.w, c.h) < 1 or max(c.w, c.h) > 16384 or min(c.fx, c.fy) <= 0 or not 1 <= c.scale <= 1e6:
        raise DataError(f"{path}: w, h, fx, fy and scale must be positive and plausible")
    camera = Intrinsics(c.w, c.h, c.fx, c.fy, c.cx + 0.5, c.cy + 0.5)
    poses, files, depths = [], [], []
    for t, (number, line) in enumerate(read_lines(folder / "traj.txt")):
        where = f"{folder / 'traj.txt'}: line {number}"
        poses.append(opencv_pose(np.reshape(numbers(line.split(), 16, where), (4, 4)), where))
        files.append(_image(folder / "results", f"frame{t:06d}"))
        depths.append(folder / f"results/depth{t:06d}.png")
        if not depths[-1].is_file():
            raise DataError(f"{depths[-1]} does not exist, but traj.txt has a pose for it")
    if not files:
        raise DataError(f"{folder / 'traj.txt'} has no pose")
    meta = {"format": "Replica", "scene": folder.name}
    cameras = [fit_camera(camera, file) for file in files]
    return PosedFrames(folder, np.stack(poses), files, cameras, meta, True, depths, 1 / c.scale)


def _image(folder: Path, stem: str) -> Path:
    file = next((f for f in (folder / f"{stem}.jpg", folder / f"{stem}.png") if f.is_file()), None)
    if file is None:
        raise DataError(f"{folder / stem}.jpg does not exist, but traj.txt has a pose for it")
    return file
