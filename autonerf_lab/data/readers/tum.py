"""Reader of TUM RGB-D sequences: ``rgb.txt``, ``depth.txt`` and ``groundtruth.txt`` with time stamps.

Source: Sturm et al. 2012 and the file formats of its web page. Depth has 5000 steps a metre. Without ``camera.txt``
(one line: width height fx fy cx cy, and optionally k1 k2 p1 p2 k3), the calibration is that of the page for the camera
freiburg1, 2 or 3 in the name of the folder, else that of ROS.
"""

import os
from pathlib import Path

import numpy as np

from autonerf_lab.data.posed_frames import PosedFrames, fit_camera
from autonerf_lab.data.readers.text import numbers, opencv_pose, quaternion_pose, read_lines
from autonerf_lab.data.transforms import read_path
from autonerf_lab.errors import DataError
from autonerf_lab.geometry import Intrinsics

MAX_GAP = 0.02  # seconds between an image and its depth or pose
_CAMERAS = {  # fx, fy, cx, cy, k1, k2, p1, p2, k3
    "freiburg1": (517.3, 516.5, 318.6, 255.3, 0.2624, -0.9531, -0.0054, 0.0026, 1.1633),
    "freiburg2": (520.9, 521.0, 325.1, 249.7, 0.2312, -0.7849, -0.0033, -0.0001, 0.9172),
    "freiburg3": (535.4, 539.2, 320.1, 247.6),
    "": (525.0, 525.0, 319.5, 239.5),
}


def read_tum(folder: Path) -> PosedFrames:
    """Read a sequence; images without a pose or depth within 0.02 s are left out."""
    stamps, names = _stamped(folder, "rgb.txt")
    poses_at, poses = _trajectory(folder / "groundtruth.txt")
    pose_of = _nearest(poses_at, stamps)
    depths, depth_of = None, pose_of
    if (folder / "depth.txt").is_file():
        depth_at, depths = _stamped(folder, "depth.txt")
        depth_of = _nearest(depth_at, stamps)
    chosen = [t for t in range(len(names)) if pose_of[t] >= 0 and depth_of[t] >= 0]
    if not chosen:
        raise DataError(f"{folder}: no image of rgb.txt has a pose and depth within {MAX_GAP} s")
    files = [names[t] for t in chosen]
    camera = _camera(folder)
    return PosedFrames(
        folder,
        np.stack([poses[pose_of[t]] for t in chosen]),
        files,
        [fit_camera(camera, file) for file in files],
        {"format": "TUM RGB-D", "left_out": len(names) - len(chosen), "time_stamps": [stamps[t] for t in chosen]},
        True,
        None if depths is None else [depths[depth_of[t]] for t in chosen],
        depth_unit=1 / 5000,
    )


def _camera(folder: Path) -> Intrinsics:
    if (folder / "camera.txt").is_file():
        lines = read_lines(folder / "camera.txt")
        if not lines:
            raise DataError(f"{folder / 'camera.txt'} is empty; write: width height fx fy cx cy")
        number, line = lines[0]
        words = line.split()
        values = numbers(words, 11 if len(words) > 6 else 6, f"{folder / 'camera.txt'}: line {number}")
        width, height, *rest = values
        if not (1 <= width < 1e5 and 1 <= height < 1e5 and min(rest[:2]) > 0):
            raise DataError(f"{folder / 'camera.txt'}: width, height and focal lengths must be positive")
    else:
        width, height = 640, 480
        rest = list(_CAMERAS[next(name for name in _CAMERAS if name in folder.name.lower())])
    fl_x, fl_y, cx, cy, *lens = rest
    k1, k2, p1, p2, k3 = lens or (0.0,) * 5
    # The page gives the principal point with pixel centres at whole numbers
    return Intrinsics(int(width), int(height), fl_x, fl_y, cx + 0.5, cy + 0.5, k1, k2, k3, p1, p2)


def _stamped(folder: Path, name: str) -> tuple[np.ndarray, list[Path]]:
    """Return the time stamps and files of a list."""
    stamps, files = [], []
    for number, line in read_lines(folder / name):
        where = f"{folder / name}: line {number}"
        words = line.split()
        if len(words) != 2:
            raise DataError(f"{where} must be a time stamp and a file, not {line[:80]!r}")
        stamps += numbers(words[:1], 1, where)
        files.append(folder / read_path(words[1], name, where))
        if not os.path.isfile(files[-1]):
            raise DataError(f"{where}: {words[1][:120]!r} does not exist")
    if not files:
        raise DataError(f"{folder / name} lists no file")
    return np.array(stamps), files


def _trajectory(path: Path) -> tuple[np.ndarray, list[np.ndarray]]:
    stamps, poses = [], []
    for number, line in read_lines(path):
        where = f"{path}: line {number}"
        stamp, *rest = numbers(line.split(), 8, where)
        stamps.append(stamp)
        poses.append(opencv_pose(quaternion_pose(rest[3:], rest[:3], where), where))
    if not stamps:
        raise DataError(f"{path} lists no pose")
    return np.array(stamps), poses


def _nearest(known: np.ndarray, stamps: np.ndarray) -> np.ndarray:
    """Return the index of the nearest known time stamp, -1 if it is more than MAX_GAP away."""
    order = np.argsort(known)
    right = np.clip(np.searchsorted(known[order], stamps), 1, max(len(known) - 1, 1))
    pair = np.minimum(np.stack([right - 1, right]), len(known) - 1)
    nearest = pair[np.abs(known[order][pair] - stamps).argmin(axis=0), np.arange(len(stamps))]
    return np.where(np.abs(known[order][nearest] - stamps) <= MAX_GAP, order[nearest], -1)
