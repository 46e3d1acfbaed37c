"""Reader of exported ScanNet scenes: the folders ``color``, ``depth``, ``pose`` and ``intrinsic`` of its SensReader.

Depth is in millimetres. A pose of infinite numbers says that tracking failed; such frames are left out.
"""

from pathlib import Path

import numpy as np

from autonerf_lab.data.images import image_size
from autonerf_lab.data.posed_frames import PosedFrames
from autonerf_lab.data.readers.text import opencv_pose, read_lines
from autonerf_lab.errors import DataError
from autonerf_lab.geometry import Intrinsics


def read_scannet(folder: Path) -> PosedFrames:
    """Read an exported scene; the images are taken from ``color/``."""
    files, depths, poses, lost = [], [], [], 0
    for file in sorted((f for f in (folder / "color").iterdir() if f.stem.isdecimal()), key=lambda f: int(f.stem)):
        matrix = _matrix(folder / f"pose/{file.stem}.txt")
        if not np.isfinite(matrix).all():
            lost += 1
            continue
        poses.append(opencv_pose(matrix, str(folder / f"pose/{file.stem}.txt")))
        files.append(file)
        depths.append(folder / f"depth/{file.stem}.png")
        if not depths[-1].is_file():
            raise DataError(f"{depths[-1]} does not exist; export the depth images, too")
    if not files:
        raise DataError(f"{folder}: no image of color/ has a finite pose ({lost} lost)")
    color = _camera(folder / "intrinsic/intrinsic_color.txt", files[0])
    depth = _camera(folder / "intrinsic/intrinsic_depth.txt", depths[0])
    cameras = [color] * len(files)
    meta = {"format": "ScanNet", "scene": folder.name, "left_out": lost}
    return PosedFrames(folder, np.stack(poses), files, cameras, meta, True, depths, depth_camera=depth)


def _camera(path: Path, file: Path) -> Intrinsics:
    matrix = _matrix(path)
    fl_x, fl_y, cx, cy = (float(v) for v in (matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]))
    if not np.isfinite(matrix).all() or min(fl_x, fl_y) < 1:
        raise DataError(f"{path} must have focal lengths of at least one pixel")
    width, height = image_size(file)
    return Intrinsics(width, height, fl_x, fl_y, cx + 0.5, cy + 0.5)


def _matrix(path: Path) -> np.ndarray:
    """Return a 4x4 matrix, whose numbers may be infinite."""
    rows = [line.split() for _, line in read_lines(path)]
    try:
        matrix = np.array([[float(word) for word in row] for row in rows])
    except ValueError as error:
        raise DataError(f"{path} must have 4 rows of 4 numbers: {error}") from error
    if matrix.shape != (4, 4):
        raise DataError(f"{path} must have 4 rows of 4 numbers")
    return matrix
