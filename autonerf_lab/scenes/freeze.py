"""Write the frozen scenes: ``python -m autonerf_lab.scenes.freeze``.

The scenes were written once and are data since then: a change of the generator does not change them. ``--check``
rebuilds every mesh and compares it with the manifest.
"""

import argparse
import hashlib
import io
from collections.abc import Sequence
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

FIRST_SEED = {"train": 1_000, "dev": 2_000, "val": 3_000, "house": 5_000}
HOUSES = ((180, 8, 1), (210, 10, 2), (240, 11, 1), (270, 13, 2), (300, 14, 1))  # m2, rooms, floors of house-0 ... 4


def mesh_sha256(scene: Scene) -> str:
    """Return the SHA-256 of faces, classes, instances and vertices rounded to 0.1 mm, hexadecimal."""
    digest = hashlib.sha256()
    digest.update(np.round(scene.vertices.astype(np.float64) * 1e4).astype("<i8").tobytes())
    for array, kind in ((scene.faces, "<i4"), (scene.face_class, "u1"), (scene.face_instance, "<i4")):
        digest.update(np.ascontiguousarray(array.astype(kind)).tobytes())
    return digest.hexdigest()


def seed_of(name: str) -> int:
    """Return the generator seed of a frozen scene; the seeds of the splits are disjoint.

    Those of the test apartments are the first 32 bits of the SHA-256 of their names, so that nobody chose them.

    Example:
        >>> seed_of("dev-3"), seed_of("train-24"), seed_of("test-00")
        (2003, 1024, 2752247044)
    """
    if name.startswith("test-"):
        return int(hashlib.sha256(name.encode()).hexdigest()[:8], 16)
    split, number = name.split("-")
    return FIRST_SEED[split] + int(number)


def frozen_spec(name: str) -> dict:
    """Generate the specification of a frozen scene: an apartment, or a house of the size in :data:`HOUSES`."""
    if not name.startswith("house-"):
        return generate_spec(seed_of(name), name)
    area, rooms, floors = HOUSES[int(name.removeprefix("house-"))]
    return generate_spec(seed_of(name), name, area=area, rooms=rooms, floors=floors)


def freeze(target: Path, names: Sequence[str] | None = None) -> None:
    """Generate frozen scenes and write their specifications, thumbnails (top views) and manifest entries to a folder.

    Args:
        target: Folder of the scenes.
        names: Scenes to write; the others stay as they are. Default: all.
    """
    path = target / "manifest.json"
    scenes = read_json(path, dict[str, Any])["scenes"] if names is not None and path.exists() else {}
    for name in scene_names() if names is None else names:
        spec = frozen_spec(name)
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
        if not name.startswith("test-"):  # nobody looks at these before the final evaluation
            jpeg = io.BytesIO()
            Image.fromarray(top_view(scene, 32.0)[0]).save(jpeg, "JPEG", quality=88)
            write_bytes(target / "thumbnails" / f"{name}.jpg", jpeg.getvalue())
    write_json(path, {"version": 1, "scenes": scenes})


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
    parser.add_argument("--split", default=None, help="Write only the scenes of this split; default: all.")
    options = parser.parse_args()
    if options.check:
        verify(options.folder or folder())
        print("all scenes match the manifest")
    else:
        names = None if options.split is None else scene_names(options.split)
        freeze(options.folder or Path(__file__).resolve().parents[2] / "data" / "procedural_scenes", names)


if __name__ == "__main__":
    main()
