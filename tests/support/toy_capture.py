"""Three small photographs with poses, and ways to spoil their transforms.json."""

import json

import numpy as np
from PIL import Image

from autonerf_lab.geometry import planar_pose

POSES = np.stack([planar_pose(0.5 * t, 0.2 * t, 0.3 * t) for t in range(3)])
CAMERA = {"w": 12, "h": 8, "fl_x": 10.0, "fl_y": 11.0, "cx": 6.5, "cy": 3.5}


def picture(t=0, width=12, height=8):
    return np.random.default_rng(t).integers(0, 256, (height, width, 3), dtype=np.uint8)


def make(folder, names=("a.png", "b.png", "c.png"), pictures=None, **top):
    """A folder of photographs; ``top`` replaces the camera."""
    for t, name in enumerate(names):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(picture(t) if pictures is None else pictures[t]).save(folder / name)
    frames = [{"file_path": n, "transform_matrix": p.tolist()} for n, p in zip(names, POSES, strict=False)]
    (folder / "transforms.json").write_text(json.dumps({**(top or CAMERA), "frames": frames}))
    return folder


def edit(folder, change):
    content = json.loads((folder / "transforms.json").read_text())
    change(content)
    (folder / "transforms.json").write_text(json.dumps(content))
    return folder


def put(*keys_and_value):
    *keys, last, value = keys_and_value

    def change(content):
        for key in keys:
            content = content[key]
        content[last] = value

    return change
