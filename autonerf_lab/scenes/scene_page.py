"""Interactive 3-D page of a scene: one HTML file that opens from disk, without kernel, server or network.

The page renders with three.js (MIT licence), extracted from the viewer that trimesh includes.
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

from autonerf_lab.classes import CLASS_COLORS, CLASS_NAMES
from autonerf_lab.errors import DataError
from autonerf_lab.geometry import CAMERA_HEIGHT
from autonerf_lab.scenes.height_band import occupied_cells
from autonerf_lab.scenes.scene import Scene
from autonerf_lab.utils.storage import write_bytes

MAX_SIDE = 8192  # texels, the largest texture side that every browser accepts
# first statement of trimesh's own viewer, after three.js
_END_OF_LIBRARY = "var camera,controls,scene,renderer,tracklight;"


def write_page(scene: Scene, path: str | Path) -> Path:
    """Write an interactive 3-D page of a scene.

    Args:
        scene: Scene to show.
        path: HTML file to write.

    Returns:
        The path of the page.

    Raises:
        DataError: The file cannot be written, or the installed trimesh has no usable viewer.
    """
    path = Path(path)
    names = {i.id: i.name for i in scene.instances}
    order = np.argsort(scene.face_instance, kind="stable")
    ids, starts = np.unique(scene.face_instance[order], return_index=True)
    corners = scene.vertices[scene.faces[order].reshape(-1)][:, [0, 2, 1]] * np.array([1, 1, -1], np.float32)  # y up
    image, jpeg = Image.fromarray(scene.texture), io.BytesIO()
    if max(image.size) > MAX_SIDE:
        image = image.resize((min(image.width, MAX_SIDE), min(image.height, MAX_SIDE)), Image.Resampling.BOX)
    image.save(jpeg, "JPEG", quality=85)
    facts = {
        "name": scene.name,
        "classes": [{"name": n, "color": c.tolist()} for n, c in zip(CLASS_NAMES, CLASS_COLORS, strict=True)],
        "objects": [
            {"name": names.get(n, ""), "class": int(scene.face_class[order[a]]), "start": 3 * a, "count": 3 * (b - a)}
            for n, a, b in zip(ids.tolist(), starts.tolist(), [*starts[1:].tolist(), len(order)], strict=True)
        ],
        "eye": _eye(scene),
    }
    text = (files("autonerf_lab.scenes") / "scene_page.html").read_text(encoding="utf-8")
    # escape "<": an object name must not end the script element
    filled = {"LIBRARY": _library(), "FACTS": json.dumps(facts).replace("<", "\\u003c")}
    data = {"CORNERS": corners, "UV": scene.uv[order].reshape(-1, 2)}
    filled |= {key: _base64(array.astype("<f4").tobytes()) for key, array in data.items()}
    filled["TEXTURE"] = _base64(jpeg.getvalue())
    # one pass: placeholders inside names are not replaced
    text = re.sub(rf"/\*({'|'.join(filled)})\*/", lambda found: filled[found[1]], text)
    write_bytes(path, text.encode())
    return path


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode()


def _library() -> str:
    """Return the source of three.js and its controls from trimesh's viewer."""
    from trimesh import resources

    with zipfile.ZipFile(io.BytesIO(resources.get_bytes("templates/viewer.zip"))) as archive:
        text = archive.read("viewer.html.template").decode()
    start, end = text.find("<script>") + len("<script>"), text.find(_END_OF_LIBRARY)
    if end < start:
        raise DataError(
            "the viewer of the installed trimesh has an unknown layout; install the trimesh version of constraints.txt"
        )
    return text[start:end]


def _eye(scene: Scene) -> list[list[float]]:
    """Return the eye and target point of the inside view (y up): the free position with the widest view."""
    from scipy import ndimage

    cell, origin = 0.1, scene.bounds[0, :2]
    cols, rows = np.maximum(np.ceil((scene.bounds[1, :2] - origin) / cell).astype(int), 1).tolist()

    def between(low: float, high: float) -> np.ndarray:
        return occupied_cells(scene.vertices, scene.faces, low, high, origin, cell, (rows, cols))

    floor = between(-0.05, 0.05)
    blocked = between(0.1, CAMERA_HEIGHT + 0.2)
    clear = ndimage.distance_transform_edt(np.pad(floor & ~blocked, 1))[1:-1, 1:-1]
    positions = np.argwhere(clear >= min(4, clear.max()))[:, ::-1]  # column, row; 40 cm from obstacles where possible
    positions = positions[:: -(-len(positions) // 200)]
    opaque = between(CAMERA_HEIGHT - 0.3, CAMERA_HEIGHT + 0.2)
    (col, row), ahead = _widest_view(positions, opaque | ~floor & ~blocked)
    x, y = origin + (np.array([col, row]) + 0.5) * cell
    return [[float(x), CAMERA_HEIGHT, float(-y)], [float(x + ahead[0]), CAMERA_HEIGHT, float(-y - ahead[1])]]


def _widest_view(positions: np.ndarray, opaque: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the position (column, row) out of (P, 2) and the unit direction with the widest view within 65 degrees."""
    angle = np.deg2rad(np.arange(0, 360, 5))
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    steps = np.arange(1, 61)  # cells: look up to 6 m far
    seen = np.rint(positions[:, None, None] + direction[:, None] * steps[:, None]).astype(int) + 1
    padded = np.pad(opaque, 1, constant_values=True)
    seen = np.clip(seen, 0, np.array(padded.shape)[::-1] - 1)
    hit = padded[seen[..., 1], seen[..., 0]]
    free = np.where(hit.any(axis=-1), hit.argmax(axis=-1), len(steps)).astype(float)
    view = np.sum([np.roll(free, k, axis=1) for k in range(-6, 7)], axis=0)
    best, heading = np.unravel_index(int(np.argmax(view)), view.shape)
    return positions[best], direction[heading]
