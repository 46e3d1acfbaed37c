"""What the furniture makers share: small helpers that write parts in a thing's own frame.

A thing stands on the floor with its middle at the origin; it faces +y and its back is at -y, against the wall.
"""

from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from autonerf_lab.scenes.tessellation import build_patches

T = TypeVar("T")


@dataclass
class Model:
    """A parametric piece: the parts, its box, and where small objects may stand on it."""

    class_id: int
    name: str
    size: tuple[float, float, float]  # width (x), depth (y), height
    parts: list[dict] = field(default_factory=list)
    surfaces: list[tuple[float, float, float, float, float, float]] = field(default_factory=list)
    clear: float = 0.45  # metres kept free in front

    def box(self, sx: float, sy: float, sz: float, x: float, y: float, z: float, m: str, **more: object) -> None:
        """A box with the middle of its underside at (x, y, z); the underside itself is left out unless asked for."""
        more.setdefault("omit", "z")
        self.parts.append({"box": [sx, sy, sz], "at": [x, y, z], "m": m, **more})

    def lathe(self, profile: list[tuple[float, float]], x: float, y: float, z: float, m: str, **more: object) -> None:
        self.parts.append({"lathe": [list(p) for p in profile], "at": [x, y, z], "m": m, **more})

    def legs(self, w: float, d: float, h: float, thick: float, m: str, inset: float = 0.0) -> None:
        for sx in (-1, 1):
            for sy in (-1, 1):
                x, y = sx * (w / 2 - thick / 2 - inset), sy * (d / 2 - thick / 2 - inset)
                self.box(thick, thick, h, x, y, 0, m, omit="zZ")

    def cushion(self, w: float, d: float, h: float, x: float, y: float, z: float, m: str, **more: object) -> None:
        """A rounded block."""
        profile = [(0.97, 0.0), (1.0, 0.45 * h), (0.93, 0.9 * h), (0, h)]
        self.lathe(profile, x, y, z, m, n=12, power=5, scale=[w / 2, d / 2], **more)

    def cylinder(self, r: float, h: float, x: float, y: float, z: float, m: str, n: int = 10, **more: object) -> None:
        self.lathe([(r, 0), (r, h), (0, h)], x, y, z, m, n=n, **more)


def extent(parts: list[dict]) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner of parts in their own frame.

    Example:
        >>> extent([{"box": [2, 1, 1], "at": [0, 0, 0.5], "m": "oak"}])[1].tolist()
        [1.0, 0.5, 1.5]
    """
    thing = {"id": 1, "parts": parts}
    points = build_patches({"objects": [thing], "materials": {part["m"]: {} for part in parts}}).points
    return points.min(axis=0), points.max(axis=0)


def pick(rng: np.random.Generator, *options: T) -> T:
    """One of the options, with equal chance."""
    return options[int(rng.integers(len(options)))]
