"""Photographs with poses: a nerfstudio or instant-ngp ``transforms.json``, or a walk of this project.

Poses stay in the frame and the units of the file, whatever ``applied_transform`` says; it is kept in ``meta``.
"""

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from autonerf_lab.data.images import (
    is_turned,
    parallel,
    picture_size,
    read_classes,
    read_depth,
    read_rgb,
    resample,
)
from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.data.transforms import (
    CAMERA_KEYS,
    announced_size,
    read_camera,
    read_frames,
    read_meta,
    read_path,
    read_pose,
)
from autonerf_lab.errors import DataError
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.utils.storage import read_json

_EXTENSIONS = (".png", ".jpg", ".jpeg", ".JPG", ".PNG", ".JPEG", ".webp", ".WEBP")
_LAYERS = {"depth_file_path": (read_depth, 4), "semantics_file_path": (read_classes, 1)}  # reader, bytes a pixel


@dataclass(frozen=True)
class Dataset:
    """Posed photographs, which need not share a camera or a size.

    Example:
        >>> walk = Trajectory(np.stack([np.eye(4)] * 9), np.zeros((9, 4, 6, 3), np.uint8), None, None,
        ...                   Intrinsics.from_fov(6, 4))
        >>> train, held_out = Dataset.of(walk).split()
        >>> len(train), held_out.names
        (7, ['frame 0', 'frame 8'])
    """

    poses: np.ndarray  # (T, 4, 4) float64 camera-to-world, OpenGL, in the user's frame and units
    images: list[np.ndarray]  # T arrays (H_t, W_t, 3) uint8
    cameras: list[Intrinsics]  # T
    semantics: list[np.ndarray] | None  # T arrays (H_t, W_t) uint8, class index
    depths: list[np.ndarray] | None  # T arrays (H_t, W_t) float32, along the optical axis, user units, 0 = none
    names: list[str]  # file of each frame, for messages
    meta: dict[str, Any]  # JSON: what the file says besides cameras and frames
    metric: bool  # True for walks: metres, walls all around. False for photographs: unknown scale and background

    def __len__(self) -> int:
        return len(self.poses)

    @classmethod
    def of(cls, trajectory: Trajectory) -> "Dataset":
        """A walk in memory; the arrays are shared, not copied."""
        return cls(
            trajectory.poses,
            list(trajectory.rgb),
            [trajectory.intrinsics] * len(trajectory),
            None if trajectory.semantics is None else list(trajectory.semantics),
            None if trajectory.depth is None else list(trajectory.depth),
            [f"frame {t}" for t in range(len(trajectory))],
            trajectory.meta,
            True,
        )

    def check(self) -> None:
        """Raise where a dataset made by hand does not hold together; those of :func:`load_dataset` do.

        Raises:
            DataError: names the frame whose pose is not rigid, or whose image or layer has not its camera's size.
        """
        for t, (c2w, camera, name) in enumerate(zip(self.poses, self.cameras, self.names, strict=True)):
            if not (np.abs(c2w[:3, :3] @ c2w[:3, :3].T - np.eye(3)) < 1e-3).all() or not np.isfinite(c2w).all():
                raise DataError(f"{name}: the pose is not a rigid camera-to-world pose of finite numbers")
            for layer in (self.images, self.semantics, self.depths):
                if layer is not None and layer[t].shape[:2] != (camera.height, camera.width):
                    height, width = layer[t].shape[:2]
                    raise DataError(f"{name}: {width}x{height} pixels, and a camera of {camera.width}x{camera.height}")

    def split(self, every: int = 8) -> tuple["Dataset", "Dataset"]:
        """The frames to train on, and those held out.

        They are those that the file lists (``train_filenames``, and ``test_filenames`` or else ``val_filenames``; a
        list that is absent is what the others leave over). A file without lists holds out every ``every``-th frame,
        the first one included.

        Raises:
            DataError: a list names frames that do not exist or that another list names too, or a half is empty.
        """
        train, test, val = (self._listed(f"{name}_filenames") for name in ("train", "test", "val"))
        frames = set(range(len(self)))
        held_out = test if test is not None else val
        if train is None and held_out is None:
            if every < 2:
                raise DataError(f"every {every}th frame cannot be held out; give every=2 or more")
            held_out = set(range(0, len(self), every))
        if held_out is None:
            held_out = frames - (train or set())
        if train is None:
            train = frames - held_out - (val or set())
        if train & held_out:
            name = self.names[min(train & held_out)]
            raise DataError(f"{name} is in 'train_filenames' and held out too; take it out of one of the lists")
        if not train or not held_out:
            raise DataError(f"{len(train)} frames to train on and {len(held_out)} held out; both need at least one")
        return self._take(sorted(train)), self._take(sorted(held_out))

    def _listed(self, key: str) -> set[int] | None:
        names = self.meta.get(key)
        if names is None:
            return None
        if not isinstance(names, list):
            raise DataError(f"{key!r} must be a list of files")
        index = {Path(name).with_suffix("").as_posix(): t for t, name in enumerate(self.names)}
        index |= {name: t for t, name in enumerate(self.names)}  # the name as it stands comes first
        listed = set()
        for name in names:
            frame = index.get(read_path(name, key, "transforms.json"))
            if frame is None:
                raise DataError(f"{key!r} lists {name[:80]!r}, which is not the 'file_path' of a frame")
            listed.add(frame)
        return listed

    def _take(self, frames: Sequence[int]) -> "Dataset":
        return replace(
            self,
            poses=self.poses[frames],
            images=[self.images[t] for t in frames],
            cameras=[self.cameras[t] for t in frames],
            semantics=self.semantics and [self.semantics[t] for t in frames],
            depths=self.depths and [self.depths[t] for t in frames],
            names=[self.names[t] for t in frames],
        )


