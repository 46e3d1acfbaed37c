"""Formats of other tools for ``benchmarks/fuzz.py``: Habitat's scenes and episodes, and posed images."""

import gzip
import json
import struct
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from PIL import Image
from scipy.spatial.transform import Rotation

from autonerf_lab.data.dataset import load_dataset
from autonerf_lab.data.episodes import read_episodes
from autonerf_lab.geometry import planar_pose
from autonerf_lab.scenes import import_scene
from autonerf_lab.scenes.class_aliases import read_aliases

Entry = tuple[str, Path, Callable[[], Any]]  # name, valid file, loader
FRAMES, SIDE = 3, 8


def make_sources(folder: Path) -> list[Entry]:
    """Write a valid file of every format, each in a folder of its own."""
    folder.mkdir(parents=True, exist_ok=True)
    return [*_scenes(folder), *_episodes(folder), *_sequences(folder)]


def _write(path: Path, content: object) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    if isinstance(content, bytes):
        path.write_bytes(content)
    else:
        path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def _scenes(folder: Path) -> list[Entry]:
    room = trimesh.creation.box(bounds=[[0.0, 0.0, 0.0], [6.0, 5.0, 2.5]])
    room.invert()
    room.visual.vertex_colors = np.tile([1, 2, 3, 255], (8, 1)).astype(np.uint8)
    glb = trimesh.exchange.gltf.export_glb(trimesh.Scene(room))
    for name in ("habitat/room.glb", "habitat/chair.glb", "hm3d/a.glb", "hm3d/a.semantic.glb"):
        _write(folder / name, glb)
    text = _write(folder / "hm3d/a.semantic.txt", 'HM3D Semantic Annotations\n1,010203,"wall",0\n2,FF0000,"sofa",1\n')
    house = _write(folder / "mp3d/a.house", "ASCII 1.1\nC 0 1 sofa 10 sofa 0 0 0 0 0\nO 0 0 0  0 0 0  1 0 0\n")
    _write(folder / "mp3d/a.glb", glb)
    labelled = _write(folder / "mp3d/a_semantic.ply", "ply\nformat ascii 1.0\nelement vertex 4\n" + "".join(
        f"property float {axis}\n" for axis in "xyz") + "element face 2\nproperty list uchar int vertex_indices\n"
        "property int object_id\nend_header\n0 0 0\n6 0 0\n6 5 0\n0 5 0\n3 0 1 2 0\n3 0 2 3 0\n")  # fmt: skip
    stage = _write(folder / "habitat/room.stage_config.json", {"render_asset": "room.glb", "up": [0, 0, 1],
                                                              "front": [0, 1, 0], "units_to_meters": 1.0})  # fmt: skip
    chair = _write(folder / "habitat/chair.object_config.json", {"render_asset": "chair.glb", "scale": [0.1, 0.1, 0.1],
                                                                "COM": [0, 0, 0], "semantic_id": 3})  # fmt: skip
    lexicon = _write(folder / "habitat/lexicon.json", {"classes": [{"id": 3, "name": "chair"}]})
    groups = {name: {"paths": {".json": ["."]}} for name in ("stages", "objects", "scene_instances")}
    semantics = {"semantic_scene_descriptor_instances": {"paths": {".json": ["lexicon.json"]}}}
    dataset = _write(folder / "habitat/toy.scene_dataset_config.json", {**groups, **semantics})
    scene = _write(folder / "habitat/home.scene_instance.json", {
        "stage_instance": {"template_name": "room"},
        "object_instances": [{"template_name": "chair", "translation": [2, 0, -2], "rotation": [1, 0, 0, 0]}],
    })  # fmt: skip
    aliases = _write(folder / "aliases/aliases.json", {"sofa": "couch", "wing chair": "chair"})
    files = {"stage": stage, "object": chair, "lexicon": lexicon, "dataset": dataset, "composite": scene}
    return [
        *((f"habitat-{name}.json", file, lambda: import_scene(scene)) for name, file in files.items()),
        ("hm3d.semantic.txt", text, lambda: import_scene(folder / "hm3d/a.glb")),
        ("hm3d.semantic.glb", folder / "hm3d/a.semantic.glb", lambda: import_scene(folder / "hm3d/a.glb")),
        ("mp3d.house", house, lambda: import_scene(folder / "mp3d/a.glb")),
        ("mp3d_semantic.ply", labelled, lambda: import_scene(folder / "mp3d/a.glb")),
        ("aliases.json", aliases, lambda: read_aliases(aliases)),
    ]


def _episodes(folder: Path) -> list[Entry]:
    entry = {"episode_id": "1", "scene_id": "a.glb", "start_position": [0, 0, 0], "start_rotation": [0, 0, 0, 1],
             "goals": [{"position": [1, 0, 0], "radius": None}], "info": {"geodesic_distance": 1.0}}  # fmt: skip
    content = json.dumps({"episodes": [entry] * 3}).encode()
    plain = _write(folder / "episodes/e.json", content)
    packed = _write(folder / "episodes_gz/e.json.gz", gzip.compress(content))
    return [
        ("episodes.json", plain, lambda: read_episodes(plain)),
        ("episodes.json.gz", packed, lambda: read_episodes(packed)),
    ]


