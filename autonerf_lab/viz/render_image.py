"""Layers of a rendering as images: colours, depth, classes and opacity."""

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib import colormaps

from autonerf_lab.classes import colorize
from autonerf_lab.errors import DataError, UnknownNameError

MIDDLE_DEPTH = 2.0  # depth in the middle of the colour scale, metres


def _gray(values: np.ndarray) -> np.ndarray:
    return values[..., None].repeat(3, axis=-1)


def _depth(image: Any, unit: float) -> np.ndarray:
    depth = np.maximum(np.nan_to_num(image.depth), 0) / unit
    # all depths fit into this scale, and it is the same for all images: a video does not flicker
    return colormaps["viridis"](depth / (depth + MIDDLE_DEPTH))[..., :3]


def _semantics(image: Any, unit: float) -> np.ndarray:
    if image.semantics is None:
        raise DataError("this field has no classes: it was trained on images without semantics; choose another layer")
    return colorize(image.semantics) / 255


_LAYERS: dict[str, Callable[[Any, float], np.ndarray]] = {
    "rgb": lambda image, unit: image.rgb,
    "depth": _depth,
    "semantics": _semantics,
    "opacity": lambda image, unit: _gray(image.opacity),
}
LAYERS = tuple(_LAYERS)


def layer_image(image: Any, layer: str, unit: float = 1.0) -> np.ndarray:
    """Return one layer of a rendering as an image.

    Args:
        image: result of the ``render`` method of a radiance field.
        layer: ``rgb``, ``depth`` (viridis; dark is near, 2 m is in the middle of the scale), ``semantics`` (class
            colours) or ``opacity`` (white is opaque).
        unit: length of a metre in the units of the depth: ``unit`` of the field's ``frame``.

    Returns:
        (H, W, 3) uint8.

    Raises:
        UnknownNameError: unknown layer.
        DataError: semantics of a field without classes.

    Example:
        >>> from autonerf_lab.evaluators import Rendering
        >>> grey, one = np.full((1, 1, 3), 0.5, np.float32), np.ones((1, 1), np.float32)
        >>> layer_image(Rendering(grey, one, one.astype(np.uint8), one), "rgb")
        array([[[128, 128, 128]]], dtype=uint8)
    """
    if layer not in _LAYERS:
        raise UnknownNameError("image layer", layer, LAYERS)
    # values may be non-finite while a training diverges
    return np.round(np.clip(np.nan_to_num(_LAYERS[layer](image, unit)), 0, 1) * 255).astype(np.uint8)
