"""An interactive 3-D page of a scene: one HTML file that opens from disk, with no kernel, server or network.

It is drawn by three.js (MIT licence), which trimesh carries for its own viewer.
"""

import base64
import io
import json
import re
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
from autonerf_lab.utils.storage import write_bytes

MAX_SIDE = 8192  # texels that any browser draws
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
    image, picture = Image.fromarray(scene.texture), io.BytesIO()
    if max(image.size) > MAX_SIDE:
        image = image.resize((min(image.width, MAX_SIDE), min(image.height, MAX_SIDE)), Image.Resampling.BOX)
    image.save(picture, "JPEG", quality=85)
    facts = {
        "name": scene.name,
        "classes": [{"name": n, "color": c.tolist()} for n, c in zip(CLASS_NAMES, CLASS_COLORS, strict=True)],
        "objects": [
            {"name": names.get(n, ""), "class": int(scene.face_class[order[a]]), "start": 3 * a, "count": 3 * (b - a)}
            for n, a, b in zip(numbers.tolist(), starts.tolist(), [*starts[1:].tolist(), len(order)], strict=True)
        ],
        "eye": _eye(scene),
    }
    text = (files("autonerf_lab.scenes") / "scene_page.html").read_text(encoding="utf-8")
    # "<" must not end the script early, whatever a file's objects are called
    filled = {"LIBRARY": _library(), "FACTS": json.dumps(facts).replace("<", "\\u003c")}
    data = {"CORNERS": corners, "UV": scene.uv[order].reshape(-1, 2)}
    filled |= {key: _base64(array.astype("<f4").tobytes()) for key, array in data.items()}
    filled["PICTURE"] = _base64(picture.getvalue())
    # in one pass: what a name says is not a place to fill
    text = re.sub(rf"/\*({'|'.join(filled)})\*/", lambda found: filled[found[1]], text)
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
    """Where somebody could stand, and where they look, y up: of free places that with the widest view."""
    from scipy import ndimage

    from autonerf_lab.scenes.height_band import occupied_columns

    cell, origin = 0.1, scene.bounds[0, :2]
    cols, rows = np.maximum(np.ceil((scene.bounds[1, :2] - origin) / cell).astype(int), 1).tolist()

    def between(low: float, high: float) -> np.ndarray:
        return occupied_columns(scene.vertices, scene.faces, low, high, origin, cell, (rows, cols))

    floor = between(-0.05, 0.05)
    blocked = between(0.1, CAMERA_HEIGHT + 0.2)
    clear = ndimage.distance_transform_edt(np.pad(floor & ~blocked, 1))[1:-1, 1:-1]
    places = np.argwhere(clear >= min(4, clear.max()))[:, ::-1]  # column, row; 40 cm from what stands there
    places = places[:: -(-len(places) // 200)]
    opaque = between(CAMERA_HEIGHT - 0.3, CAMERA_HEIGHT + 0.2)
    (col, row), ahead = _widest_view(places, opaque | ~floor & ~blocked)
    x, y = origin + (np.array([col, row]) + 0.5) * cell
    return [[float(x), CAMERA_HEIGHT, float(-y)], [float(x + ahead[0]), CAMERA_HEIGHT, float(-y - ahead[1])]]


def _widest_view(places: np.ndarray, opaque: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of places (P, 2), column and row, and directions (2,) the pair that sees farthest within 65 degrees."""
    angle = np.deg2rad(np.arange(0, 360, 5))
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    steps = np.arange(1, 61)  # cells: 6 m are enough
    seen = np.rint(places[:, None, None] + direction[:, None] * steps[:, None]).astype(int) + 1
    padded = np.pad(opaque, 1, constant_values=True)
    seen = np.clip(seen, 0, np.array(padded.shape)[::-1] - 1)
    hit = padded[seen[..., 1], seen[..., 0]]
    free = np.where(hit.any(axis=-1), hit.argmax(axis=-1), len(steps)).astype(float)
    view = np.sum([np.roll(free, k, axis=1) for k in range(-6, 7)], axis=0)
    place, heading = np.unravel_index(int(np.argmax(view)), view.shape)
    return places[place], direction[heading]
