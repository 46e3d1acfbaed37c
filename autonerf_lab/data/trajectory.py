"""Recorded trajectories: poses and images of one episode, in memory and as a folder.

The folder is a nerfstudio dataset: ``transforms.json`` (OpenGL camera-to-world), ``images/`` (PNG), ``depth/`` (16-bit
PNG, millimetres, 0 = none), ``semantics/`` (8-bit PNG, class index) and, for predicted classes, ``confidence/`` (8-bit
PNG, 255 = certain). Data without a nerfstudio key is stored under the key ``autonerf_lab``. ``transforms.json`` is
written last: a folder without it is unfinished.
"""

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from autonerf_lab.data.images import (
    check_png,
    parallel,
    read_bytes_image,
    read_classes,
    read_depth,
    read_rgb,
    valid_depth,
)
from autonerf_lab.data.pose_sources import POSE_SOURCES, check_source, read_sources, sources_to_json
from autonerf_lab.data.transforms import FORMAT_VERSION, announced_size, read_camera, read_transforms
from autonerf_lab.errors import DataError
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.utils import storage

MAX_BYTES = 2 << 30  # of decoded images
BYTES_PER_PIXEL = 9  # colour, depth, class and confidence
_FOLDERS = {"file_path": "images"} | {f"{name}_file_path": name for name in ("depth", "semantics", "confidence")}
_MAX_DEPTH_MM = 65535


