"""Noise of depth images, measured on real sensors.

``redwood``: structured-light sensor (Choi, Zhou and Koltun 2015; model of the Redwood data set, as in habitat-sim). The
lens distortion table of that data set is left out.
"""

from collections.abc import Callable

import numpy as np

from autonerf_lab.errors import UnknownNameError

REACH = 10.0  # metres; larger depths are lost
_JITTER = 0.25  # pixels, standard deviation
_BASELINE = 35.130  # metres times disparity units
_DISPARITY_NOISE = 0.027778  # disparity units, standard deviation
_LEVELS = 8  # steps of the measured disparity per unit


def redwood(depth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return a depth image with half of the resolution, shifted pixels and quantised noisy disparity.

    Args:
        depth: (H, W) float32, metres; 0 for none.
        rng: Random generator.

    Returns:
        (H, W) float32, metres; 0 where nothing is measured.

    Example:
        >>> noisy = redwood(np.full((64, 64), 2.0, np.float32), np.random.default_rng(0))
        >>> bool(abs(noisy.mean() - 2.0) < 0.01), bool(0.001 < noisy.std() < 0.02)
        (True, True)
    """
    height, width = depth.shape
    shifts = np.rint(rng.normal(0, _JITTER, (2, height, width))).astype(np.int64)
    rows = np.clip(np.arange(height)[:, None] + shifts[0], 0, height - 1)
    columns = np.clip(np.arange(width) + shifts[1], 0, width - 1)
    seen = depth[rows - rows % 2, columns - columns % 2]
    known = (seen > 0) & (seen < REACH)
    disparity = _BASELINE / np.where(known, seen, 1.0) + _DISPARITY_NOISE * rng.normal(size=depth.shape)
    steps = np.rint(_LEVELS * disparity)
    measured = _LEVELS * _BASELINE / np.maximum(steps, 1)
    return np.where(known & (steps > 0), measured, 0).astype(np.float32)


DEPTH_NOISE: dict[str, Callable[[np.ndarray, np.random.Generator], np.ndarray]] = {"redwood": redwood}


def depth_noise(name: str | None) -> Callable[[np.ndarray, np.random.Generator], np.ndarray] | None:
    """Return a noise model by name; None for none.

    Raises:
        UnknownNameError: There is no noise model of that name.
    """
    if name is None:
        return None
    if name not in DEPTH_NOISE:
        raise UnknownNameError("depth noise", name, DEPTH_NOISE)
    return DEPTH_NOISE[name]
