"""An interactive 3-D page of a scene: one HTML file that opens from disk, with no kernel, server or network.

It is drawn by three.js (MIT licence), which trimesh carries for its own viewer.
"""

import base64
import io
import json
import zipfile
from importlib.resources import files
from pathlib import Path

import numpy as np
from PIL import Image
from trimesh import resources

from autonerf_lab.classes import CLASS_COLORS, CLASS_NAMES
from autonerf_lab.errors import DataError
from autonerf_lab.geometry import CAMERA_HEIGHT
from autonerf_lab.scenes.scene import Scene
from autonerf_lab.storage import write_bytes

_END_OF_LIBRARY = "var camera,controls,scene,renderer,tracklight;"  # where trimesh's own viewer begins


def write_page(scene: Scene, path: Path) -> Path:
    """Write the page of a scene.

    Raises:
        DataError: the file cannot be written, or this trimesh has no viewer.
    """
    names = {i.id: i.name for i in scene.instances}
    order = np.argsort(scene.face_instance, kind="stable")
    numbers, starts = np.unique(scene.face_instance[order], return_index=True)
    corners = scene.vertices[scene.faces[order].reshape(-1)][:, [0, 2, 1]] * np.array([1, 1, -1], np.float32)  # y up
    picture = io.BytesIO()
    Image.fromarray(scene.texture).save(picture, "JPEG", quality=85)
    facts = {
        "name": scene.name,
        "classes": [{"name": n, "color": c.tolist()} for n, c in zip(CLASS_NAMES, CLASS_COLORS, strict=True)],
        "objects": [
            {"name": names.get(n, ""), "class": int(scene.face_class[order[a]]), "start": 3 * a, "count": 3 * (b - a)}
            for n, a, b in zip(numbers.tolist(), starts.tolist(), [*starts[1:].tolist(), len(order)], strict=True)
        ],
        "eye": _eye(scene),
    }
    text = (files("autonerf_lab.scenes") / "page.html").read_text(encoding="utf-8")
    # "<" must not end the script early, whatever a file's objects are called
    filled = {"LIBRARY": _library(), "FACTS": json.dumps(facts).replace("<", "\\u003c")}
    data = {"CORNERS": corners, "UV": scene.uv[order].reshape(-1, 2)}
    filled |= {key: _base64(array.astype("<f4").tobytes()) for key, array in data.items()}
    filled["PICTURE"] = _base64(picture.getvalue())
    for key, value in filled.items():
        text = text.replace(f"/*{key}*/", value, 1)
    write_bytes(path, text.encode())
    return path


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode()


def _library() -> str:
    """three.js with its controls."""
    with zipfile.ZipFile(io.BytesIO(resources.get_bytes("templates/viewer.zip"))) as archive:
        text = archive.read("viewer.html.template").decode()
    start, end = text.find("<script>") + len("<script>"), text.find(_END_OF_LIBRARY)
    if end < start:
        raise DataError("the installed trimesh carries another viewer; install the version in constraints.txt")
    return text[start:end]


def _eye(scene: Scene) -> list[list[float]]:
    """Where somebody could stand, and where they look, y up: the free floor cell farthest from walls and furniture."""
    from scipy import ndimage

    from autonerf_lab.scenes.columns import occupied_columns

    cell, origin = 0.1, scene.bounds[0, :2]
    cols, rows = np.maximum(np.ceil((scene.bounds[1, :2] - origin) / cell).astype(int), 1).tolist()
    grid = (origin, cell, (rows, cols))
    floor = occupied_columns(scene.vertices, scene.faces, -0.05, 0.05, *grid)
    blocked = occupied_columns(scene.vertices, scene.faces, 0.1, CAMERA_HEIGHT + 0.2, *grid)
    clear = ndimage.distance_transform_edt(np.pad(floor & ~blocked, 1))[1:-1, 1:-1]
    row, col = np.unravel_index(int(np.argmax(clear)), clear.shape)
    x, y = origin + (np.array([col, row]) + 0.5) * cell
    middle = scene.bounds.mean(axis=0)[:2] - [x, y]
    ahead = middle / max(float(np.linalg.norm(middle)), 1e-6)
    return [[float(x), CAMERA_HEIGHT, float(-y)], [float(x + ahead[0]), CAMERA_HEIGHT, float(-y - ahead[1])]]
