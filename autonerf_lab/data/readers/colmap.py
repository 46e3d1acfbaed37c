"""Reader of COLMAP models, text or binary: ``cameras`` and ``images`` in ``sparse/0``, beside the folder ``images``.

Source: the documentation of COLMAP's output format. Points are not read. The mask of ``images/NAME`` is
``masks/NAME.png``, as in COLMAP: black pixels of the mask are not used.
"""

import os
import struct
from pathlib import Path

import numpy as np

from autonerf_lab.data.fisheye import Fisheye
from autonerf_lab.data.posed_frames import PosedFrames, fit_camera
from autonerf_lab.data.readers.text import numbers, opencv_pose, quaternion_pose, read_lines
from autonerf_lab.data.transforms import read_path
from autonerf_lab.errors import DataError
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.utils.storage import read_bytes

PLACES = ("sparse/0", "sparse", "colmap/sparse/0", ".")
MODELS = {  # id -> name, parameters; "f" stands for both focal lengths, "-" for a parameter that must be zero
    0: ("SIMPLE_PINHOLE", "f cx cy"),
    1: ("PINHOLE", "fx fy cx cy"),
    2: ("SIMPLE_RADIAL", "f cx cy k1"),
    3: ("RADIAL", "f cx cy k1 k2"),
    4: ("OPENCV", "fx fy cx cy k1 k2 p1 p2"),
    5: ("OPENCV_FISHEYE", "fx fy cx cy k1 k2 k3 k4"),
    6: ("FULL_OPENCV", "fx fy cx cy k1 k2 p1 p2 k3 - - -"),
    8: ("SIMPLE_RADIAL_FISHEYE", "f cx cy k1"),
    9: ("RADIAL_FISHEYE", "f cx cy k1 k2"),
}
Camera = tuple[Intrinsics, Fisheye | None]


def model_folder(folder: Path) -> Path | None:
    """Return the folder of a COLMAP model in a folder of photographs, or None."""
    for place in PLACES:
        for ending in (".bin", ".txt"):
            if all((folder / place / f"{name}{ending}").is_file() for name in ("cameras", "images")):
                return folder / place
    return None


def read_colmap(folder: Path, model: Path | None = None) -> PosedFrames:
    """Read the registered images of a COLMAP model.

    Args:
        folder: folder of the photographs.
        model: folder of the model; default: the first of ``PLACES`` in ``folder`` that has one.

    Returns:
        Frames in the order of their names. Poses are camera-to-world (OpenGL camera), in the world frame and the unit
        of the model.

    Raises:
        DataError: there is no model or no registered image, a file is missing or damaged, or a camera is not supported.
    """
    model = model_folder(folder) if model is None else model_folder(model)
    if model is None:
        raise DataError(f"{folder} has no COLMAP model: cameras and images, .bin or .txt")
    binary = (model / "cameras.bin").is_file() and (model / "images.bin").is_file()
    cameras = (_cameras_binary if binary else _cameras_text)(model)
    images = (_images_binary if binary else _images_text)(model)
    if not images:
        raise DataError(f"{model} has no registered image")
    place = folder / "images" if (folder / "images").is_dir() else folder
    poses, files, found = [], [], []
    for name, (camera_id, world_to_camera, where) in sorted(images.items()):
        if camera_id not in cameras:
            raise DataError(f"{where}: {name[:80]!r} has the camera {camera_id}, which does not exist")
        files.append(place / read_path(name, "image name", where))
        if not os.path.isfile(files[-1]):
            raise DataError(f"{where}: {files[-1]} does not exist; put the photographs into {folder / 'images'}")
        poses.append(opencv_pose(np.linalg.inv(world_to_camera), where))
        found.append(cameras[camera_id])
    masks = [folder / "masks" / f"{file.relative_to(place).as_posix()}.png" for file in files]
    lenses = [lens for _, lens in found]
    return PosedFrames(
        folder,
        np.stack(poses),
        files,
        [fit_camera(camera, file) for (camera, _), file in zip(found, files, strict=True)],
        {"format": "COLMAP"},
        masks=[mask if os.path.isfile(mask) else None for mask in masks] if (folder / "masks").is_dir() else None,
        lenses=lenses if any(lenses) else None,
    )


