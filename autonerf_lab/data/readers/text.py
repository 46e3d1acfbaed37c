"""Numbers and poses from text files."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from autonerf_lab.data.transforms import read_pose
from autonerf_lab.errors import DataError
from autonerf_lab.geometry import OPENCV_AXES
from autonerf_lab.utils.storage import read_bytes

MAX_BYTES = 64 << 20
Y_UP = np.array([[0.0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]])  # a world with y up -> z up


def read_lines(path: Path) -> list[tuple[int, str]]:
    """Return number and text of the lines that are not empty and no comments (#).

    Raises:
        DataError: the file is missing, too large or not text.
    """
    try:
        text = read_bytes(path, MAX_BYTES).decode("utf-8")
    except UnicodeDecodeError as error:
        raise DataError(f"{path} is not a text file: {error}") from error
    lines = ((number, line.strip()) for number, line in enumerate(text.splitlines(), 1))
    return [(number, line) for number, line in lines if line and not line.startswith("#")]


def numbers(words: list[str], count: int, where: str) -> list[float]:
    """Return ``count`` finite numbers.

    Raises:
        DataError: there are more or fewer, or one is no finite number below 1e9.
    """
    try:
        values = [float(word) for word in words]
    except ValueError as error:
        raise DataError(f"{where}: {error}") from error
    if len(values) != count or not all(abs(value) < 1e9 for value in values):
        raise DataError(f"{where} must have {count} finite numbers, not {' '.join(words)[:80]!r}")
    return values


def opencv_pose(matrix: np.ndarray, where: str) -> np.ndarray:
    """Return the OpenGL camera-to-world pose of an OpenCV one (4, 4); it must be rigid.

    Raises:
        DataError: the matrix is not a pose, or is mirrored.
    """
    return read_pose((matrix @ OPENCV_AXES).tolist(), where)


def quaternion_pose(xyzw: list[float], position: list[float], where: str) -> np.ndarray:
    """Return the (4, 4) pose of a unit quaternion x y z w and a position.

    Raises:
        DataError: the quaternion differs from unit length by more than 1 %.
    """
    if abs(float(np.linalg.norm(xyzw)) - 1) > 0.01:
        raise DataError(f"{where}: {xyzw} is not a unit quaternion; is the order right?")
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_quat(xyzw).as_matrix(), position
    return pose
