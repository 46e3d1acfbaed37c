"""The semantic classes of the paper (section 5): 15 objects and the background, with their colours.

A semantic image holds the class index of each pixel as ``uint8``. Class 0, the background, is counted by no
semantic reward, map or planning score.
"""

import numpy as np

CLASS_NAMES: tuple[str, ...] = (
    "background",
    "chair",
    "couch",
    "potted plant",
    "bed",
    "toilet",
    "tv",
    "dining table",
    "oven",
    "sink",
    "refrigerator",
    "book",
    "clock",
    "vase",
    "cup",
    "bottle",
)
NUM_CLASSES = len(CLASS_NAMES)

# Hues are spread for colour-blind readers and vary in lightness, so that neighbours differ in grey print too.
CLASS_COLORS: np.ndarray = np.array(
    [
        (222, 222, 222),
        (230, 159, 0),
        (0, 90, 150),
        (0, 158, 115),
        (148, 103, 189),
        (86, 180, 233),
        (40, 40, 40),
        (150, 85, 30),
        (213, 94, 0),
        (0, 205, 205),
        (120, 130, 150),
        (204, 50, 60),
        (240, 228, 66),
        (204, 121, 167),
        (110, 190, 60),
        (80, 30, 100),
    ],
    dtype=np.uint8,
)


def colorize(semantics: np.ndarray) -> np.ndarray:
    """Colours of a class image.

    Args:
        semantics: (...,) integers in [0, 16).

    Returns:
        (..., 3) uint8.

    Example:
        >>> colorize(np.array([[0, 1]])).shape
        (1, 2, 3)
    """
    return CLASS_COLORS[semantics]
