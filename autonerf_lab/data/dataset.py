"""Posed images with any cameras: photographs, RGB-D sequences, or a trajectory of this package.

Poses stay in the frame and units of the file. ``applied_transform`` is not applied; it is stored in ``meta``.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from autonerf_lab.data.images import valid_depth
from autonerf_lab.data.posed_frames import read_images
from autonerf_lab.data.readers import read_frames
from autonerf_lab.data.trajectory import Trajectory, describe
from autonerf_lab.data.transforms import read_path
from autonerf_lab.errors import DataError
from autonerf_lab.geometry import Intrinsics

COVARIANCE_KEY = "refined_covariance"  # in the metadata
BY_FRAME = ("time_stamps", COVARIANCE_KEY)  # keys of the metadata with one entry per frame


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
    depths: list[np.ndarray] | None  # T arrays (H_t, W_t) float32, along the optical axis, user units; invalid: 0
    names: list[str]  # file of each frame, for messages
    meta: dict[str, Any]  # JSON: the file's other keys
    metric: bool  # True for trajectories: metres, indoors. False for photographs: unknown scale and background
    masks: list[np.ndarray] | None = None  # T arrays (H_t, W_t) bool, True: the pixel is used; None: all are
    pose_source: str = "true"  # of ``poses``, see :class:`~autonerf_lab.data.trajectory.Trajectory`
    true_poses: np.ndarray | None = None  # (T, 4, 4), if they are known and ``poses`` are others
    confidences: list[np.ndarray] | None = None  # T arrays (H_t, W_t) uint8, of predicted semantics, 255 = certain

    def __post_init__(self) -> None:
        """Replace invalid depth, as :class:`~autonerf_lab.data.trajectory.Trajectory`."""
        if self.depths is not None:
            object.__setattr__(self, "depths", [valid_depth(depth) for depth in self.depths])

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
            pose_source=trajectory.pose_source,
            true_poses=trajectory.other_poses.get("true"),
            confidences=None if trajectory.confidence is None else list(trajectory.confidence),
        )

    def check(self) -> None:
        """Check a dataset that was not made by :func:`load_dataset`.

        Raises:
            DataError: a pose is not rigid, or an image or layer differs in size from its intrinsics.
        """
        for t, (c2w, camera, name) in enumerate(zip(self.poses, self.intrinsics, self.names, strict=True)):
            if not (np.abs(c2w[:3, :3] @ c2w[:3, :3].T - np.eye(3)) < 1e-3).all() or not np.isfinite(c2w).all():
                raise DataError(f"{name}: the pose is not a rigid camera-to-world pose of finite numbers")
            for layer in (self.images, self.semantics, self.depths, self.masks, self.confidences):
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
        values = {key: self.meta.get(key) for key in BY_FRAME}
        by_frame = {
            key: [value[t] for t in frames]
            for key, value in values.items()
            if isinstance(value, list) and len(value) == len(self)
        }
        return replace(
            self,
            poses=self.poses[frames],
            images=[self.images[t] for t in frames],
            intrinsics=[self.intrinsics[t] for t in frames],
            semantics=self.semantics and [self.semantics[t] for t in frames],
            depths=self.depths and [self.depths[t] for t in frames],
            masks=self.masks and [self.masks[t] for t in frames],
            confidences=self.confidences and [self.confidences[t] for t in frames],
            names=[self.names[t] for t in frames],
            true_poses=None if self.true_poses is None else self.true_poses[frames],
            meta=self.meta | by_frame,
        )


def load_dataset(folder: str | Path, *, max_bytes: int = 1 << 30, colmap: str | Path | None = None) -> Dataset:
    """Read posed photographs or an RGB-D sequence; the format is recognised by the files in the folder.

    Formats: the ``transforms.json`` of nerfstudio, instant-ngp or :meth:`Trajectory.save`; Blender's synthetic scenes
    (``transforms_train.json``, ...); COLMAP models, text or binary; TUM RGB-D; ScanNet as exported folders; Replica as
    rendered for NICE-SLAM; exports of Polycam and Record3D.

    Intrinsics are scaled to images that are smaller than announced. Transparent pixels become white. Depth (16-bit PNG)
    and semantics are read if every frame has them. Masked pixels are neither trained on nor scored. Images of a fisheye
    lens (OpenCV's model) are rectified to a pinhole camera of the same focal length, which crops their borders.

    Args:
        folder: the folder; or the path of a file like ``transforms.json`` under another name.
        max_bytes: limit for the decoded images. Larger datasets are downscaled by the smallest whole factor that fits,
            with a UserWarning.
        colmap: folder of a COLMAP model of the photographs, if it is not in their folder.

    Raises:
        DataError: no format is recognised, a file is missing or damaged, a camera is not supported, a pose is not
            valid, or there are fewer than two different poses. The message names the file or frame.

    Example:
        >>> load_dataset("/nowhere")
        Traceback (most recent call last):
        autonerf_lab.errors.DataError: /nowhere does not exist; give a folder of posed photographs, \
or the path of its JSON file
    """
    path = Path(folder)
    frames = read_frames(path, None if colmap is None else Path(colmap))
    if len(frames.files) < 2 or not np.ptp(frames.poses, axis=0).any():
        raise DataError(f"{path}: photographs from two different poses are needed, not {len(frames.files)} from one")
    images, intrinsics, layers = read_images(frames, max_bytes)
    return Dataset(
        frames.poses,
        images,
        intrinsics,
        layers.get("semantics"),
        layers.get("depths"),
        [file.relative_to(frames.root).as_posix() for file in frames.files],
        frames.meta,
        frames.metric,
        layers.get("masks"),
        frames.pose_source,
        frames.true_poses,
        layers.get("confidences"),
    )
