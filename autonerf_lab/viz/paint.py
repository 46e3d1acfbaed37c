"""What a field shows, as pictures: colours, depth, classes and opacity."""

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib import colormaps

from autonerf_lab.classes import colorize
from autonerf_lab.errors import UnknownNameError

HALF_WAY = 2.0  # metres, the depth in the middle of the colour scale


def _gray(share: np.ndarray) -> np.ndarray:
    return share[..., None].repeat(3, axis=-1)


def _depth(depth: np.ndarray) -> np.ndarray:
    # no depth lies outside this scale, and it is the same in every picture: a video does not flicker
    return colormaps["viridis"](depth / (depth + HALF_WAY))[..., :3]


_LAYERS: dict[str, Callable[[Any], np.ndarray]] = {
    "rgb": lambda image: image.rgb,
    "depth": lambda image: _depth(np.maximum(np.nan_to_num(image.depth), 0)),
    "semantics": lambda image: colorize(image.semantics) / 255,
    "opacity": lambda image: _gray(image.opacity),
}
LAYERS = tuple(_LAYERS)


def paint(image: Any, what: str) -> np.ndarray:
    """A rendering as a picture.

    Args:
        image: what ``render`` of a field returns.
        what: ``rgb``, ``depth`` (viridis, dark is near, 2 m is half way), ``semantics`` (colours of the classes) or
            ``opacity`` (white where all light is collected).

    Returns:
        (H, W, 3) uint8.

    Raises:
        UnknownNameError: there is no such picture.

    Example:
        >>> from autonerf_lab.evaluators import Image
        >>> grey, one = np.full((1, 1, 3), 0.5, np.float32), np.ones((1, 1), np.float32)
        >>> paint(Image(grey, one, one.astype(np.uint8), one), "rgb")
        array([[[128, 128, 128]]], dtype=uint8)
    """
    if what not in _LAYERS:
        raise UnknownNameError("picture", what, LAYERS)
    # nothing finite is promised while a training goes wrong
    return np.round(np.clip(np.nan_to_num(_LAYERS[what](image)), 0, 1) * 255).astype(np.uint8)
