"""Reader of ``transforms.json`` (nerfstudio, instant-ngp, trajectories of this package) and Blender's split files."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from autonerf_lab.data.fisheye import Fisheye
from autonerf_lab.data.images import image_size, is_rotated
from autonerf_lab.data.pose_sources import read_sources
from autonerf_lab.data.posed_frames import PosedFrames, same_aspect
from autonerf_lab.data.transforms import CAMERA_KEYS, announced_size, number, read_camera, read_transforms
from autonerf_lab.errors import DataError
from autonerf_lab.geometry import Intrinsics

_LENS = ("k1", "k2", "k3", "k4", "p1", "p2")
SPLITS = ("train", "val", "test")


def read_transforms_json(path: Path) -> PosedFrames:
    """Read a file like ``transforms.json``."""
    data = read_transforms(path)
    content, frames = data.content, data.frames
    meta = {key: value for key, value in content.items() if key not in CAMERA_KEYS | {"frames", "autonerf_lab"}}
    source, others, own_meta = read_sources(data.meta, len(frames), path)
    files = data.files("file_path")
    layers = {
        key: data.files(f"{key}_file_path")
        for key in ("depth", "semantics", "confidence")
        if all(frame.get(f"{key}_file_path") is not None for frame in frames)
    }
    cameras, rotated, lenses = [], [], []
    for t, (frame, file) in enumerate(zip(frames, files, strict=True)):
        lens, shared, own = _fisheye(content, frame, data.where(t))
        camera, rotate = _view(shared, own, file, data.where(t))
        cameras.append(camera)
        rotated.append(rotate)
        lenses.append(lens)
    return PosedFrames(
        path.parent,
        data.poses,
        files,
        cameras,
        meta | own_meta,
        "autonerf_lab" in content,
        layers.get("depth"),
        semantics=layers.get("semantics"),
        confidences=layers.get("confidence"),
        masks=data.optional_files("mask_path"),
        rotated=rotated,
        lenses=lenses if any(lenses) else None,
        pose_source=source,
        true_poses=others.get("true"),
    )


def read_blender(folder: Path) -> PosedFrames:
    """Read ``transforms_train.json`` and those of ``val`` and ``test`` as one dataset that remembers its split."""
    parts = {
        name: read_transforms_json(folder / f"transforms_{name}.json")
        for name in SPLITS
        if (folder / f"transforms_{name}.json").is_file()
    }
    first = next(iter(parts.values()))
    for name, part in parts.items():
        if part.pose_source != first.pose_source:
            raise DataError(
                f"{folder / f'transforms_{name}.json'} has poses of the source {part.pose_source!r}, but the first "
                f"file has {first.pose_source!r}: save all of them with poses of one source"
            )
    meta = {f"{name}_filenames": [f.relative_to(folder).as_posix() for f in part.files] for name, part in parts.items()}

    def joined(layer: str, optional: bool = False) -> list[Any] | None:
        """Return a list of all frames; ``optional``: None in the frames of a file without it, else all must have it."""
        found = [(getattr(part, layer), len(part.files)) for part in parts.values()]
        missing = [values is None for values, _ in found]
        if all(missing) or (any(missing) and not optional):
            return None
        return [value for values, count in found for value in ([None] * count if values is None else values)]

    return replace(
        first,
        poses=np.concatenate([part.poses for part in parts.values()]),
        files=[file for part in parts.values() for file in part.files],
        cameras=[camera for part in parts.values() for camera in part.cameras],
        rotated=joined("rotated"),
        meta=first.meta | meta,
        depths=joined("depths"),
        semantics=joined("semantics"),
        confidences=joined("confidences"),
        masks=joined("masks", optional=True),
        lenses=joined("lenses", optional=True),
        true_poses=None if (true := joined("true_poses")) is None else np.array(true),
    )


def _fisheye(content: dict, frame: dict, where: str) -> tuple[Fisheye | None, dict, dict]:
    """Return the lens of a fisheye, and file and frame without its keys; None for another camera."""
    both = {**content, **frame}
    if both.get("camera_model") != "OPENCV_FISHEYE" and both.get("is_fisheye") in (None, False):
        return None, content, frame
    lens = Fisheye(*(number(both.get(key, 0), key, where) for key in ("k1", "k2", "k3", "k4")))
    drop = {"camera_model", "is_fisheye", *_LENS}
    shared, own = ({k: v for k, v in part.items() if k not in drop} for part in (content, frame))
    return lens, shared, own


def _view(content: dict, frame: dict, file: Path, where: str) -> tuple[Intrinsics, bool]:
    """Return the intrinsics of a stored image, and True if EXIF must rotate it.

    Most structure-from-motion programs use the pixels as stored, so EXIF is used only if the announced size agrees
    with the rotated image alone.
    """
    size = image_size(file)
    announced = announced_size(content, frame, where) or size
    camera = read_camera(content, frame, announced, where)
    rotate = False
    if not same_aspect(size, announced):
        rotate = same_aspect(size[::-1], announced) and is_rotated(file)
        if not rotate:
            raise DataError(
                f"{file} has {size[0]}x{size[1]} pixels, but its frame has {announced[0]}x{announced[1]}: the aspect "
                "ratios differ; correct 'w' and 'h', or the image"
            )
    return camera if size == announced else camera.resized(*(size[::-1] if rotate else size)), rotate
