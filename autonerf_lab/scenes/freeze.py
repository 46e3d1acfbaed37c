"""Write the frozen scenes: ``python -m autonerf_lab.scenes.freeze``. Run once, before anything is trained on them.

Afterwards the files are data; a change of the generator does not touch them. ``--check`` rebuilds every mesh and
compares it with the manifest.
"""

import argparse
import hashlib
import io
from pathlib import Path

import numpy as np
from PIL import Image

from autonerf_lab.errors import SceneError
from autonerf_lab.scenes.build import build
from autonerf_lab.scenes.generator import generate_spec
from autonerf_lab.scenes.library import folder, scene_names
from autonerf_lab.scenes.scene import Scene
from autonerf_lab.scenes.spec import dumps, read_spec
from autonerf_lab.utils.storage import read_json, write_bytes, write_json

FIRST_SEED = {"train": 1_000, "dev": 2_000, "val": 3_000}


def mesh_sha256(scene: Scene) -> str:
    """Digest of vertices rounded to a tenth of a millimetre, faces, classes and instances."""
    digest = hashlib.sha256()
    digest.update(np.round(scene.vertices.astype(np.float64) * 1e4).astype("<i8").tobytes())
    for array, kind in ((scene.faces, "<i4"), (scene.face_class, "u1"), (scene.face_instance, "<i4")):
        digest.update(np.ascontiguousarray(array.astype(kind)).tobytes())
    return digest.hexdigest()


def seed_of(name: str) -> int:
    """The seed a frozen scene was made from; those of the three splits never meet.

    Example:
        >>> seed_of("dev-3"), seed_of("train-24")
        (2003, 1024)
    """
    split, number = name.split("-")
    return FIRST_SEED[split] + int(number)


def freeze(target: Path, thumbnails: bool = True) -> None:
    """Generate and write all specifications, a picture of each from above, and the manifest into a folder."""
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
            picture = io.BytesIO()
            Image.fromarray(scene.top_view(32.0)[0]).save(picture, "JPEG", quality=88)
            write_bytes(target / "thumbnails" / f"{name}.jpg", picture.getvalue())
    write_json(target / "manifest.json", {"version": 1, "scenes": scenes})


def verify(target: Path) -> None:
    """Raise SceneError at the first specification or mesh that is not what the manifest says."""
    for name, entry in read_json(target / "manifest.json")["scenes"].items():
        path = target / f"{name}.json"
        spec = read_spec(path)
        if hashlib.sha256(path.read_bytes()).hexdigest() != entry["spec_sha256"]:
            raise SceneError(f"{path} is not the file in the manifest")
        if mesh_sha256(build(spec)) != entry["mesh_sha256"]:
            raise SceneError(f"{path} gives another mesh than the manifest says")


def main() -> None:
    """Command line of the module."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="only compare the files with the manifest")
    parser.add_argument("--folder", type=Path, default=None, help="where to write; without it, the project's own")
    options = parser.parse_args()
    if options.check:
        verify(options.folder or folder())
        print("all scenes are as the manifest says")
    else:
        freeze(options.folder or Path(__file__).resolve().parents[2] / "data" / "procedural_scenes")


if __name__ == "__main__":
    main()
