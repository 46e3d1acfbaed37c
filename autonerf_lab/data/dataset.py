"""Posed images with any cameras: a nerfstudio or instant-ngp ``transforms.json``, or a trajectory of this package.

Poses stay in the frame and units of the file. ``applied_transform`` is not applied; it is stored in ``meta``.
"""

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from autonerf_lab.data.images import image_size, is_rotated, parallel, read_classes, read_depth, read_rgb, resample
from autonerf_lab.data.trajectory import Trajectory, describe
from autonerf_lab.data.transforms import CAMERA_KEYS, announced_size, read_camera, read_path, read_transforms
from autonerf_lab.errors import DataError
from autonerf_lab.geometry import Intrinsics

_LAYERS = {"depth_file_path": (read_depth, 4), "semantics_file_path": (read_classes, 1)}  # reader, bytes per pixel


@dataclass(frozen=True, eq=False)  # equality of arrays has no single truth value
class Dataset:
    """Posed images, which may have different intrinsics and sizes.

    Example:
        >>> trajectory = Trajectory(np.stack([np.eye(4)] * 9), np.zeros((9, 4, 6, 3), np.uint8), None, None,
        ...                         Intrinsics.from_fov(6, 4))
        >>> train, held_out = Dataset.from_trajectory(trajectory).split()
        >>> held_out
        Dataset: scene unknown, policy unknown
          2 frames of 6x4 pixels; layers: rgb
        >>> len(train), held_out.names
        (7, ['frame 0', 'frame 8'])
    """

    poses: np.ndarray  # (T, 4, 4) float64 camera-to-world, OpenGL, in the user's frame and units
    images: list[np.ndarray]  # T arrays (H_t, W_t, 3) uint8
    intrinsics: list[Intrinsics]  # T camera models
    semantics: list[np.ndarray] | None  # T arrays (H_t, W_t) uint8, class index
    depths: list[np.ndarray] | None  # T arrays (H_t, W_t) float32, along the optical axis, user units, 0 = none
    names: list[str]  # file of each frame, for messages
    meta: dict[str, Any]  # JSON: the file's other keys
    metric: bool  # True for trajectories: metres, indoors. False for photographs: unknown scale and background

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.poses)

    def __repr__(self) -> str:
        sizes = list(dict.fromkeys((camera.width, camera.height) for camera in self.intrinsics))
        return describe(self, sizes, {"depth": self.depths, "semantics": self.semantics})

    @classmethod
    def from_trajectory(cls, trajectory: Trajectory) -> "Dataset":
        """Return the frames of a trajectory as a dataset; arrays are shared, not copied."""
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
        """Check a dataset that was not made by :func:`load_dataset`.

        Raises:
            DataError: a pose is not rigid, or an image or layer differs in size from its intrinsics.
        """
        for t, (c2w, camera, name) in enumerate(zip(self.poses, self.intrinsics, self.names, strict=True)):
            if not (np.abs(c2w[:3, :3] @ c2w[:3, :3].T - np.eye(3)) < 1e-3).all() or not np.isfinite(c2w).all():
                raise DataError(f"{name}: the pose is not a rigid camera-to-world pose of finite numbers")
            for layer in (self.images, self.semantics, self.depths):
                if layer is not None and layer[t].shape[:2] != (camera.height, camera.width):
                    height, width = layer[t].shape[:2]
                    size = f"{camera.width}x{camera.height}"
                    raise DataError(f"{name}: {width}x{height} pixels, but intrinsics of {size}; correct one of them")

    def split(self, every: int = 8) -> tuple["Dataset", "Dataset"]:
        """Split into training frames and held-out frames.

        The split follows the lists of the file: ``train_filenames``, and ``test_filenames`` or else
        ``val_filenames``. A missing list contains the frames that are in none of the others. Without any list, every
        ``every``-th frame is held out, starting with the first.

        Raises:
            DataError: a list names a frame that does not exist, two lists share a frame, or a part is empty.
        """
        train, test, val = (self._listed(f"{name}_filenames") for name in ("train", "test", "val"))
        frames = set(range(len(self)))
        held_out = test if test is not None else val
        if train is None and held_out is None:
            if every < 2:
                raise DataError(f"every={every} would leave no frames to train on; use every=2 or more")
            held_out = set(range(0, len(self), every))
        if held_out is None:
            held_out = frames - (train or set())
        if train is None:
            train = frames - held_out - (val or set())
        if train & held_out:
            name = self.names[min(train & held_out)]
            raise DataError(f"{name} is in 'train_filenames' and held out, too; remove it from one of the lists")
        if not train or not held_out:
            raise DataError(
                f"{len(train)} frames to train on and {len(held_out)} held out; both must have at least one"
            )
        return self._take(sorted(train)), self._take(sorted(held_out))

    def _listed(self, key: str) -> set[int] | None:
        """Return the frames in a list of the file; None if the file has no such list."""
        names = self.meta.get(key)
        if names is None:
            return None
        if not isinstance(names, list):
            raise DataError(f"{key!r} must be a list of files")
        index = {Path(name).with_suffix("").as_posix(): t for t, name in enumerate(self.names)}
        index |= {name: t for t, name in enumerate(self.names)}  # an exact name takes precedence
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
            intrinsics=[self.intrinsics[t] for t in frames],
            semantics=self.semantics and [self.semantics[t] for t in frames],
            depths=self.depths and [self.depths[t] for t in frames],
            names=[self.names[t] for t in frames],
        )


