"""Semantic classes of the paper (section 5): 15 object classes and the background, with their colours.

A class image holds the class index of each pixel as ``uint8``. Semantic rewards, map scores and planning scores ignore
class 0, the background.
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

# Close to the colours of Okabe and Ito, moved apart until any two differ by about 10 or more (CIEDE2000) for readers
# with normal and with dichromatic colour vision.
CLASS_COLORS: np.ndarray = np.array(
    [
        (222, 222, 222),
        (194, 152, 55),
        (3, 84, 147),
        (1, 158, 115),
        (131, 103, 157),
        (94, 182, 233),
        (41, 41, 41),
        (164, 109, 75),
        (201, 91, 7),
        (5, 229, 241),
        (120, 135, 206),
        (182, 25, 38),
        (255, 247, 131),
        (212, 114, 161),
        (139, 221, 47),
        (78, 26, 96),
    ],
    dtype=np.uint8,
)


def colorize(semantics: np.ndarray) -> np.ndarray:
    """Return the colours of a class image.

    Args:
        semantics: (...,) integers in [0, 16).

    Returns:
        (..., 3) uint8.

    Example:
        >>> colorize(np.array([[0, 1]])).shape
        (1, 2, 3)
    """
    return CLASS_COLORS[semantics]
