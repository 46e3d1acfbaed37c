"""Apartments as labelled, textured triangle meshes: generated from a seed, loaded from a file or imported."""

from autonerf_lab.scenes.generator import generate_apartment
from autonerf_lab.scenes.gltf_export import export_glb
from autonerf_lab.scenes.import_report import ImportReport
from autonerf_lab.scenes.library import load_scene, scene_names
from autonerf_lab.scenes.mesh_import import import_scene
from autonerf_lab.scenes.plotting import plot_scene, top_view
from autonerf_lab.scenes.scene import Instance, Scene
from autonerf_lab.scenes.scene_page import write_page

__all__ = [
    "ImportReport",
    "Instance",
    "Scene",
    "export_glb",
    "generate_apartment",
    "import_scene",
    "load_scene",
    "plot_scene",
    "scene_names",
    "top_view",
    "write_page",
]