@dataclass(frozen=True, eq=False)  # equality of arrays has no single truth value
class Trajectory:
    """Recording of one episode. Frame t holds the observation at which action t was chosen.

    ``poses`` are those of one pose source: ``true``, ``odometry``, ``estimated`` or ``refined``.
    :meth:`with_poses` gives the same recording with those of another source.

    Example:
        >>> Trajectory(np.eye(4)[None], np.zeros((1, 4, 6, 3), np.uint8), None, None, Intrinsics.from_fov(6, 4),
        ...            {"scene": "val-0", "policy": "frontier"})
        Trajectory: scene val-0, policy frontier
          1 frame of 6x4 pixels; layers: rgb
    """

    poses: np.ndarray  # (T, 4, 4) float64, camera-to-world, OpenGL, of the source ``pose_source``
    rgb: np.ndarray  # (T, H, W, 3) uint8
    depth: np.ndarray | None  # (T, H, W) float32, metres along the optical axis; invalid values become 0, "none"
    semantics: np.ndarray | None  # (T, H, W) uint8, class index
    intrinsics: Intrinsics
    meta: dict[str, Any] = field(default_factory=dict)  # JSON: scene, policy, seed, actions, coverage curves, ...
    pose_source: str = "true"  # one of :data:`autonerf_lab.data.pose_sources.POSE_SOURCES`
    other_poses: dict[str, np.ndarray] = field(default_factory=dict)  # source -> (T, 4, 4), without ``poses``
    confidence: np.ndarray | None = None  # (T, H, W) uint8, of predicted semantics, 255 = certain; None: they are true

    def __post_init__(self) -> None:
        """Replace invalid depth: programs mark pixels without a reading in various ways."""
        if self.depth is not None:
            object.__setattr__(self, "depth", valid_depth(self.depth))

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.poses)

    def __repr__(self) -> str:
        size = (self.intrinsics.width, self.intrinsics.height)
        text = describe(self, [size], {"depth": self.depth, "semantics": self.semantics})
        return f"{text}; poses: {self.pose_source}" if sources_to_json(self.pose_source, self.other_poses) else text

    @property
    def pose_sources(self) -> dict[str, np.ndarray]:
        """Poses of all sources that the trajectory has, (T, 4, 4) each, by name."""
        every = {**self.other_poses, self.pose_source: self.poses}
        return {name: every[name] for name in POSE_SOURCES if name in every}

    def with_poses(self, source: str, poses: np.ndarray | None = None) -> "Trajectory":
        """Return the trajectory with the poses of another source; arrays are shared, not copied.

        Args:
            source: ``true``, ``odometry``, ``estimated`` or ``refined``.
            poses: (T, 4, 4) camera-to-world poses to add under this name; None for those that the trajectory has.

        Raises:
            UnknownNameError: there is no pose source of that name.
            DataError: the trajectory does not have these poses, or ``poses`` has another shape.

        Example:
            >>> trajectory = Trajectory(np.eye(4)[None], np.zeros((1, 4, 6, 3), np.uint8), None, None,
            ...                         Intrinsics.from_fov(6, 4), pose_source="odometry")
            >>> corrected = trajectory.with_poses("refined", np.eye(4)[None])
            >>> corrected.pose_source, list(corrected.pose_sources), corrected.with_poses("odometry").pose_source
            ('refined', ['odometry', 'refined'], 'odometry')
        """
        check_source(source, POSE_SOURCES if poses is not None else self.pose_sources)
        chosen = self.pose_sources[source] if poses is None else np.asarray(poses, dtype=np.float64)
        others = {name: value for name, value in self.pose_sources.items() if name != source}
        if chosen.shape != (len(self), 4, 4):
            raise DataError(f"poses have the shape {chosen.shape}, not {(len(self), 4, 4)}: one pose for each frame")
        return replace(self, poses=chosen, pose_source=source, other_poses=others)

    def save(self, folder: str | Path) -> None:
        """Write a trajectory folder; an existing one is replaced. :func:`load_trajectory` reads it.

        Depth is rounded to the millimetre, and depth beyond 65.535 m becomes 0, "none".

        Args:
            folder: created if it does not exist.

        Raises:
            DataError: a file cannot be written, the arrays do not belong together, or the folder holds another data
                set, whose images would be lost.

        Example:
            >>> import tempfile
            >>> rgb = np.zeros((1, 4, 6, 3), np.uint8)
            >>> trajectory = Trajectory(np.eye(4)[None], rgb, None, None, Intrinsics.from_fov(6, 4))
            >>> trajectory.save(tempfile.mkdtemp() + "/trajectory")
        """
        folder = Path(folder)
        _check_arrays(self)
        _check_replaceable(folder)
        layers: dict[str, np.ndarray] = {"file_path": self.rgb}
        if self.depth is not None:
            millimetres = np.rint(self.depth * np.float32(1000))
            layers["depth_file_path"] = np.where(millimetres <= _MAX_DEPTH_MM, millimetres, 0).astype(np.uint16)
        if self.semantics is not None:
            layers["semantics_file_path"] = self.semantics
        if self.confidence is not None:
            layers["confidence_file_path"] = self.confidence
        try:
            # An old transforms.json beside half of the new images would look finished.
            (folder / "transforms.json").unlink(missing_ok=True)
            for name in _FOLDERS.values():
                if (folder / name).is_symlink():
                    raise DataError(f"{folder / name} is a symbolic link, which is not followed; choose another folder")
                for stale in (*(folder / name).glob("frame_*.png"), *storage.interrupted_writes(folder / name)):
                    stale.unlink()
            for key in layers:
                (folder / _FOLDERS[key]).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise DataError(f"cannot write {folder}: {error.strerror or error}; choose another folder") from error
        parallel(lambda t: _write_frame(folder, layers, t), len(self))
        self.save_poses(folder)

    def save_poses(self, folder: str | Path) -> None:
        """Write poses and metadata into the folder of this trajectory, whose images stay as they are.

        Args:
            folder: holds the images of this trajectory, written by :meth:`save`.

        Raises:
            DataError: ``transforms.json`` cannot be written; an existing one stays.
        """
        present = {"depth": self.depth, "semantics": self.semantics, "confidence": self.confidence}
        keys = ["file_path", *(f"{name}_file_path" for name, array in present.items() if array is not None)]
        k = self.intrinsics
        storage.write_json(
            Path(folder) / "transforms.json",
            {
                "camera_model": "OPENCV",
                **{"w": k.width, "h": k.height, "fl_x": k.fl_x, "fl_y": k.fl_y, "cx": k.cx, "cy": k.cy},
                **{"k1": k.k1, "k2": k.k2, "k3": k.k3, "p1": k.p1, "p2": k.p2},
                "autonerf_lab": {
                    "version": FORMAT_VERSION,
                    **self.meta,
                    **sources_to_json(self.pose_source, self.other_poses),
                },
                "frames": [
                    {**{key: _frame_path(key, t) for key in keys}, "transform_matrix": pose.tolist()}
                    for t, pose in enumerate(self.poses)
                ],
            },
        )


