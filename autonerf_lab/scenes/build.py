"""Build a scene from its specification."""

from functools import partial

import numpy as np

from autonerf_lab.classes import CLASS_NAMES
from autonerf_lab.scenes.procedural_textures import GLOSS
from autonerf_lab.scenes.scene import Scene
from autonerf_lab.scenes.tessellation import SurfaceTessellation, tessellate, triangulate


def build(spec: dict) -> Scene:
    """Build the scene that a valid specification describes; the texture is baked on first access.

    Args:
        spec: Specification, see :mod:`autonerf_lab.scenes.spec`.

    Example:
        >>> cup = {"id": 1, "class": "cup", "name": "cup", "parts": [{"box": [1, 1, 1], "m": "red"}]}
        >>> scene = build({"name": "one", "lights": [], "materials": {"red": {"kind": "paint"}}, "objects": [cup]})
        >>> scene.vertices.shape, scene.faces.shape, scene.instances[0].name
        ((24, 3), (12, 3), 'cup')
    """
    tessellation = tessellate(spec)
    vertices, faces, uv, patch = triangulate(tessellation)
    classes = np.array([CLASS_NAMES.index(entry["class"]) for entry in spec["objects"]], dtype=np.uint8)
    ids = np.array([entry["id"] for entry in spec["objects"]], dtype=np.int32)
    owner = tessellation.object[patch]

    material_gloss = np.array([GLOSS.get(m["kind"], 0.0) for m in spec["materials"].values()], dtype=np.float32)
    gloss = material_gloss[tessellation.material[patch]]
    texture = partial(_texture, spec, tessellation)
    return Scene(spec["name"], vertices, faces, classes[owner], ids[owner], uv, texture, spec, gloss)


def _texture(spec: dict, tessellation: SurfaceTessellation) -> np.ndarray:
    from autonerf_lab.scenes.texture_baking import bake  # loads the bake kernels only when colours are needed

    return bake(spec, tessellation)