def _sequences(folder: Path) -> list[Entry]:
    rng = np.random.default_rng(0)
    poses = np.stack([planar_pose(0.3 * t, 1.0, 0.2 * t) for t in range(FRAMES)]) @ np.diag([1.0, -1, -1, 1])
    places = {
        "tum": "rgb/{t}.png depth/{t}.png",
        "scannet": "color/{t}.png depth/{t}.png",
        "replica": "results/frame{t:06d}.png results/depth{t:06d}.png",
        "polycam": "keyframes/images/{t}.jpg",
        "record3d": "rgb/{t}.png",
        "colmap_text": "images/{t}.png",
        "colmap_binary": "images/{t}.png",
        "blender": "{t}.png",
    }
    for place, names in places.items():
        for t in range(FRAMES):
            for name in names.split():
                path = folder / place / name.format(t=t)
                path.parent.mkdir(parents=True, exist_ok=True)
                depth = "depth" in path.parent.name or path.name.startswith("depth")
                array = rng.integers(0, 255, (SIDE, SIDE) if depth else (SIDE, SIDE, 3))
                Image.fromarray(array.astype(np.uint16 if depth else np.uint8)).save(path)
    rows = ["\n".join(" ".join(f"{v:.9f}" for v in row) for row in pose) for pose in poses]
    quaternions = [Rotation.from_matrix(pose[:3, :3]).as_quat() for pose in poses]
    lines = [" ".join(f"{v:.9f}" for v in (t, *poses[t, :3, 3], *quaternions[t])) for t in range(FRAMES)]
    tum = folder / "tum"
    _write(tum / "rgb.txt", "".join(f"{t}.0 rgb/{t}.png\n" for t in range(FRAMES)))
    _write(tum / "depth.txt", "".join(f"{t}.0 depth/{t}.png\n" for t in range(FRAMES)))
    _write(tum / "groundtruth.txt", "\n".join(lines))
    _write(tum / "camera.txt", "8 8 8 8 3.5 3.5")
    for t in range(FRAMES):
        _write(folder / f"scannet/pose/{t}.txt", rows[t])
        camera = {"fx": 8.0, "fy": 8.0, "cx": 4.0, "cy": 4.0, "width": 8, "height": 8}
        camera |= {f"t_{i}{j}": float((poses[t] @ np.diag([1.0, -1, -1, 1]))[i, j]) for i in range(3) for j in range(4)}
        _write(folder / f"polycam/keyframes/cameras/{t}.json", camera)
    for name in ("color", "depth"):
        _write(folder / f"scannet/intrinsic/intrinsic_{name}.txt", "8 0 3.5 0\n0 8 3.5 0\n0 0 1 0\n0 0 0 1")
    _write(folder / "replica/traj.txt", "\n".join(row.replace("\n", " ") for row in rows))
    parameters = {"w": 8, "h": 8, "fx": 8.0, "fy": 8.0, "cx": 3.5, "cy": 3.5, "scale": 1000.0}
    _write(folder / "replica/cam_params.json", {"camera": parameters})
    record = {"w": 8, "h": 8, "K": [8, 0, 0, 0, 8, 0, 4, 4, 1]}
    record["poses"] = [[*quaternion, 0.1 * t, 0, 0] for t, quaternion in enumerate(quaternions)]
    _write(folder / "record3d/metadata.json", record)
    _write(folder / "colmap_text/sparse/0/cameras.txt", "1 PINHOLE 8 8 8 8 4 4\n")
    _write(folder / "colmap_text/sparse/0/images.txt", "".join(
        f"{t + 1} 1 0 0 0 {t} 0 0 1 {t}.png\n1 1 -1\n" for t in range(FRAMES)))  # fmt: skip
    model = folder / "colmap_binary/sparse/0"
    _write(model / "cameras.bin", struct.pack("<QiiQQ4d", 1, 1, 1, 8, 8, 8, 8, 4, 4))
    images = b"".join(
        struct.pack("<i7di", t + 1, 1, 0, 0, 0, t, 0, 0, 1) + f"{t}.png\0".encode() + struct.pack("<Q", 0)
        for t in range(FRAMES)
    )
    _write(model / "images.bin", struct.pack("<Q", FRAMES) + images)
    for name, chosen in (("train", [0, 1]), ("test", [2])):
        entries = [{"file_path": f"./{t}", "transform_matrix": poses[t].tolist()} for t in chosen]
        _write(folder / f"blender/transforms_{name}.json", {"camera_angle_x": 0.9, "frames": entries})
    files = {
        "blender.json": "blender/transforms_train.json",
        "tum-groundtruth.txt": "tum/groundtruth.txt",
        "tum-rgb.txt": "tum/rgb.txt",
        "tum-camera.txt": "tum/camera.txt",
        "scannet-pose.txt": "scannet/pose/1.txt",
        "scannet-intrinsic.txt": "scannet/intrinsic/intrinsic_depth.txt",
        "replica-traj.txt": "replica/traj.txt",
        "replica-camera.json": "replica/cam_params.json",
        "polycam.json": "polycam/keyframes/cameras/1.json",
        "record3d.json": "record3d/metadata.json",
        "colmap-cameras.txt": "colmap_text/sparse/0/cameras.txt",
        "colmap-images.txt": "colmap_text/sparse/0/images.txt",
        "colmap-cameras.bin": "colmap_binary/sparse/0/cameras.bin",
        "colmap-images.bin": "colmap_binary/sparse/0/images.bin",
    }
    return [(name, folder / file, partial(load_dataset, folder / Path(file).parts[0])) for name, file in files.items()]