def load_trajectory(folder: str | Path, max_bytes: int = MAX_BYTES) -> Trajectory:
    """Read a trajectory folder: one camera without distortion, rigid poses, PNG images of one size.

    Depth and semantics are None if no frame has them.

    Args:
        folder: holds ``transforms.json``.
        max_bytes: limit for the memory of the decoded images.

    Raises:
        DataError: a file is missing, damaged or does not belong to the trajectory; the message names it.

    Example:
        >>> load_trajectory("/nowhere")
        Traceback (most recent call last):
        autonerf_lab.errors.DataError: /nowhere/transforms.json does not exist; is this a trajectory folder, \
and was it finished?
    """
    path = Path(folder) / "transforms.json"
    if not path.exists():
        raise DataError(f"{path} does not exist; is this a trajectory folder, and was it finished?")
    data = read_transforms(path, strict=True)
    size = announced_size(data.content, {}, path)
    if size is None:
        raise DataError(f"{path}: 'w' and 'h' are missing")
    intrinsics = read_camera(data.content, {}, size, path)
    if any(intrinsics.lens):
        raise DataError(f"{path}: a trajectory has no lens distortion; read photographs with load_dataset")
    shape, count = (size[1], size[0]), len(data.frames)
    source, others, meta = read_sources(data.meta, count, path)
    confident = any(frame.get("confidence_file_path") is not None for frame in data.frames)
    per_pixel = BYTES_PER_PIXEL if confident else BYTES_PER_PIXEL - 1
    need = count * shape[0] * shape[1] * per_pixel
    if need > max_bytes:
        raise DataError(
            f"{path}: the images need {need} bytes, more than max_bytes={max_bytes}; use a larger max_bytes"
        )
    readers: dict[str, tuple[Callable[..., np.ndarray], tuple[int, ...], str]] = {
        "file_path": (read_rgb, (3,), "u1"),
        "depth_file_path": (read_depth, (), "f4"),
        "semantics_file_path": (read_classes, (), "u1"),
        "confidence_file_path": (read_bytes_image, (), "u1"),
    }
    files, arrays = {}, {}
    for key, (_, tail, dtype) in readers.items():
        if key == "file_path" or any(frame.get(key) is not None for frame in data.frames):
            files[key] = data.files(key)
            check_png(files[key][0], size)  # before memory is allocated by the size in the JSON
            arrays[key] = np.empty((count, *shape, *tail), dtype)

    def read(t: int) -> None:
        for key, array in arrays.items():
            array[t] = readers[key][0](files[key][t], png_size=size)

    parallel(read, count)
    depth, semantics = arrays.get("depth_file_path"), arrays.get("semantics_file_path")
    confidence = arrays.get("confidence_file_path")
    return Trajectory(data.poses, arrays["file_path"], depth, semantics, intrinsics, meta, source, others, confidence)


def describe(data: Any, sizes: Sequence[tuple[int, int]], layers: dict[str, Any]) -> str:
    """Return two lines about a trajectory or dataset: scene and policy; frames, image sizes and layers.

    Args:
        data: has ``meta`` and a length.
        sizes: distinct (width, height) of the images, pixels.
        layers: optional layers by name, None if missing.
    """
    scene, policy = (data.meta.get(key) or "unknown" for key in ("scene", "policy"))
    size = f"{sizes[0][0]}x{sizes[0][1]} pixels" if len(sizes) == 1 else f"{len(sizes)} sizes"
    names = ", ".join(["rgb", *(name for name, layer in layers.items() if layer is not None)])
    frames = f"{len(data)} frame{'' if len(data) == 1 else 's'}"
    return f"{type(data).__name__}: scene {scene}, policy {policy}\n  {frames} of {size}; layers: {names}"


def _check_replaceable(folder: Path) -> None:
    """Refuse to replace data that are not a trajectory of this package; photographs may have the same file names."""
    path = folder / "transforms.json"
    if path.exists() and "autonerf_lab" not in storage.read_json(path, dict[str, Any]):
        raise DataError(f"{folder} holds another data set; choose another folder for the trajectory")


def _check_arrays(trajectory: Trajectory) -> None:
    shape = (len(trajectory), trajectory.intrinsics.height, trajectory.intrinsics.width)
    for name, array, want in (
        ("poses", trajectory.poses, (len(trajectory), 4, 4)),
        *((f"other_poses[{name!r}]", poses, (len(trajectory), 4, 4)) for name, poses in trajectory.other_poses.items()),
        ("rgb", trajectory.rgb, (*shape, 3)),
        ("depth", trajectory.depth, shape),
        ("semantics", trajectory.semantics, shape),
        ("confidence", trajectory.confidence, shape),
    ):
        if array is not None and array.shape != want:
            raise DataError(f"trajectory.{name} has the shape {array.shape}, not {want}")
    if not len(trajectory):
        raise DataError("a trajectory without frames cannot be saved")


def _frame_path(key: str, t: int) -> str:
    return f"{_FOLDERS[key]}/frame_{t:05d}.png"


def _write_frame(folder: Path, layers: dict[str, np.ndarray], t: int) -> None:
    for key, array in layers.items():
        buffer = io.BytesIO()
        Image.fromarray(array[t]).save(buffer, "PNG", compress_level=1)
        storage.write_bytes(folder / _frame_path(key, t), buffer.getvalue(), durable=False)
