"""Parametric furniture model and helpers that add solids to it.

Frame of a model: metres, origin on the floor below the centre of the bounding box; the front faces +y and the back,
at -y, stands against the wall.
"""

from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from autonerf_lab.scenes.tessellation import tessellate

T = TypeVar("T")


@dataclass
class FurnitureModel:
    """Furniture or small object before it is placed in an apartment."""

    class_id: int  # 0..15
    name: str
    size: tuple[float, float, float]  # width (x), depth (y), height (z), metres
    parts: list[dict] = field(default_factory=list)  # solids, see ``tessellation``
    surfaces: list[tuple[float, float, float, float, float, float]] = field(default_factory=list)
    #   support surfaces for small objects: x0, y0, x1, y1, z, free height, metres
    clear: float = 0.45  # floor kept free in front of it, metres

    def box(self, sx: float, sy: float, sz: float, x: float, y: float, z: float, m: str, **more: object) -> None:
        """Add a box with the centre of its underside at (x, y, z); ``omit`` lists omitted faces (default ``z``)."""
        more.setdefault("omit", "z")
        self.parts.append({"box": [sx, sy, sz], "at": [x, y, z], "m": m, **more})

    def lathe(self, profile: list[tuple[float, float]], x: float, y: float, z: float, m: str, **more: object) -> None:
        """Add a solid of revolution: ``profile`` of (radius, z) rotated about the z axis through (x, y, z)."""
        self.parts.append({"lathe": [list(p) for p in profile], "at": [x, y, z], "m": m, **more})

    def legs(self, w: float, d: float, h: float, thick: float, m: str, inset: float = 0.0) -> None:
        """Add four square legs of height ``h`` at the corners of a w x d rectangle."""
        for sx in (-1, 1):
            for sy in (-1, 1):
                x, y = sx * (w / 2 - thick / 2 - inset), sy * (d / 2 - thick / 2 - inset)
                self.box(thick, thick, h, x, y, 0, m, omit="zZ")

    def cushion(self, w: float, d: float, h: float, x: float, y: float, z: float, m: str, **more: object) -> None:
        """Add a block with rounded corners."""
        profile = [(0.97, 0.0), (1.0, 0.45 * h), (0.93, 0.9 * h), (0, h)]
        self.lathe(profile, x, y, z, m, n=12, power=5, scale=[w / 2, d / 2], **more)

    def cylinder(self, r: float, h: float, x: float, y: float, z: float, m: str, n: int = 10, **more: object) -> None:
        """Add an upright cylinder of radius ``r`` without its underside."""
        self.lathe([(r, 0), (r, h), (0, h)], x, y, z, m, n=n, **more)


def extent(parts: list[dict]) -> tuple[np.ndarray, np.ndarray]:
    """Return the lower and upper corner of the bounding box of parts, (3,) each, metres.

    Example:
        >>> extent([{"box": [2, 1, 1], "at": [0, 0, 0.5], "m": "oak"}])[1].tolist()
        [1.0, 0.5, 1.5]
    """
    entry = {"id": 1, "parts": parts}
    points = tessellate({"objects": [entry], "materials": {part["m"]: {} for part in parts}}).points
    return points.min(axis=0), points.max(axis=0)


def pick(rng: np.random.Generator, *options: T) -> T:
    """Return one of the options, sampled uniformly."""
    return options[int(rng.integers(len(options)))]