def load_dataset(folder: str | Path, *, max_bytes: int = 1 << 30) -> Dataset:
    """Read posed photographs: the ``transforms.json`` of nerfstudio, instant-ngp or :meth:`Trajectory.save`.

    Images that are smaller than announced bring their camera along. What is transparent becomes white. Depth (16-bit
    PNG, millimetres) and semantics are read when every frame has them.

    Args:
        folder: holds ``transforms.json``; or the path of such a file under another name.
        max_bytes: when the decoded images would take more memory than this, all of them are shrunk by the smallest
            whole factor that fits, and a UserWarning says so.

    Raises:
        DataError: a file that is missing, damaged, or not what it says; a camera that is not supported; a pose that is
            not one; fewer than two different poses. The message names the file or the frame.

    Example:
        >>> load_dataset("/nowhere")
        Traceback (most recent call last):
        autonerf_lab.errors.DataError: /nowhere/transforms.json does not exist; give a folder of posed photographs, \
or the path of its JSON file
    """
    path = Path(folder)
    path = path if path.suffix == ".json" else path / "transforms.json"
    if not path.is_file():
        others = ", ".join(sorted(file.name for file in path.parent.glob("transforms*.json")))
        hint = f"there is {others}" if others else "give a folder of posed photographs, or the path of its JSON file"
        raise DataError(f"{path} does not exist; {hint}")
    content = read_json(path)
    meta = {key: value for key, value in content.items() if key not in CAMERA_KEYS | {"frames", "autonerf_lab"}}
    meta |= read_meta(content, path)
    frames = read_frames(content, path)
    poses = np.stack([read_pose(frame.get("transform_matrix"), f"{path}: frame {t}") for t, frame in enumerate(frames)])
    if len(frames) < 2 or not np.ptp(poses, axis=0).any():
        raise DataError(f"{path}: photographs from two different poses are needed, not {len(frames)} from one")
    files = _files(frames, "file_path", path)
    layers = {key: _files(frames, key, path) for key in _LAYERS if all(frame.get(key) is not None for frame in frames)}
    views = [
        _view(content, frame, file, f"{path}: frame {t}")
        for t, (frame, file) in enumerate(zip(frames, files, strict=True))
    ]
    for names in layers.values():
        for file, (camera, _) in zip(names, views, strict=True):
            if not _same_view(picture_size(file), (camera.width, camera.height)):
                raise DataError(f"{file} has not the shape of its image, {camera.width}x{camera.height} pixels")
    shrink = _shrink_factor(
        [camera for camera, _ in views], 3 + sum(_LAYERS[key][1] for key in layers), max_bytes, path
    )

    images: list[np.ndarray] = [np.empty(0)] * len(frames)
    arrays: dict[str, list[np.ndarray]] = {key: [np.empty(0)] * len(frames) for key in layers}

    def read(t: int) -> None:
        camera, turn = views[t]
        images[t] = read_rgb(files[t], turn, shrink)
        for key, names in layers.items():
            arrays[key][t] = resample(_LAYERS[key][0](names[t]), (camera.width, camera.height), shrink)

    parallel(read, len(frames))
    return Dataset(
        poses,
        images,
        [_shrunk(camera, shrink) for camera, _ in views],
        arrays.get("semantics_file_path"),
        arrays.get("depth_file_path"),
        [file.relative_to(path.parent).as_posix() for file in files],
        meta,
        "autonerf_lab" in content,
    )


