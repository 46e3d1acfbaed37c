"""Write the frozen scenes: ``python -m autonerf_lab.scenes.freeze``.

The scenes were written once and are data since then: a change of the generator does not change them. ``--check``
rebuilds every mesh and compares it with the manifest.
"""

import argparse
import hashlib
import io
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from autonerf_lab.errors import SceneError
from autonerf_lab.scenes.build import build
from autonerf_lab.scenes.generator import generate_spec
from autonerf_lab.scenes.library import folder, scene_names
from autonerf_lab.scenes.plotting import top_view
from autonerf_lab.scenes.scene import Scene
from autonerf_lab.scenes.spec import dumps, read_spec
from autonerf_lab.utils.storage import read_json, write_bytes, write_json

FIRST_SEED = {"train": 1_000, "dev": 2_000, "val": 3_000}


def mesh_sha256(scene: Scene) -> str:
    """Return the SHA-256 of faces, classes, instances and vertices rounded to 0.1 mm, hexadecimal."""
    digest = hashlib.sha256()
    digest.update(np.round(scene.vertices.astype(np.float64) * 1e4).astype("<i8").tobytes())
    for array, kind in ((scene.faces, "<i4"), (scene.face_class, "u1"), (scene.face_instance, "<i4")):
        digest.update(np.ascontiguousarray(array.astype(kind)).tobytes())
    return digest.hexdigest()


def seed_of(name: str) -> int:
    """Return the generator seed of a frozen scene; the seeds of the three splits are disjoint.

    Example:
        >>> seed_of("dev-3"), seed_of("train-24")
        (2003, 1024)
    """
    split, number = name.split("-")
    return FIRST_SEED[split] + int(number)


def freeze(target: Path, thumbnails: bool = True) -> None:
    """Generate all frozen scenes and write their specifications, thumbnails (top views) and manifest to a folder."""
    scenes = {}
    for name in scene_names():
        spec = generate_spec(seed_of(name), name)
        text = dumps(spec).encode()
        write_bytes(target / f"{name}.json", text)
        scene = build(spec)
        scenes[name] = {
            "seed": seed_of(name),
            "spec_sha256": hashlib.sha256(text).hexdigest(),
            "mesh_sha256": mesh_sha256(scene),
            "triangles": len(scene.faces),
            "rooms": len(spec["rooms"]),
            "objects": len(scene.instances),
        }
        if thumbnails:
            jpeg = io.BytesIO()
            Image.fromarray(top_view(scene, 32.0)[0]).save(jpeg, "JPEG", quality=88)
            write_bytes(target / "thumbnails" / f"{name}.jpg", jpeg.getvalue())
    write_json(target / "manifest.json", {"version": 1, "scenes": scenes})


def verify(target: Path) -> None:
    """Compare all specifications and meshes with the manifest.

    Raises:
        SceneError: A specification or mesh differs; the message names the file.
    """
    for name, entry in read_json(target / "manifest.json", dict[str, Any])["scenes"].items():
        path = target / f"{name}.json"
        spec = read_spec(path)
        if hashlib.sha256(path.read_bytes()).hexdigest() != entry["spec_sha256"]:
            raise SceneError(f"{path} differs from the manifest (SHA-256 of the file); restore it from the repository")
        if mesh_sha256(build(spec)) != entry["mesh_sha256"]:
            raise SceneError(f"{path} builds a mesh that differs from the manifest; the mesh builder has changed")


def main() -> None:
    """Run the command line of the module."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--check", action="store_true", help="Compare the files with the manifest instead of writing them."
    )
    parser.add_argument(
        "--folder", type=Path, default=None, help="Folder of the scenes; default: that of the repository."
    )
    options = parser.parse_args()
    if options.check:
        verify(options.folder or folder())
        print("all scenes match the manifest")
    else:
        freeze(options.folder or Path(__file__).resolve().parents[2] / "data" / "procedural_scenes")


if __name__ == "__main__":
    main()
