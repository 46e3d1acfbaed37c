"""A small Habitat dataset: a room of 6 x 5 x 2.5 m with z up, a chair and a cabinet with y up."""

import json
from pathlib import Path

import numpy as np
import trimesh

CHAIR_SIZE = (0.4, 0.9, 0.5)  # x, y up, z


def room(color: tuple[int, int, int] = (200, 190, 180)) -> trimesh.Trimesh:
    """Return a room with z up: one box seen from inside, x from 0 to 6 and y from 0 to 5."""
    box = trimesh.creation.box(bounds=[[0, 0, 0], [6, 5, 2.5]])
    box.invert()
    box.visual.vertex_colors = np.tile([*color, 255], (8, 1)).astype(np.uint8)
    return box


def block(size: tuple[float, ...], low: tuple[float, ...], color: tuple[int, int, int]) -> trimesh.Trimesh:
    """Return a box of a size with its lowest corner at a position."""
    mesh = trimesh.creation.box(bounds=[low, np.add(low, size)])
    mesh.visual.vertex_colors = np.tile([*color, 255], (8, 1)).astype(np.uint8)
    return mesh


def write_glb(path: Path, *meshes: trimesh.Trimesh) -> Path:
    """Write meshes as a GLB file, in their own coordinates."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(trimesh.exchange.gltf.export_glb(trimesh.Scene(list(meshes))))
    return path


def write_json(path: Path, content: object) -> Path:
    """Write a JSON file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content))
    return path


def make_dataset(folder: Path) -> Path:
    """Write the dataset, and return the path of its scene."""
    write_glb(folder / "assets/room.glb", room())
    write_glb(folder / "assets/8d3f.glb", block(CHAIR_SIZE, (-0.2, 0, -0.25), (120, 60, 20)))
    write_glb(folder / "assets/frl_cabinet_01.glb", block((1, 2, 0.5), (0, 0, 0), (20, 60, 120)))
    write_json(folder / "configs/stages/room.stage_config.json", {"render_asset": "../../assets/room.glb"})
    write_json(
        folder / "configs/objects/8d3f.object_config.json", {"render_asset": "../../assets/8d3f.glb", "semantic_id": 7}
    )
    write_json(
        folder / "configs/objects/frl_cabinet_01.object_config.json",
        {"render_asset": "../../assets/frl_cabinet_01.glb"},
    )
    write_json(folder / "configs/lexicon.json", {"classes": [{"id": 7, "name": "armchair"}]})
    write_json(
        folder / "toy.scene_dataset_config.json",
        {
            "stages": {"paths": {".json": ["configs/stages"]}},
            "objects": {"paths": {".json": ["configs/objects/*"]}},
            "scene_instances": {"paths": {".json": ["configs/scenes"]}},
            "semantic_scene_descriptor_instances": {"paths": {".json": ["configs/lexicon.json"]}},
        },
    )
    half = np.sqrt(0.5)
    return write_json(
        folder / "configs/scenes/home.scene_instance.json",
        {
            "stage_instance": {"template_name": "stages/room"},
            "object_instances": [
                # Habitat's world has y up: (2, 0, -3) is x = 2, y = 3 of the room; a quarter turn about y
                {"template_name": "8d3f", "translation": [2, 0, -3], "rotation": [half, 0, half, 0]},
                {"template_name": "objects/frl_cabinet_01", "translation": [4, 0, -1], "uniform_scale": 0.5},
            ],
            "articulated_object_instances": [{"template_name": "fridge"}],
        },
    )
