"""A scene: one textured triangle mesh whose every face knows its class and its object."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from autonerf_lab.classes import CLASS_NAMES

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class Instance:
    """One object: its number in ``Scene.face_instance``, its class, and its box in the world."""

    id: int
    class_id: int  # 0: furniture that is none of the 15 classes
    name: str
    center: np.ndarray  # (3,) metres
    size: np.ndarray  # (3,) metres, extent along world x, y, z


@dataclass(frozen=True, eq=False)
class Scene:
    """A static world, generated or scanned. World frame: metres, z up, floor at z = 0.

    Texture coordinates have u to the right and v *down*: the texel of (u, v) is
    ``texture[int(v * height), int(u * width)]``.

    Example:
        >>> from autonerf_lab.scenes import load_scene
        >>> scene = load_scene("val-0")
        >>> bool((scene.faces.max() < len(scene.vertices)) and scene.uv.shape == (len(scene.faces), 3, 2))
        True
    """

    name: str
    vertices: np.ndarray  # (V, 3) float32
    faces: np.ndarray  # (F, 3) int32, counter-clockwise seen from the free side
    face_class: np.ndarray  # (F,) uint8, 0..15
    face_instance: np.ndarray  # (F,) int32, 0 = walls, floor, ceiling and what is part of them
    uv: np.ndarray  # (F, 3, 2) float32 in [0, 1]
    bake: Callable[[], np.ndarray] = field(repr=False)  # makes the texture when somebody first looks at it
    spec: dict | None = field(default=None, repr=False)  # what a generated scene was built from
    gloss: np.ndarray | None = field(default=None, repr=False)  # (F,) float32 in [0, 1], how much it shines; None: dull
    names: dict[int, str] = field(default_factory=dict, repr=False)  # of objects, by id; those of the spec go first

    @cached_property
    def texture(self) -> np.ndarray:
        """(Ht, Wt, 3) uint8, albedo times light, as displayed (sRGB). Made on first use."""
        return self.bake()

    @cached_property
    def bounds(self) -> np.ndarray:
        """(2, 3) float64, lower and upper corner, metres."""
        used = self.vertices[self.faces.reshape(-1)].astype(np.float64)
        return np.stack([used.min(axis=0), used.max(axis=0)])

    @cached_property
    def sha256(self) -> str:
        """A fingerprint of geometry and labels, in hexadecimal: tells whose trajectory one holds."""
        digest = hashlib.sha256()
        for array, dtype in (
            (self.vertices, "<f4"),
            (self.faces, "<i4"),
            (self.face_class, "<u1"),
            (self.face_instance, "<i4"),
        ):
            digest.update(np.ascontiguousarray(array, dtype=dtype).tobytes())
        return digest.hexdigest()

    @cached_property
    def instances(self) -> list[Instance]:
        """Every object that has faces, by id."""
        order = np.argsort(self.face_instance, kind="stable")
        ids, starts = np.unique(self.face_instance[order], return_index=True)
        names = self.names if self.spec is None else {o["id"]: o["name"] for o in self.spec["objects"]}
        found = []
        for number, group in zip(ids.tolist(), np.split(order, starts[1:]), strict=True):
            if number == 0:
                continue
            corners = self.vertices[self.faces[group].reshape(-1)].astype(np.float64)
            low, high = corners.min(axis=0), corners.max(axis=0)
            class_id = int(self.face_class[group[0]])
            name = names.get(number, f"{CLASS_NAMES[class_id]} {number}")
            found.append(Instance(number, class_id, name, (low + high) / 2, high - low))
        return found

    def __repr__(self) -> str:
        size = " x ".join(f"{s:.1f}" for s in self.bounds[1] - self.bounds[0])
        return f"Scene({self.name!r}, {len(self.faces)} triangles, {len(self.instances)} objects, {size} m)"

    def top_view(self, pixels_per_metre: float = 40.0, cut: float = 2.0) -> tuple[np.ndarray, np.ndarray]:
        """The scene from above with everything over ``cut`` metres removed.

        Returns:
            (H, W, 3) uint8, row 0 at the *largest* y (north up), white where there is nothing; and the world x, y of
            the lower left corner of the picture.
        """
        from autonerf_lab.scenes.top_view import top_view

        return top_view(self, pixels_per_metre, cut)

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Draw the scene from above, in metres."""
        from autonerf_lab.scenes.top_view import plot

        return plot(self, ax)

    def export_glb(self, path: str | Path, semantic: bool = False) -> Path:
        """Write a GLB that opens upright: y up, metres, texture embedded; ``semantic`` colours it by class instead.

        Its semantics go beside it, as ``NAME.semantics.json``, so that :func:`import_scene` gives back the same scene.

        Raises:
            DataError: a file cannot be written.
        """
        from autonerf_lab.scenes.gltf_export import export_glb
        from autonerf_lab.scenes.semantics_file import write_sidecar

        written = export_glb(self, Path(path), semantic)
        write_sidecar(self, written)
        return written

    def page(self, path: str | Path) -> Path:
        """Write an interactive 3-D page: one HTML file that opens from disk, without kernel or network.

        Raises:
            DataError: the file cannot be written.
        """
        from autonerf_lab.scenes.scene_page import write_page

        return write_page(self, Path(path))
