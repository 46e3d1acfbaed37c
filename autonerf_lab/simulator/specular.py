"""View-dependent highlights of lamps and windows on glossy surfaces.

The texture of a scene contains the diffuse light, which does not depend on the view. The highlights are a Blinn-Phong
lobe ``(n . h)^k`` for each light source of the room, with ``h`` halfway between the directions to the camera and to the
light, times the material's gloss and Schlick's Fresnel factor. Lights of other rooms are ignored because walls occlude
them. Highlights are added to the displayed (sRGB) colours.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from autonerf_lab.errors import SceneError
from autonerf_lab.scenes.scene import Scene

LAMP_SHARPNESS, WINDOW_SHARPNESS = 90.0, 25.0  # exponents of the lobes
LAMP_STRENGTH, WINDOW_STRENGTH = 0.32, 2.0
F0 = 0.35  # Fresnel factor at normal incidence, as a share of the gloss


@dataclass(frozen=True)
class Gloss:
    """Gloss of F faces and L light sources of R rooms, as arrays for the kernel."""

    strength: np.ndarray  # (F,) float32 in [0, 1], specular share of each face
    room: np.ndarray  # (F,) int32, room of each face, -1 = none
    first: np.ndarray  # (R + 1,) int32, lights of room r are lamps[first[r] : first[r + 1]]
    lamps: np.ndarray  # (L, 7) float32: x, y, z in metres; red, green, blue at strength 1, 0 to 255; lobe exponent


NO_GLOSS = Gloss(np.empty(0, np.float32), np.empty(0, np.int32), np.zeros(1, np.int32), np.empty((0, 7), np.float32))


def scene_gloss(scene: Scene) -> Gloss:
    """Return the gloss and the light sources of a generated scene.

    Raises:
        SceneError: The scene has no materials and lights, such as an imported mesh.
    """
    if scene.gloss is None or scene.spec is None:
        raise SceneError(
            f"scene {scene.name!r} has no materials and lights (only generated scenes have them); pass gloss=False"
        )
    from shapely import contains_xy
    from shapely.geometry import Polygon

    rooms = [
        Polygon(room["polygon"]).buffer(0.15) for room in scene.spec["rooms"]
    ]  # include the wall: window lights are inside it
    floors = [room.get("z", 0.0) for room in scene.spec["rooms"]]
    ends = [-np.inf, *(z - 0.15 for z in sorted(set(floors))[1:]), np.inf]  # between the floors of the building
    levels = [ends[k : k + 2] for k in (sorted(set(floors)).index(z) for z in floors)]
    middle = scene.vertices[scene.faces].mean(axis=1)
    room = np.full(len(scene.faces), -1, np.int32)
    rows: list[list[float]] = []
    first = [0]
    for k, shape in enumerate(rooms):
        low, high = levels[k]
        room[contains_xy(shape, middle[:, 0], middle[:, 1]) & (middle[:, 2] >= low) & (middle[:, 2] < high)] = k
        for light in scene.spec["lights"]:
            x, y, z = light["at"]
            if not (contains_xy(shape.buffer(0.15), x, y) and low <= z < high):
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
    """Add the highlights at a surface point to ``out``.

    Args:
        point: (3,) surface point, world frame, metres.
        normal: (3,) unit normal of either sign.
        eye: (3,) camera centre, world frame, metres.
        strength: Gloss of the surface in [0, 1].
        lamps: (L, 7) light sources of the room, see :class:`Gloss`.
        out: (3,) red, green and blue, 0 to 255, changed in place.
    """
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