def load_dataset(folder: str | Path, *, max_bytes: int = 1 << 30) -> Dataset:
    """Read posed photographs: the ``transforms.json`` of nerfstudio, instant-ngp or :meth:`Trajectory.save`.

    Intrinsics are scaled to images that are smaller than announced. Transparent pixels become white. Depth (16-bit PNG,
    millimetres) and semantics are read if every frame has them.

    Args:
        folder: holds ``transforms.json``; or the path of such a file under another name.
        max_bytes: limit for the decoded images. Larger datasets are downscaled by the smallest whole factor that fits,
            with a UserWarning.

    Raises:
        DataError: a file is missing or damaged, a camera is not supported, a pose is not valid, or there are fewer
            than two different poses. The message names the file or frame.

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
    data = read_transforms(path)
    content, frames = data.content, data.frames
    meta = {key: value for key, value in content.items() if key not in CAMERA_KEYS | {"frames", "autonerf_lab"}}
    if len(frames) < 2 or not np.ptp(data.poses, axis=0).any():
        raise DataError(f"{path}: photographs from two different poses are needed, not {len(frames)} from one")
    files = data.files("file_path")
    layers = {key: data.files(key) for key in _LAYERS if all(frame.get(key) is not None for frame in frames)}
    views = [
        _view(content, frame, file, data.where(t)) for t, (frame, file) in enumerate(zip(frames, files, strict=True))
    ]
    for names in layers.values():
        for file, (camera, _) in zip(names, views, strict=True):
            if not _same_aspect(image_size(file), (camera.width, camera.height)):
                raise DataError(
                    f"{file} must have the aspect ratio of its image, {camera.width}x{camera.height} pixels"
                )
    shrink = _shrink_factor(
        [camera for camera, _ in views], 3 + sum(_LAYERS[key][1] for key in layers), max_bytes, path
    )

    images: list[np.ndarray] = [np.empty(0)] * len(frames)
    arrays: dict[str, list[np.ndarray]] = {key: [np.empty(0)] * len(frames) for key in layers}

    def read(t: int) -> None:
        camera, rotate = views[t]
        images[t] = read_rgb(files[t], rotate, shrink)
        for key, names in layers.items():
            arrays[key][t] = resample(_LAYERS[key][0](names[t]), (camera.width, camera.height), shrink)

    parallel(read, len(frames))
    return Dataset(
        data.poses,
        images,
        [_shrunk(camera, shrink) for camera, _ in views],
        arrays.get("semantics_file_path"),
        arrays.get("depth_file_path"),
        [file.relative_to(path.parent).as_posix() for file in files],
        meta | data.meta,
        "autonerf_lab" in content,
    )


def _view(content: dict, frame: dict, file: Path, where: str) -> tuple[Intrinsics, bool]:
    """Return the intrinsics of a stored image, and True if EXIF must rotate it.

    Most structure-from-motion programs use the pixels as stored, so EXIF is used only if the announced size agrees
    with the rotated image alone.
    """
    size = image_size(file)
    announced = announced_size(content, frame, where) or size
    camera = read_camera(content, frame, announced, where)
    rotate = False
    if not _same_aspect(size, announced):
        rotate = _same_aspect(size[::-1], announced) and is_rotated(file)
        if not rotate:
            raise DataError(
                f"{file} has {size[0]}x{size[1]} pixels, but its frame has {announced[0]}x{announced[1]}: the aspect "
                "ratios differ; correct 'w' and 'h', or the image"
            )
    return camera if size == announced else camera.resized(*(size[::-1] if rotate else size)), rotate


def _same_aspect(a: tuple[int, int], b: tuple[int, int]) -> bool:
    """Return True if two sizes differ by a common factor, up to one pixel of rounding."""
    return abs(a[0] * b[1] - a[1] * b[0]) < max(b)


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
            f"{path}: the images are downscaled {factor} times to fit into max_bytes={max_bytes}", stacklevel=3
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
