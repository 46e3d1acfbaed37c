"""Apartments: a textured triangle mesh with labels, generated from a seed, loaded from a frozen file or imported."""

from autonerf_lab.scenes.generator import generate_apartment
from autonerf_lab.scenes.library import load_scene, scene_names
from autonerf_lab.scenes.mesh_import import import_scene
from autonerf_lab.scenes.scene import Instance, Scene

__all__ = ["Instance", "Scene", "generate_apartment", "import_scene", "load_scene", "scene_names"]
