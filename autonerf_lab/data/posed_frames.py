"""Posed frames of any format: the files, cameras and poses that a reader found, and the decoding of their images."""

import warnings
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from autonerf_lab.data.fisheye import Fisheye, rectify
from autonerf_lab.data.images import (
    image_size,
    parallel,
    read_bytes_image,
    read_classes,
    read_depth,
    read_mask,
    read_rgb,
    resample,
)
from autonerf_lab.errors import DataError
from autonerf_lab.geometry import Intrinsics

_BYTES = {"depths": 4, "semantics": 1, "confidences": 1, "masks": 1}  # per pixel


@dataclass(frozen=True)
class PosedFrames:
    """Frames of one capture. Lists have one entry per frame."""

    root: Path  # folder to which the names of the frames are relative
    poses: np.ndarray  # (T, 4, 4) float64 camera-to-world, OpenGL
    files: list[Path]  # images
    cameras: list[Intrinsics]  # of the images as stored
    meta: dict[str, Any] = field(default_factory=dict)
    metric: bool = False  # metres, indoors
    depths: list[Path] | None = None  # 16-bit PNG
    depth_unit: float = 0.001  # metres (or units of the poses) per unit of the depth images
    depth_camera: Intrinsics | None = None  # of the depth images, if it differs from that of the images
    semantics: list[Path] | None = None
    confidences: list[Path] | None = None  # of the semantics, 8-bit PNG
    masks: list[Path | None] | None = None
    rotated: list[bool] | None = None  # EXIF must rotate the image
    lenses: list[Fisheye | None] | None = None
    pose_source: str = "true"
    true_poses: np.ndarray | None = None  # (T, 4, 4), if they are known and ``poses`` are others


def read_images(
    frames: PosedFrames, max_bytes: int
) -> tuple[list[np.ndarray], list[Intrinsics], dict[str, list[np.ndarray]]]:
    """Decode the images and layers of a capture.

    Args:
        frames: the capture.
        max_bytes: limit for the decoded images; larger ones are downscaled by the smallest whole factor that fits.

    Returns:
        T images (H_t, W_t, 3) uint8, their intrinsics, and the layers that the capture has: ``depths`` float32,
        ``semantics`` uint8, ``confidences`` uint8 and ``masks`` bool, each T arrays (H_t, W_t).

    Raises:
        DataError: a file is damaged, or has another aspect ratio than its image.
    """
    files = {name: getattr(frames, name) for name in _BYTES}
    lenses = frames.lenses or [None] * len(frames.files)
    has = [name for name, value in files.items() if value is not None]
    if any(lenses) and "masks" not in has:
        has.append("masks")
    for name in has:
        for file, camera in zip(files[name] or [None] * len(lenses), frames.cameras, strict=True):
            ours = frames.depth_camera if name == "depths" and frames.depth_camera else camera
            if file is not None and not same_aspect(image_size(file), (ours.width, ours.height)):
                raise DataError(f"{file} must have the aspect ratio of its image, {ours.width}x{ours.height} pixels")
    shrink = _shrink_factor(frames.cameras, 3 + sum(_BYTES[name] for name in has), max_bytes, frames.root)
    images: list[np.ndarray] = [np.empty(0)] * len(frames.files)
    layers: dict[str, list[np.ndarray]] = {name: [np.empty(0)] * len(frames.files) for name in has}
    rotated = frames.rotated or [False] * len(frames.files)
    smaller = [_shrunk(camera, shrink) for camera in frames.cameras]

    def read(t: int) -> None:
        camera, lens = frames.cameras[t], lenses[t]
        size = (camera.width, camera.height)
        images[t] = read_rgb(frames.files[t], rotated[t], shrink)
        if "depths" in layers and frames.depths is not None:
            depth = read_depth(frames.depths[t], unit=frames.depth_unit)
            if frames.depth_camera is None:
                layers["depths"][t] = resample(depth, size, shrink)
            else:
                layers["depths"][t] = _seen_by(depth, frames.depth_camera, smaller[t])
        if "semantics" in layers and frames.semantics is not None:
            layers["semantics"][t] = resample(read_classes(frames.semantics[t]), size, shrink)
        if "confidences" in layers and frames.confidences is not None:
            layers["confidences"][t] = resample(read_bytes_image(frames.confidences[t]), size, shrink)
        if "masks" in layers:
            mask = None if frames.masks is None else frames.masks[t]
            used = np.ones((1, 1), bool) if mask is None else read_mask(mask)
            layers["masks"][t] = resample(used, size, shrink)
        if lens is not None:
            images[t], inside = rectify(images[t], smaller[t], lens)
            for layer in layers.values():
                layer[t] = rectify(layer[t], smaller[t], lens, nearest=True)[0]
            layers["masks"][t] &= inside

    parallel(read, len(frames.files))
    return images, smaller, layers


