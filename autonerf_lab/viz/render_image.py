"""What a field shows, as pictures: colours, depth, classes and opacity."""

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib import colormaps

from autonerf_lab.classes import colorize
from autonerf_lab.errors import DataError, UnknownNameError

HALF_WAY = 2.0  # metres, or what a field takes for such: the depth in the middle of the colour scale


def _gray(share: np.ndarray) -> np.ndarray:
    return share[..., None].repeat(3, axis=-1)


def _depth(image: Any, unit: float) -> np.ndarray:
    depth = np.maximum(np.nan_to_num(image.depth), 0) / unit
    # no depth lies outside this scale, and it is the same in every picture: a video does not flicker
    return colormaps["viridis"](depth / (depth + HALF_WAY))[..., :3]


def _semantics(image: Any, unit: float) -> np.ndarray:
    if image.semantics is None:
        raise DataError("this field knows no classes: it was trained on images without semantics")
    return colorize(image.semantics) / 255


_LAYERS: dict[str, Callable[[Any, float], np.ndarray]] = {
    "rgb": lambda image, unit: image.rgb,
    "depth": _depth,
    "semantics": _semantics,
    "opacity": lambda image, unit: _gray(image.opacity),
}
LAYERS = tuple(_LAYERS)


def paint(image: Any, what: str, unit: float = 1.0) -> np.ndarray:
    """A rendering as a picture.

    Args:
        image: what ``render`` of a field returns.
        what: ``rgb``, ``depth`` (viridis, dark is near, 2 m is half way), ``semantics`` (colours of the classes) or
            ``opacity`` (white where all light is collected).
        unit: what counts as a metre, in the units of the depth: that of the field's ``frame``.

    Returns:
        (H, W, 3) uint8.

    Raises:
        UnknownNameError: there is no such picture.
        DataError: semantics of a field that knows no classes.

    Example:
        >>> from autonerf_lab.evaluators import Image
        >>> grey, one = np.full((1, 1, 3), 0.5, np.float32), np.ones((1, 1), np.float32)
        >>> paint(Image(grey, one, one.astype(np.uint8), one), "rgb")
        array([[[128, 128, 128]]], dtype=uint8)
    """
    if what not in _LAYERS:
        raise UnknownNameError("picture", what, LAYERS)
    # nothing finite is promised while a training goes wrong
    return np.round(np.clip(np.nan_to_num(_LAYERS[what](image, unit)), 0, 1) * 255).astype(np.uint8)
