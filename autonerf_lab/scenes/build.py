"""A specification becomes a scene."""

from functools import partial

import numpy as np

from autonerf_lab.classes import CLASS_NAMES
from autonerf_lab.scenes.procedural_textures import GLOSS
from autonerf_lab.scenes.scene import Scene
from autonerf_lab.scenes.tessellation import Patches, build_patches, triangulate


def build(spec: dict) -> Scene:
    """The scene a valid specification describes. The texture is baked when it is first asked for.

    Example:
        >>> cup = {"id": 1, "class": "cup", "name": "cup", "parts": [{"box": [1, 1, 1], "m": "red"}]}
        >>> scene = build({"name": "one", "lights": [], "materials": {"red": {"kind": "paint"}}, "objects": [cup]})
        >>> scene.vertices.shape, scene.faces.shape, scene.instances[0].name
        ((24, 3), (12, 3), 'cup')
    """
    patches = build_patches(spec)
    vertices, faces, uv, patch = triangulate(patches)
    classes = np.array([CLASS_NAMES.index(thing["class"]) for thing in spec["objects"]], dtype=np.uint8)
    numbers = np.array([thing["id"] for thing in spec["objects"]], dtype=np.int32)
    owner = patches.object[patch]

    shine = np.array([GLOSS.get(m["kind"], 0.0) for m in spec["materials"].values()], dtype=np.float32)
    gloss = shine[patches.material[patch]]
    texture = partial(_texture, spec, patches)
    return Scene(spec["name"], vertices, faces, classes[owner], numbers[owner], uv, texture, spec, gloss)


def _texture(spec: dict, patches: Patches) -> np.ndarray:
    from autonerf_lab.scenes.texture_baking import bake  # embree and the kernels: only for those who want colours

    return bake(spec, patches)
