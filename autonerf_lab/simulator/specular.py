"""Highlights: the light of lamps and windows that glossy surfaces throw towards the camera.

The texture of a scene holds light that looks the same from everywhere. This is the part that does not: for each lamp of
the room a Blinn-Phong lobe ``(n . h)^k``, ``h`` halfway between the directions to the camera and to the lamp, times the
material's gloss and Schlick's Fresnel factor. Lamps of other rooms are left out, as walls hide them. It is added to the
colours as they are displayed.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from autonerf_lab.errors import SceneError
from autonerf_lab.scenes.scene import Scene

LAMP_SHARPNESS, WINDOW_SHARPNESS = 90.0, 25.0  # exponents of the lobes
LAMP_STRENGTH, WINDOW_STRENGTH = 0.32, 2.0
F0 = 0.35  # of the gloss, seen at a right angle


@dataclass(frozen=True)
class Gloss:
    """What the kernel needs: the highlights a face may show."""

    strength: np.ndarray  # (F,) float32
    room: np.ndarray  # (F,) int32, -1: none
    first: np.ndarray  # (R + 1,) int32, lamps of room r are first[r] to first[r + 1]
    lamps: np.ndarray  # (L, 7) float32: x, y, z, red, green, blue as displayed at strength 1, sharpness


NONE = Gloss(np.empty(0, np.float32), np.empty(0, np.int32), np.zeros(1, np.int32), np.empty((0, 7), np.float32))


def gloss_of(scene: Scene) -> Gloss:
    """The highlights of a generated scene.

    Raises:
        SceneError: the scene is a scan: nobody knows its materials and lamps.
    """
    if scene.gloss is None or scene.spec is None:
        raise SceneError(f"scene {scene.name!r} has no materials and lamps to shine: render it without gloss")
    from shapely import contains_xy
    from shapely.geometry import Polygon

    rooms = [Polygon(room["polygon"]).buffer(0.15) for room in scene.spec["rooms"]]  # windows stand in the wall
    middle = scene.vertices[scene.faces].mean(axis=1)
    room = np.full(len(scene.faces), -1, np.int32)
    rows: list[list[float]] = []
    first = [0]
    for k, shape in enumerate(rooms):
        room[contains_xy(shape, middle[:, 0], middle[:, 1])] = k
        for light in scene.spec["lights"]:
            if not contains_xy(shape.buffer(0.15), light["at"][0], light["at"][1]):
                continue
            lamp = light["kind"] == "lamp"
            strength = light["power"] * (LAMP_STRENGTH if lamp else WINDOW_STRENGTH)
            sharpness = LAMP_SHARPNESS if lamp else WINDOW_SHARPNESS
            rows.append([*light["at"], *(255 * strength * v for v in light["color"]), sharpness])
        first.append(len(rows))
    lamps = np.array(rows, dtype=np.float32).reshape(-1, 7)
    return Gloss(scene.gloss, room, np.array(first, dtype=np.int32), lamps)


@njit(cache=True, nogil=True)
def highlight(
    point: np.ndarray, normal: np.ndarray, eye: np.ndarray, strength: float, lamps: np.ndarray, out: np.ndarray
) -> None:
    """Add to ``out`` (3,) what the lamps of a room show at a point of a surface; the normal may look either way."""
    vx, vy, vz = eye[0] - point[0], eye[1] - point[1], eye[2] - point[2]
    away = np.sqrt(vx * vx + vy * vy + vz * vz)
    vx, vy, vz = vx / away, vy / away, vz / away
    facing = vx * normal[0] + vy * normal[1] + vz * normal[2]
    side = 1.0 if facing > 0 else -1.0
    fresnel = F0 + (1 - F0) * (1 - abs(facing)) ** 5
    for k in range(lamps.shape[0]):
        lx, ly, lz = lamps[k, 0] - point[0], lamps[k, 1] - point[1], lamps[k, 2] - point[2]
        far = np.sqrt(lx * lx + ly * ly + lz * lz) + 1e-6
        lx, ly, lz = lx / far, ly / far, lz / far
        if side * (lx * normal[0] + ly * normal[1] + lz * normal[2]) <= 0:
            continue
        hx, hy, hz = vx + lx, vy + ly, vz + lz
        size = np.sqrt(hx * hx + hy * hy + hz * hz)
        if size < 1e-6:
            continue
        cosine = side * (hx * normal[0] + hy * normal[1] + hz * normal[2]) / size
        if cosine <= 0:
            continue
        lobe = strength * fresnel * cosine ** lamps[k, 6]
        for c in range(3):
            out[c] += lobe * lamps[k, 3 + c]