def _camera(model: tuple[str, str], size: tuple[int, int], values: list[float], where: str) -> Camera:
    parameters: dict[str, float] = dict(zip(model[1].split(), values, strict=True))
    if any(v for key, v in zip(model[1].split(), values, strict=True) if key == "-"):
        raise DataError(f"{where}: k4, k5 and k6 of {model[0]} are not supported; undistort the images with COLMAP")
    fl_x, fl_y = parameters.get("fx", parameters.get("f", 0)), parameters.get("fy", parameters.get("f", 0))
    if not all(1 <= side <= 65536 for side in size) or min(fl_x, fl_y) <= 0 or not np.isfinite(values).all():
        raise DataError(f"{where}: the camera must have a size of 1 to 65536 pixels and positive focal lengths")
    k1, k2, k3, k4, p1, p2 = (parameters.get(key, 0.0) for key in ("k1", "k2", "k3", "k4", "p1", "p2"))
    plain = Intrinsics(*size, fl_x, fl_y, parameters["cx"], parameters["cy"])
    if model[0].endswith("FISHEYE"):
        return plain, Fisheye(k1, k2, k3, k4)
    return Intrinsics(*size, fl_x, fl_y, parameters["cx"], parameters["cy"], k1, k2, k3, p1, p2), None


def _model(key: object, where: str) -> tuple[str, str]:
    known: dict[object, tuple[str, str]] = {}
    for number, model in MODELS.items():
        known |= {number: model, model[0]: model}
    if key not in known:
        names = ", ".join(name for name, _ in MODELS.values())
        raise DataError(f"{where}: the camera model {str(key)[:40]!r} is not one of {names}; undistort the images")
    return known[key]


def _cameras_text(folder: Path) -> dict[int, Camera]:
    found = {}
    for number, line in read_lines(folder / "cameras.txt"):
        where = f"{folder / 'cameras.txt'}: line {number}"
        words = line.split()
        model = _model(words[1] if len(words) > 1 else "", where)
        values = numbers([words[0], *words[2:]], 3 + len(model[1].split()), where)
        found[int(values[0])] = _camera(model, (int(values[1]), int(values[2])), values[3:], where)
    return found


def _images_text(folder: Path) -> dict[str, tuple[int, np.ndarray, str]]:
    path = folder / "images.txt"
    text = read_bytes(path).decode("utf-8", "replace").splitlines()
    # Every second line lists the observed points of the image above and may be empty
    lines = [(n, line) for n, line in enumerate(text, 1) if not line.lstrip().startswith("#")]
    found = {}
    for number, line in lines[::2]:
        if not line.strip():
            continue
        where = f"{path}: line {number}"
        words = line.split(maxsplit=9)
        values = numbers(words[:9], 9, where)
        if len(words) < 10:
            raise DataError(f"{where} has no image name")
        found[words[9]] = (int(values[8]), _pose(values[1:8], where), where)
    return found


def _pose(values: list[float], where: str) -> np.ndarray:
    """Return the world-to-camera matrix of w x y z and a translation."""
    return quaternion_pose([*values[1:4], values[0]], values[4:7], where)


class _Reader:
    """Binary file that is read from the start to the end."""

    def __init__(self, path: Path) -> None:
        self.path, self.data, self.at = path, read_bytes(path), 0

    def take(self, layout: str) -> tuple:
        """Read numbers with a struct layout."""
        size = struct.calcsize(f"<{layout}")
        self.skip(size)
        return struct.unpack(f"<{layout}", self.data[self.at - size : self.at])

    def skip(self, size: int) -> None:
        """Skip bytes."""
        self.at += size
        if self.at > len(self.data):
            raise DataError(f"{self.path} is cut off: {len(self.data)} bytes, and {self.at} are needed")

    def name(self) -> str:
        """Read a text that ends with a zero byte."""
        end = self.data.find(b"\0", self.at)
        if end < 0:
            raise DataError(f"{self.path} is damaged: a name has no end")
        text, self.at = self.data[self.at : end], end + 1
        return text.decode("utf-8", "replace")


def _cameras_binary(folder: Path) -> dict[int, Camera]:
    reader = _Reader(folder / "cameras.bin")
    found = {}
    for _ in range(reader.take("Q")[0]):
        camera_id, model_id, width, height = reader.take("iiQQ")
        where = f"{reader.path}: camera {camera_id}"
        model = _model(model_id, where)
        values = list(reader.take(f"{len(model[1].split())}d"))
        found[camera_id] = _camera(model, (width, height), values, where)
    return found


def _images_binary(folder: Path) -> dict[str, tuple[int, np.ndarray, str]]:
    reader = _Reader(folder / "images.bin")
    found = {}
    for _ in range(reader.take("Q")[0]):
        image_id, *values, camera_id = reader.take("i7di")
        where = f"{reader.path}: image {image_id}"
        if not all(abs(value) < 1e9 for value in values):
            raise DataError(f"{where} has a pose of numbers that are not finite")
        name = reader.name()
        reader.skip(24 * reader.take("Q")[0])  # observed points: x, y, and the number of the 3-D point
        found[name] = (camera_id, _pose(values, where), where)
    return found
