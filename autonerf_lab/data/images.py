"""Image files by other hands, looked at before they are unpacked, then made RGB, metres or classes; and data URLs."""

import base64
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps

from autonerf_lab.classes import NUM_CLASSES
from autonerf_lab.errors import DataError
from autonerf_lab.utils.resources import threads

_FORMATS = ("PNG", "JPEG", "WEBP")
_ORIENTATION = 0x0112  # of EXIF
_ALPHA = ("RGBA", "LA", "PA")


def parallel(work: Callable[[int], None], count: int) -> None:
    """Call ``work(0)`` to ``work(count - 1)``.

    Image coding lets go of the interpreter's lock, so that threads use as many cores.
    """
    with ThreadPoolExecutor(threads()) as pool:
        for _ in pool.map(work, range(count), chunksize=16):
            pass


def picture_size(file: Path) -> tuple[int, int]:
    """(width, height) in pixels, as stored: what the header says.

    Not for threads: it changes the warning filter for a moment.

    Raises:
        DataError: not a PNG, JPEG or WebP image, or one that Pillow takes for a decompression bomb.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(file, formats=_FORMATS) as image:
                return image.size
    except (Image.DecompressionBombWarning, Image.DecompressionBombError) as error:
        raise DataError(f"{file} has too many pixels ({error}); shrink it") from error
    except Exception as error:  # Pillow raises whatever its decoder met
        raise DataError(f"{file} is not a readable PNG, JPEG or WebP image: {error}") from error


def is_turned(file: Path) -> bool:
    """Whether EXIF says that the picture is to be turned by a quarter to be upright."""
    try:
        with Image.open(file, formats=_FORMATS) as image:
            return image.getexif().get(_ORIENTATION) in (5, 6, 7, 8)
    except Exception as error:
        raise DataError(f"{file} is damaged: {error}") from error


def read_rgb(file: Path, turn: bool = False, shrink: int = 1) -> np.ndarray:
    """(H, W, 3) uint8 of any image, what is transparent on white.

    Args:
        file: PNG, JPEG or WebP.
        turn: as EXIF says.
        shrink: whole factor; each pixel is the mean of ``shrink`` x ``shrink``, fewer at the right and lower edge.

    Raises:
        DataError: the file is damaged.
    """
    try:
        with Image.open(file, formats=_FORMATS) as opened:
            image = ImageOps.exif_transpose(opened) if turn else opened
            if image.mode.startswith("I"):  # 16 bits of grey, which convert() would clip
                image = Image.fromarray(((np.asarray(image).astype(np.uint32) + 128) // 257).astype(np.uint8))
            if image.mode in _ALPHA or "transparency" in image.info:
                image = image.convert("RGBA")
                image = Image.alpha_composite(Image.new("RGBA", image.size, "white"), image)
            return np.array(image.convert("RGB").reduce(shrink))
    except Exception as error:
        raise DataError(f"{file} is damaged: {error}") from error


def read_depth(file: Path) -> np.ndarray:
    """(H, W) float32 metres of a 16-bit PNG of millimetres."""
    array = _read_integers(file)
    if array.dtype.itemsize < 2:
        raise DataError(f"{file} must be a 16-bit PNG of millimetres; leave 'depth_file_path' out if it is a picture")
    return to_metres(array)


def read_classes(file: Path) -> np.ndarray:
    """(H, W) uint8 class index."""
    return to_classes(_read_integers(file), file)


def _read_integers(file: Path) -> np.ndarray:
    try:
        with Image.open(file, formats=["PNG"]) as image:
            array = np.asarray(image)
    except Exception as error:
        raise DataError(f"{file} is damaged, or not a PNG image: {error}") from error
    return one_channel(array, file)


def one_channel(array: np.ndarray, file: Path) -> np.ndarray:
    """The same array, if it is one of integers."""
    if array.ndim != 2 or array.dtype.kind not in "ui":
        raise DataError(f"{file} must hold one channel of integers")
    return array


def to_metres(array: np.ndarray) -> np.ndarray:
    """Millimetres -> float32 metres."""
    return array.astype(np.float32) / np.float32(1000)


def to_classes(array: np.ndarray, file: Path) -> np.ndarray:
    """The same array as uint8, if it holds classes."""
    if array.max() >= NUM_CLASSES:
        raise DataError(f"{file} holds the class {array.max()}; classes are 0 to {NUM_CLASSES - 1}")
    return array.astype(np.uint8)


def resample(array: np.ndarray, size: tuple[int, int], shrink: int = 1) -> np.ndarray:
    """The nearest values of a layer, one for each pixel of an image; a mean of classes would be another class.

    Args:
        array: (h, w), of the same view as the image.
        size: (width, height) of the image as stored.
        shrink: the factor by which the image is shrunk.

    Returns:
        (H, W), H and W those of the shrunk image.

    Example:
        >>> resample(np.array([[1, 2], [3, 4]]), (4, 2))
        array([[1, 1, 2, 2],
               [3, 3, 4, 4]])
    """
    rows, columns = (
        np.minimum((np.arange(-(-pixels // shrink)) * 2 + 1) * shrink * n // (2 * pixels), n - 1)
        for pixels, n in zip(size[::-1], array.shape, strict=True)
    )
    return array[rows[:, None], columns]


def data_url(data: bytes, kind: str) -> str:
    """The address of an image that a page carries in itself.

    Args:
        data: of the image file.
        kind: ``png``, ``jpeg`` or ``webp``.

    Example:
        >>> data_url(b"abc", "png")
        'data:image/png;base64,YWJj'
    """
    return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
