"""Readers of image files: checks of size and format before decoding, conversion to RGB, metres or classes."""

import base64
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps

from autonerf_lab.classes import NUM_CLASSES
from autonerf_lab.errors import DataError
from autonerf_lab.utils.resources import threads

_FORMATS = ("PNG", "JPEG", "WEBP")
_ORIENTATION = 0x0112  # EXIF tag
_ALPHA = ("RGBA", "LA", "PA")


def parallel(work: Callable[[int], None], count: int) -> None:
    """Call ``work(0)`` to ``work(count - 1)`` in threads.

    Image coding releases the interpreter's lock, so that threads run in parallel.
    """
    with ThreadPoolExecutor(threads()) as pool:
        for _ in pool.map(work, range(count), chunksize=16):
            pass


def image_size(file: Path) -> tuple[int, int]:
    """Return (width, height) in pixels by the header of a file.

    Not thread-safe: it changes the warning filter temporarily.

    Raises:
        DataError: the file is not a PNG, JPEG or WebP image, or is a decompression bomb according to Pillow.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(file, formats=_FORMATS) as image:
                return image.size
    except (Image.DecompressionBombWarning, Image.DecompressionBombError) as error:
        raise DataError(f"{file} has too many pixels ({error}); downscale it") from error
    except Exception as error:  # decoders of Pillow raise many types of errors
        raise DataError(f"{file} is not a readable PNG, JPEG or WebP image: {error}") from error


def is_rotated(file: Path) -> bool:
    """Return True if EXIF says that the stored image is rotated by 90 or 270 degrees."""
    try:
        with Image.open(file, formats=_FORMATS) as image:
            return image.getexif().get(_ORIENTATION) in (5, 6, 7, 8)
    except Exception as error:
        raise DataError(f"{file} is damaged: {error}") from error


def read_rgb(file: Path, rotate: bool = False, shrink: int = 1, png_size: tuple[int, int] | None = None) -> np.ndarray:
    """Read an image as (H, W, 3) uint8 RGB; transparent pixels are composited on white.

    Args:
        file: PNG, JPEG or WebP.
        rotate: rotate as EXIF says.
        shrink: whole factor; each pixel is the mean of ``shrink`` x ``shrink``, fewer at the right and lower edge.
        png_size: accept only a PNG of this (width, height).

    Raises:
        DataError: the file is damaged, or not a PNG of the given size.
    """
    with _opened(file, png_size, _FORMATS) as opened:
        image = ImageOps.exif_transpose(opened) if rotate else opened
        if image.mode.startswith("I"):  # 16 bits of grey, which convert() would clip
            image = Image.fromarray(((np.asarray(image).astype(np.uint32) + 128) // 257).astype(np.uint8))
        if image.mode in _ALPHA or "transparency" in image.info:
            image = image.convert("RGBA")
            image = Image.alpha_composite(Image.new("RGBA", image.size, "white"), image)
        return np.array(image.convert("RGB").reduce(shrink))


def read_depth(file: Path, png_size: tuple[int, int] | None = None, unit: float = 0.001) -> np.ndarray:
    """Read a 16-bit PNG of depth as (H, W) float32 metres; ``unit`` is the length of one step of its values, metres.

    Raises:
        DataError: the file is damaged, or not a 16-bit PNG (of the given size).
    """
    array = _read_integers(file, png_size)
    if array.dtype.itemsize < 2:
        raise DataError(f"{file} must be a 16-bit PNG of depth, not of 8 bits")
    return array.astype(np.float32) / np.float32(round(1 / unit, 6))


def valid_depth(depth: np.ndarray) -> np.ndarray:
    """Return depth with 0, "none", where it is negative, infinite or NaN; the same array if it is nowhere.

    Example:
        >>> valid_depth(np.array([1.5, -1.0, np.nan, np.inf], np.float32)).tolist()
        [1.5, 0.0, 0.0, 0.0]
    """
    valid = (depth >= 0) & (depth < np.inf)
    return depth if valid.all() else np.where(valid, depth, depth.dtype.type(0))


def read_mask(file: Path) -> np.ndarray:
    """Read a mask as (H, W) bool: True where the image is used, which is where the mask is not black.

    Raises:
        DataError: the file is damaged, or not a PNG, JPEG or WebP image.
    """
    with _opened(file, None, _FORMATS) as image:
        return np.asarray(image.convert("L")) > 0


def read_classes(file: Path, png_size: tuple[int, int] | None = None) -> np.ndarray:
    """Read a PNG of class indices as (H, W) uint8.

    Raises:
        DataError: the file is damaged, or not a PNG (of the given size), or contains a class that does not exist.
    """
    array = _read_integers(file, png_size)
    if array.max() >= NUM_CLASSES:
        raise DataError(f"{file} contains the class {array.max()}; classes are 0 to {NUM_CLASSES - 1}")
    return array.astype(np.uint8)


def read_bytes_image(file: Path, png_size: tuple[int, int] | None = None) -> np.ndarray:
    """Read an 8-bit PNG of one channel, such as confidences, as (H, W) uint8.

    Raises:
        DataError: the file is damaged, or not an 8-bit PNG (of the given size).
    """
    array = _read_integers(file, png_size)
    if array.dtype.itemsize > 1:
        raise DataError(f"{file} must be an 8-bit PNG")
    return array.astype(np.uint8)


def check_png(file: Path, size: tuple[int, int]) -> None:
    """Check the header of a PNG.

    Raises:
        DataError: the file is missing, is no PNG, or has not the given (width, height).
    """
    with _opened(file, size, ("PNG",)):
        pass


def _read_integers(file: Path, png_size: tuple[int, int] | None) -> np.ndarray:
    with _opened(file, png_size, ("PNG",)) as image:
        array = np.asarray(image)
    if array.ndim != 2 or array.dtype.kind not in "ui":
        raise DataError(f"{file} must have one channel of integers")
    return array


@contextmanager
def _opened(file: Path, png_size: tuple[int, int] | None, formats: tuple[str, ...]) -> Iterator[Image.Image]:
    """Open an image; with ``png_size``, check format and size before anything is decoded."""
    try:
        with Image.open(file, formats=("PNG",) if png_size else formats) as image:
            if png_size and image.size != png_size:
                width, height = image.size
                raise DataError(f"{file} has {width}x{height} pixels, transforms.json says {png_size[0]}x{png_size[1]}")
            yield image
    except DataError:
        raise
    except (Image.DecompressionBombWarning, Image.DecompressionBombError) as error:
        raise DataError(f"{file} has too many pixels ({error}); downscale it") from error
    except FileNotFoundError as error:
        raise DataError(f"{file} does not exist") from error
    except Exception as error:  # decoders of Pillow raise many types of errors
        kind = "a PNG image" if png_size or formats == ("PNG",) else "a PNG, JPEG or WebP image"
        raise DataError(f"{file} is damaged, or not {kind}: {error}") from error


def resample(array: np.ndarray, size: tuple[int, int], shrink: int = 1) -> np.ndarray:
    """Resample a layer to the pixels of an image by nearest neighbours, because a mean of class indices is not a class.

    Args:
        array: (h, w) layer of the same view as the image.
        size: (width, height) of the stored image.
        shrink: whole factor by which the image is downscaled.

    Returns:
        (H, W), the size of the downscaled image.

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
    """Return a data URL, which embeds an image in a page.

    Args:
        data: content of the image file.
        kind: ``png``, ``jpeg`` or ``webp``.

    Example:
        >>> data_url(b"abc", "png")
        'data:image/png;base64,YWJj'
    """
    return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
