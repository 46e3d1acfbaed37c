"""Three small photographs with poses, and functions that edit their transforms.json."""

import json

import numpy as np
from PIL import Image

from autonerf_lab.geometry import planar_pose

POSES = np.stack([planar_pose(0.5 * t, 0.2 * t, 0.3 * t) for t in range(3)])
CAMERA = {"w": 12, "h": 8, "fl_x": 10.0, "fl_y": 11.0, "cx": 6.5, "cy": 3.5}


def image(t=0, width=12, height=8):
    """Return (height, width, 3) uint8 random pixels."""
    return np.random.default_rng(t).integers(0, 256, (height, width, 3), dtype=np.uint8)


def make(folder, names=("a.png", "b.png", "c.png"), images=None, **top):
    """Write a folder of photographs; ``top`` replaces the keys of the camera."""
    for t, name in enumerate(names):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(image(t) if images is None else images[t]).save(folder / name)
    frames = [{"file_path": n, "transform_matrix": p.tolist()} for n, p in zip(names, POSES, strict=False)]
    (folder / "transforms.json").write_text(json.dumps({**(top or CAMERA), "frames": frames}))
    return folder


def edit(folder, change):
    """Apply ``change`` to the content of transforms.json, and return the folder."""
    content = json.loads((folder / "transforms.json").read_text())
    change(content)
    (folder / "transforms.json").write_text(json.dumps(content))
    return folder


def put(*keys_and_value):
    """Return a change that sets a nested key to a value."""
    *keys, last, value = keys_and_value

    def change(content):
        for key in keys:
            content = content[key]
        content[last] = value

    return change