def _files(frames: list[dict], key: str, path: Path) -> list[Path]:
    """The file of each frame; all are there, and no two are the same."""
    names = [read_path(frame.get(key), key, f"{path}: frame {t}") for t, frame in enumerate(frames)]
    found = [_find(path.parent / name) for name in names]
    missing = [name for name, file in zip(names, found, strict=True) if file is None]
    if missing:
        raise DataError(
            f"{path}: {missing[0][:200]!r} does not exist, and {len(missing)} of {len(names)} files of {key!r} are "
            f"missing (also with {' '.join(_EXTENSIONS)}); bring them, or take their frames out"
        )
    first: dict[Path, int] = {}
    for t, file in enumerate(files := [file for file in found if file]):
        if first.setdefault(file, t) != t:
            raise DataError(f"{path}: frames {first[file]} and {t} share the {key!r} {names[t]!r}; take one out")
    return files


def _find(file: Path) -> Path | None:
    try:
        return next((f for f in (file, *(Path(f"{file}{end}") for end in _EXTENSIONS)) if f.is_file()), None)
    except OSError:  # a name that is too long
        return None


def _view(content: dict, frame: dict, file: Path, where: str) -> tuple[Intrinsics, bool]:
    """The camera of an image as it is stored, and whether EXIF turns it by a quarter.

    Programs that find poses mostly look at the pixels as stored, so EXIF is believed only where the announced size
    agrees with it alone.
    """
    size = picture_size(file)
    announced = announced_size(content, frame, where) or size
    camera = read_camera(content, frame, announced, where)
    turn = False
    if not _same_view(size, announced):
        turn = _same_view(size[::-1], announced) and is_turned(file)
        if not turn:
            raise DataError(
                f"{file} has {size[0]}x{size[1]} pixels, which is another shape than the announced "
                f"{announced[0]}x{announced[1]}; correct 'w' and 'h', or the image"
            )
    return camera if size == announced else camera.resized(*(size[::-1] if turn else size)), turn


def _same_view(a: tuple[int, int], b: tuple[int, int]) -> bool:
    """Whether two sizes differ by a common factor, up to the rounding of one pixel."""
    return abs(a[0] * b[1] - a[1] * b[0]) < max(b)


def _shrink_factor(cameras: Iterable[Intrinsics], pixel_bytes: int, max_bytes: int, path: Path) -> int:
    """The smallest whole factor by which the images fit."""
    sizes = np.array([(camera.height, camera.width) for camera in cameras])
    for factor in count(1):
        need = int(np.prod(-(-sizes // factor), axis=1).sum()) * pixel_bytes
        if need <= max_bytes:
            break
        if factor > sizes.max():
            raise DataError(f"{path}: {len(sizes)} images do not fit into max_bytes={max_bytes}; raise it")
    if factor > 1:
        warnings.warn(
            f"{path}: the images are shrunk {factor} times, because they do not fit into max_bytes={max_bytes}",
            stacklevel=3,
        )
    return factor


def _shrunk(camera: Intrinsics, factor: int) -> Intrinsics:
    """The camera of a shrunk image, whose last row and column may be the mean of fewer pixels."""
    return replace(
        camera,
        width=-(-camera.width // factor),
        height=-(-camera.height // factor),
        fl_x=camera.fl_x / factor,
        fl_y=camera.fl_y / factor,
        cx=camera.cx / factor,
        cy=camera.cy / factor,
    )