def same_aspect(a: tuple[int, int], b: tuple[int, int]) -> bool:
    """Return True if two sizes differ by a common factor, up to one pixel of rounding."""
    return abs(a[0] * b[1] - a[1] * b[0]) < max(b)


def fit_camera(camera: Intrinsics, file: Path) -> Intrinsics:
    """Return the camera with the size of a stored image, which must have its aspect ratio.

    Raises:
        DataError: the file is no image, or its aspect ratio differs.
    """
    size = image_size(file)
    if not same_aspect(size, (camera.width, camera.height)):
        raise DataError(
            f"{file} has {size[0]}x{size[1]} pixels, but its camera has {camera.width}x{camera.height}: the aspect "
            "ratios differ; correct the size in the camera file, or the image"
        )
    return camera if size == (camera.width, camera.height) else camera.resized(*size)


def _seen_by(depth: np.ndarray, camera: Intrinsics, other: Intrinsics) -> np.ndarray:
    """Return the depth at the pixels of another camera at the same position, by nearest neighbours; 0 outside."""
    camera = camera.resized(depth.shape[1], depth.shape[0])
    x = (np.arange(other.width) + 0.5 - other.cx) / other.fl_x * camera.fl_x + camera.cx
    y = (np.arange(other.height) + 0.5 - other.cy) / other.fl_y * camera.fl_y + camera.cy
    inside = ((x >= 0) & (x < camera.width))[None, :] & ((y >= 0) & (y < camera.height))[:, None]
    columns, rows = (np.clip(v, 0, n - 1).astype(int) for v, n in ((x, camera.width), (y, camera.height)))
    return np.where(inside, depth[rows[:, None], columns], np.float32(0))


def _shrink_factor(cameras: Iterable[Intrinsics], pixel_bytes: int, max_bytes: int, path: Path) -> int:
    """Return the smallest whole factor by which the images fit into ``max_bytes``."""
    sizes = np.array([(camera.height, camera.width) for camera in cameras])
    for factor in count(1):
        need = int(np.prod(-(-sizes // factor), axis=1).sum()) * pixel_bytes
        if need <= max_bytes:
            break
        if factor > sizes.max():
            raise DataError(
                f"{path}: {len(sizes)} images do not fit into max_bytes={max_bytes}; use a larger max_bytes"
            )
    if factor > 1:
        warnings.warn(
            f"{path}: the images are downscaled {factor} times to fit into max_bytes={max_bytes}", stacklevel=4
        )
    return factor


def _shrunk(camera: Intrinsics, factor: int) -> Intrinsics:
    """Return the intrinsics of a downscaled image; its last row and column may be means of fewer pixels."""
    return replace(
        camera,
        width=-(-camera.width // factor),
        height=-(-camera.height // factor),
        fl_x=camera.fl_x / factor,
        fl_y=camera.fl_y / factor,
        cx=camera.cx / factor,
        cy=camera.cy / factor,
    )
