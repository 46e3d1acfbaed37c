"""Films, MP4 or GIF: of a field along the path of a camera, or of any pictures."""

import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from tqdm.auto import tqdm

from autonerf_lab.errors import DataError, UnknownNameError
from autonerf_lab.utils import storage
from autonerf_lab.utils.extras import optional
from autonerf_lab.viz.render_image import LAYERS, paint

if TYPE_CHECKING:
    from autonerf_lab.evaluators.radiance_field import Field
    from autonerf_lab.geometry import Intrinsics

SIDE_BY_SIDE = ("rgb", "depth", "semantics")  # what "all" shows


def save_video(
    field: "Field",
    path: np.ndarray,
    file: str | Path,
    fps: float = 24,
    what: str = "rgb",
    intrinsics: "Intrinsics | None" = None,
    progress: bool = True,
) -> Path:
    """Render a field along a path into a film.

    The file appears under its name when it is complete, not before.

    Args:
        field: a trained NeRF.
        path: (F, 4, 4) camera-to-world, world frame, one a frame: see :mod:`autonerf_lab.viz.camera_paths`.
        file: ``.mp4`` (H.264, plays everywhere) or ``.gif``.
        fps: frames a second.
        what: ``rgb``, ``depth``, ``semantics``, ``opacity``, or ``all`` for the first three side by side
            (without semantics where the field knows no classes).
        intrinsics: the camera; the training camera without. An odd side grows by one pixel: H.264 wants it even.
        progress: show a bar.

    Returns:
        The file.

    Raises:
        DataError: another ending, no frames, no frames a second, semantics of a field that knows no classes, or a file
            that cannot be written.
        UnknownNameError: there is no such ``what``.
        MissingPackageError: the extra ``viewer`` is not installed.
    """
    if what not in (*LAYERS, "all"):
        raise UnknownNameError("picture", what, (*LAYERS, "all"))
    layers = SIDE_BY_SIDE if what == "all" else (what,)

    def picture(c2w: np.ndarray) -> np.ndarray:
        image = field.render(c2w, intrinsics or field.intrinsics)
        shown = layers if image.semantics is not None or what != "all" else SIDE_BY_SIDE[:2]
        return np.concatenate([paint(image, layer, field.frame.unit) for layer in shown], axis=1)

    return save_film(map(picture, path), len(path), file, fps, progress)


def save_film(
    pictures: Iterable[np.ndarray], count: int, file: str | Path, fps: float = 24, progress: bool = True
) -> Path:
    """Write pictures as a film. They are asked for one by one, after everything else was found to be in order.

    Args:
        pictures: (H, W, 3) uint8, all of one size. An odd side grows by one pixel: H.264 wants it even.
        count: how many there are.
        file: ``.mp4`` (H.264, plays everywhere) or ``.gif``.
        fps: frames a second.
        progress: show a bar.

    Returns:
        The file.

    Raises:
        DataError: another ending, no frames, no frames a second, or a file that cannot be written.
        MissingPackageError: the extra ``viewer`` is not installed.
    """
    file = Path(file)
    kind = file.suffix.lower()
    if kind not in (".mp4", ".gif"):
        raise DataError(f"{file}: a film is written as .mp4 or .gif")
    if not count or not fps > 0:
        raise DataError(f"{file}: a film needs frames, and frames a second; here are {count}, and {fps}")
    imageio = optional("imageio.v2", "viewer")
    settings: dict[str, Any] = {"format": "GIF", "duration": 1000 / fps, "loop": 0}
    if kind == ".mp4":
        optional("imageio_ffmpeg", "viewer")
        settings = {"format": "FFMPEG", "fps": fps, "codec": "libx264", "pixelformat": "yuv420p", "quality": 8}
        settings |= {"macro_block_size": 2, "ffmpeg_log_level": "error"}
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        # beside its place: a folder that cannot be written to is found before anything is drawn
        with tempfile.TemporaryDirectory(dir=file.parent, prefix=f".{file.name}.") as folder:
            unfinished = Path(folder) / file.name
            with imageio.get_writer(unfinished, mode="I", **settings) as writer:
                for picture in tqdm(pictures, total=count, disable=not progress, desc=file.name, unit="frame"):
                    writer.append_data(_even(picture))
            storage.write_bytes(file, unfinished.read_bytes())
    except OSError as error:
        raise DataError(f"cannot write {file}: {error.strerror or error}; choose another file") from error
    return file


def _even(picture: np.ndarray) -> np.ndarray:
    """(H, W, 3) with even H and W: the last row or column once more where one is missing."""
    return np.pad(picture, ((0, picture.shape[0] % 2), (0, picture.shape[1] % 2), (0, 0)), mode="edge")
