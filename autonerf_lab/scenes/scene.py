"""Scene: one textured triangle mesh with a class and an object number for every face."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from autonerf_lab.classes import CLASS_NAMES

if TYPE_CHECKING:
    from autonerf_lab.scenes.import_report import ImportReport


@dataclass(frozen=True)
class Instance:
    """Object of a scene with its axis-aligned bounding box in the world frame."""

    id: int  # value of the object's faces in ``Scene.face_instance``
    class_id: int  # 0..15; 0: an object of none of the 15 classes
    name: str
    center: np.ndarray  # (3,) float64, centre of the box, metres
    size: np.ndarray  # (3,) float64, extent along world x, y, z, metres


@dataclass(frozen=True, eq=False)
class Scene:
    """Static labelled world, generated or scanned. World frame: metres, z up, floor at z = 0.

    Texture coordinates have u to the right and v *down*: the texel of (u, v) is
    ``texture[int(v * height), int(u * width)]``. Draw a scene with :func:`~autonerf_lab.scenes.plot_scene` and
    :func:`~autonerf_lab.scenes.write_page`; save it with :func:`~autonerf_lab.scenes.export_glb`.

    Example:
        >>> from autonerf_lab.scenes import load_scene
        >>> scene = load_scene("val-0")
        >>> bool((scene.faces.max() < len(scene.vertices)) and scene.uv.shape == (len(scene.faces), 3, 2))
        True
    """

    name: str
    vertices: np.ndarray  # (V, 3) float32, metres, world frame
    faces: np.ndarray  # (F, 3) int32, counter-clockwise seen from the free side
    face_class: np.ndarray  # (F,) uint8, 0..15
    face_instance: np.ndarray  # (F,) int32, 0 = the building: walls, floor, ceiling, doors, windows
    uv: np.ndarray  # (F, 3, 2) float32 in [0, 1]
    bake: Callable[[], np.ndarray] = field(repr=False)  # computes the texture; called on first access to ``texture``
    spec: dict | None = field(default=None, repr=False)  # specification of a generated scene
    gloss: np.ndarray | None = field(default=None, repr=False)  # (F,) float32 in [0, 1], specular share; None: unknown
    names: dict[int, str] = field(default_factory=dict, repr=False)  # object names by id, used when there is no spec
    import_report: "ImportReport | None" = field(default=None, repr=False)  # of an imported scene: what was found

    @cached_property
    def texture(self) -> np.ndarray:
        """Texture, (Ht, Wt, 3) uint8 sRGB: albedo times baked light. Computed on first access."""
        return self.bake()

    @cached_property
    def bounds(self) -> np.ndarray:
        """Lower and upper corner of the scene, (2, 3) float64, metres."""
        used = self.vertices[self.faces.reshape(-1)].astype(np.float64)
        return np.stack([used.min(axis=0), used.max(axis=0)])

    @cached_property
    def sha256(self) -> str:
        """SHA-256 of geometry and labels, hexadecimal: identifies the scene of a trajectory."""
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
        """Objects that have faces, in order of their id, without the building."""
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
