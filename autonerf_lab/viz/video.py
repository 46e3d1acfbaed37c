"""Videos, MP4 or GIF: of a radiance field along a camera path, or of any images."""

import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from tqdm.auto import tqdm

from autonerf_lab.errors import DataError, UnknownNameError
from autonerf_lab.utils import storage
from autonerf_lab.utils.extras import optional
from autonerf_lab.viz.render_image import LAYERS, layer_image

if TYPE_CHECKING:
    from autonerf_lab.evaluators.radiance_field import RadianceField
    from autonerf_lab.geometry import Intrinsics

SIDE_BY_SIDE = ("rgb", "depth", "semantics")  # layers of "all"


def save_video(
    field: "RadianceField",
    path: np.ndarray,
    file: str | Path,
    fps: float = 24,
    layer: str = "rgb",
    intrinsics: "Intrinsics | None" = None,
    progress: bool = True,
) -> Path:
    """Render a radiance field along a camera path and write a video.

    The file appears under its name only when it is complete.

    Args:
        field: a trained radiance field.
        path: (F, 4, 4) camera-to-world, world frame, one per video frame: see :mod:`autonerf_lab.viz.camera_paths`.
        file: ``.mp4`` (H.264, plays everywhere) or ``.gif``.
        fps: frames per second.
        layer: ``rgb``, ``depth``, ``semantics``, ``opacity``, or ``all`` for the first three side by side
            (without semantics if the field has no classes).
        intrinsics: camera; the training camera by default. An odd width or height grows by one pixel, since H.264
            needs even sizes.
        progress: show a progress bar.

    Returns:
        The file.

    Raises:
        DataError: another extension, no frames, a frame rate of zero, semantics of a field without classes, or a file
            that cannot be written.
        UnknownNameError: unknown layer.
        MissingPackageError: the extra ``viewer`` is not installed.
    """
    if layer not in (*LAYERS, "all"):
        raise UnknownNameError("image layer", layer, (*LAYERS, "all"))
    layers = SIDE_BY_SIDE if layer == "all" else (layer,)

    def frame(c2w: np.ndarray) -> np.ndarray:
        image = field.render(c2w, intrinsics or field.intrinsics)
        shown = layers if image.semantics is not None or layer != "all" else SIDE_BY_SIDE[:2]
        return np.concatenate([layer_image(image, name, field.frame.unit) for name in shown], axis=1)

    return write_video(map(frame, path), len(path), file, fps, progress)


def write_video(
    images: Iterable[np.ndarray], count: int, file: str | Path, fps: float = 24, progress: bool = True
) -> Path:
    """Write images as a video. The iterable is read one image at a time, after all other arguments are checked.

    Args:
        images: (H, W, 3) uint8, all of one size. An odd width or height grows by one pixel, since H.264 needs even
            sizes.
        count: number of images.
        file: ``.mp4`` (H.264, plays everywhere) or ``.gif``.
        fps: frames per second.
        progress: show a progress bar.

    Returns:
        The file.

    Raises:
        DataError: another extension, no frames, a frame rate of zero, or a file that cannot be written.
        MissingPackageError: the extra ``viewer`` is not installed.
    """
    file = Path(file)
    kind = file.suffix.lower()
    if kind not in (".mp4", ".gif"):
        raise DataError(f"{file}: unknown extension; a video is saved as .mp4 or .gif")
    if not count or not fps > 0:
        raise DataError(
            f"{file}: a video needs frames and a positive frame rate, not {count} frames and {fps} per second"
        )
    imageio = optional("imageio.v2", "viewer")
    settings: dict[str, Any] = {"format": "GIF", "duration": 1000 / fps, "loop": 0}
    if kind == ".mp4":
        optional("imageio_ffmpeg", "viewer")
        settings = {"format": "FFMPEG", "fps": fps, "codec": "libx264", "pixelformat": "yuv420p", "quality": 8}
        settings |= {"macro_block_size": 2, "ffmpeg_log_level": "error"}
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        # in the target folder: missing write permission is found before anything is rendered
        with tempfile.TemporaryDirectory(dir=file.parent, prefix=f".{file.name}.") as folder:
            unfinished = Path(folder) / file.name
            with imageio.get_writer(unfinished, mode="I", **settings) as writer:
                for image in tqdm(images, total=count, disable=not progress, desc=file.name, unit="frame"):
                    writer.append_data(_even(image))
            storage.write_bytes(file, unfinished.read_bytes())
    except OSError as error:
        raise DataError(f"cannot write {file}: {error.strerror or error}; choose another file") from error
    return file


def _even(image: np.ndarray) -> np.ndarray:
    """Pad an (H, W, 3) image to even H and W by repeating the last row or column."""
    return np.pad(image, ((0, image.shape[0] % 2), (0, image.shape[1] % 2), (0, 0)), mode="edge")
