"""Hand-made test scenes with known geometry, and attributes like those of a generated scene.

Two rooms: room A is x in [0, 4], room B is x in [4.1, 8], both y in [0, 3] and 2.5 m high. A wall of 10 cm with a
doorway y in [1, 2], 2 m high, separates them. Room A contains a bed (class 4, instance 1) at x in [0, 1.5],
y in [2, 3], 0.5 m high, with a vase (class 13, instance 2) on it. Room B contains a refrigerator (class 10, instance 3)
at x in [7.4, 7.98], y in [0.02, 0.6], 1.8 m high, and a dining table (class 7, instance 4): a slab at 0.7 m above
x in [5, 6], y in [2.2, 2.9].
"""

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from autonerf_lab.scenes.scene import Scene

TEXELS = 64  # side of each quad's tile in the texture


@dataclass(frozen=True, eq=False)
class ToyScene:
    """Scene with a fixed texture; see :class:`autonerf_lab.scenes.Scene` for its arrays."""

    name: str
    vertices: np.ndarray
    faces: np.ndarray
    face_class: np.ndarray
    face_instance: np.ndarray
    uv: np.ndarray
    texture: np.ndarray
    spec: dict | None = None
    instances: list = field(default_factory=list)

    @property
    def bounds(self) -> np.ndarray:
        """Lower and upper corner, (2, 3) metres."""
        return np.stack([self.vertices.min(axis=0), self.vertices.max(axis=0)]).astype(np.float64)

    sha256 = Scene.sha256


def to_scene(toy: ToyScene) -> Scene:
    """Convert a toy scene to a ``Scene`` of the package."""
    return Scene("toy", toy.vertices, toy.faces, toy.face_class, toy.face_instance, toy.uv, bake=lambda: toy.texture)


class _Builder:
    """Collector of labelled quads."""

    def __init__(self) -> None:
        self.quads: list[np.ndarray] = []
        self.labels: list[tuple[int, int]] = []

    def quad(self, a, b, c, d, label=(0, 0)) -> None:
        self.quads.append(np.array([a, b, c, d], np.float32))
        self.labels.append(label)

    def box(self, lo, hi, label=(0, 0)) -> None:
        (x0, y0, z0), (x1, y1, z1) = lo, hi
        self.quad((x0, y0, z0), (x1, y0, z0), (x1, y0, z1), (x0, y0, z1), label)
        self.quad((x1, y1, z0), (x0, y1, z0), (x0, y1, z1), (x1, y1, z1), label)
        self.quad((x0, y1, z0), (x0, y0, z0), (x0, y0, z1), (x0, y1, z1), label)
        self.quad((x1, y0, z0), (x1, y1, z0), (x1, y1, z1), (x1, y0, z1), label)
        self.quad((x0, y0, z1), (x1, y0, z1), (x1, y1, z1), (x0, y1, z1), label)
        self.quad((x0, y1, z0), (x1, y1, z0), (x1, y0, z0), (x0, y0, z0), label)

    def build(self, name: str) -> ToyScene:
        n = len(self.quads)
        side = int(np.ceil(np.sqrt(n)))
        rng = np.random.default_rng(1)
        coarse = rng.integers(60, 230, (side * 8, side * 8, 3))
        texture = np.kron(coarse, np.ones((TEXELS // 8, TEXELS // 8, 1))).astype(np.uint8)
        corners = np.array([(0, 1), (1, 1), (1, 0), (0, 0)], np.float32) * 0.96 + 0.02
        faces, uv = [], []
        for i in range(n):
            tile = (corners + np.array([i % side, i // side], np.float32)) / side
            for triangle in ((0, 1, 2), (0, 2, 3)):
                faces.append([4 * i + k for k in triangle])
                uv.append(tile[list(triangle)])
        labels = np.repeat(np.array(self.labels), 2, axis=0)
        return ToyScene(
            name,
            np.concatenate(self.quads),
            np.array(faces, np.int32),
            labels[:, 0].astype(np.uint8),
            labels[:, 1].astype(np.int32),
            np.array(uv, np.float32),
            texture,
        )


def _room(b: _Builder, width: float, depth: float, height: float = 2.5) -> None:
    b.quad((0, 0, 0), (width, 0, 0), (width, depth, 0), (0, depth, 0))
    b.quad((0, depth, height), (width, depth, height), (width, 0, height), (0, 0, height))
    b.quad((width, 0, 0), (0, 0, 0), (0, 0, height), (width, 0, height))
    b.quad((0, depth, 0), (width, depth, 0), (width, depth, height), (0, depth, height))
    b.quad((0, 0, 0), (0, depth, 0), (0, depth, height), (0, 0, height))
    b.quad((width, depth, 0), (width, 0, 0), (width, 0, height), (width, depth, height))


def two_rooms() -> ToyScene:
    """Return the two rooms that the module docstring describes."""
    b = _Builder()
    _room(b, 8, 3)
    b.box((4, 0, 0), (4.1, 1, 2.5))
    b.box((4, 2, 0), (4.1, 3, 2.5))
    b.box((4, 1, 2), (4.1, 2, 2.5))
    b.box((0, 2, 0), (1.5, 3, 0.5), (4, 1))
    b.box((0.6, 2.4, 0.5), (0.8, 2.6, 0.8), (13, 2))
    b.box((7.4, 0.02, 0), (7.98, 0.6, 1.8), (10, 3))
    b.box((5, 2.2, 0.65), (6, 2.9, 0.7), (7, 4))
    for x, y in ((5, 2.2), (5.95, 2.2), (5, 2.85), (5.95, 2.85)):
        b.box((x, y, 0), (x + 0.05, y + 0.05, 0.65), (7, 4))
    return b.build("toy")


def empty_room(width: float = 4.0, depth: float = 3.0) -> ToyScene:
    """Return an empty room of width x depth metres, 2.5 m high."""
    b = _Builder()
    _room(b, width, depth)
    return b.build("empty")


def uneven_floor(*profile: tuple[float, float]) -> ToyScene:
    """Return a floor 2 m wide with a height profile of (x, z) along x; no floor where z is NaN."""
    b = _Builder()
    for (x0, z0), (x1, z1) in pairwise(profile):
        if np.isfinite([z0, z1]).all():
            b.quad((x0, 0, z0), (x1, 0, z1), (x1, 2, z1), (x0, 2, z0))
    return b.build("uneven")


def closet() -> ToyScene:
    """Return a room too narrow for the robot."""
    b = _Builder()
    _room(b, 0.3, 0.3)
    return b.build("closet")
