"""Light and colour into one picture: direct light with soft shadows, one bounce, then albedo times light.

Light lives on a coarse grid of lumels on every patch and is interpolated; colour is evaluated at every texel. All light
is diffuse, so that the picture is right from every side.
"""

import numpy as np
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh
from numba import njit, prange

from autonerf_lab.scenes.procedural_textures import albedo, material_table
from autonerf_lab.scenes.tessellation import MARGIN, Patches, triangulate

LUMEL = 0.12  # metres
LIFT = 0.012  # metres that a ray starts above its surface
BOUNCE_RAYS = 20
LAMP_SAMPLES, WINDOW_SAMPLES = 2, 3
AMBIENT = 0.22  # share of the mean light that has bounced more than once
EXPOSURE = 0.74  # of the median light
TEXEL_TASKS = 64


@njit(cache=True)
def _surface(
    points: np.ndarray, start: int, n: int, m: int, a: float, b: float, p: np.ndarray, normal: np.ndarray
) -> None:
    """Point and (unnormalised) normal of a patch at (a, b)."""
    x, y = min(max(a, 0.0), 1.0) * n, min(max(b, 0.0), 1.0) * m
    i, j = min(int(x), n - 1), min(int(y), m - 1)
    u, v = x - i, y - j
    k00 = start + i * (m + 1) + j
    k01, k10 = k00 + 1, k00 + m + 1
    k11 = k10 + 1
    # linear on each of the two triangles, as the mesh is: texture coordinates then mean the same point in both
    a0, a1, b0, b1 = (k00, k10, k10, k11) if u >= v else (k01, k11, k00, k01)
    for c in range(3):
        p[c] = points[k00, c] + u * (points[a1, c] - points[a0, c]) + v * (points[b1, c] - points[b0, c])
    if (points[a0] == points[a1]).all() or (points[b0] == points[b1]).all():  # the triangle that a pole squeezes
        a0, a1, b0, b1 = (k01, k11, k00, k01) if u >= v else (k00, k10, k10, k11)
    ax, ay, az = points[a1, 0] - points[a0, 0], points[a1, 1] - points[a0, 1], points[a1, 2] - points[a0, 2]
    bx, by, bz = points[b1, 0] - points[b0, 0], points[b1, 1] - points[b0, 1], points[b1, 2] - points[b0, 2]
    normal[0], normal[1], normal[2] = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@njit(cache=True)
def _lumels(
    points: np.ndarray,
    start: np.ndarray,
    cells: np.ndarray,
    size: np.ndarray,
    first: np.ndarray,
    place: np.ndarray,
    normal: np.ndarray,
) -> None:
    p, d = np.empty(3), np.empty(3)
    for patch in range(len(start)):
        w, h = size[patch]
        for y in range(h):
            for x in range(w):
                _surface(points, start[patch], cells[patch, 0], cells[patch, 1], (x + 0.5) / w, (y + 0.5) / h, p, d)
                norm = np.sqrt(d[0] ** 2 + d[1] ** 2 + d[2] ** 2) + 1e-12
                k = first[patch] + y * w + x
                for c in range(3):
                    normal[k, c] = d[c] / norm
                    place[k, c] = p[c] + normal[k, c] * LIFT


@njit(cache=True)
def _smooth(values: np.ndarray, size: np.ndarray, first: np.ndarray) -> np.ndarray:
    """A 3 x 3 tent on the lumels of every patch: it takes the grain out of few rays."""
    out = np.empty_like(values)
    for patch in range(len(first)):
        w, h = size[patch]
        for y in range(h):
            for x in range(w):
                for c in range(values.shape[1]):
                    total, weight = 0.0, 0.0
                    for dy in range(-1, 2):
                        for dx in range(-1, 2):
                            if 0 <= x + dx < w and 0 <= y + dy < h:
                                g = (2 - abs(dx)) * (2 - abs(dy))
                                total += g * values[first[patch] + (y + dy) * w + x + dx, c]
                                weight += g
                    out[first[patch] + y * w + x, c] = total / weight
    return out


@njit(cache=True, parallel=True)
def _paint(
    points: np.ndarray, start: np.ndarray, cells: np.ndarray, length: np.ndarray, shift: np.ndarray,
    material: np.ndarray, rect: np.ndarray, span: np.ndarray, numbers: np.ndarray, codes: np.ndarray,
    size: np.ndarray, first: np.ndarray, light: np.ndarray, row_patch: np.ndarray, row_number: np.ndarray,
    margin: int, image: np.ndarray,
) -> None:  # fmt: skip
    rows = len(row_patch)
    for task in prange(TEXEL_TASKS):
        p, d, colour = np.empty(3), np.empty(3), np.empty(3)
        for index in range(task, rows, TEXEL_TASKS):
            k = row_patch[index]
            left, top, w, h = rect[k]
            y = row_number[index] - margin
            b = min(max(1 - (y + 0.5) / h, 0.0), 1.0)
            mat = material[k]
            glow = numbers[mat, 7]
            lw, lh = size[k]
            for x in range(-margin, w + margin):
                a = min(max((x + 0.5) / w, 0.0), 1.0)
                _surface(points, start[k], cells[k, 0], cells[k, 1], a, b, p, d)
                s, t, ls, lt = (
                    shift[k, 0] + a * length[k, 0],
                    shift[k, 1] + b * length[k, 1],
                    length[k, 0],
                    length[k, 1],
                )
                if (
                    cells[k, 0] > 2
                    and cells[k, 1] > 1
                    and abs(d[2]) > 0.75 * np.sqrt(d[0] ** 2 + d[1] ** 2 + d[2] ** 2)
                ):
                    # the top of a turned solid is a fan: the pattern lies flat on it instead of running round
                    s, t, ls, lt = p[0], p[1], span[k, 0], span[k, 1]
                albedo(
                    codes[mat, 0], numbers[mat, 0:3], numbers[mat, 3:6], numbers[mat, 6], codes[mat, 1],
                    numbers[mat, 8], s, t, a, b, ls, lt, p, colour,
                )  # fmt: skip
                lx, ly = min(max(a * lw - 0.5, 0.0), lw - 1.0), min(max(b * lh - 0.5, 0.0), lh - 1.0)
                i, j = int(lx), int(ly)
                i1, j1 = min(i + 1, lw - 1), min(j + 1, lh - 1)
                u, v = lx - i, ly - j
                base = first[k]
                for c in range(3):
                    e = (light[base + j * lw + i, c] * (1 - u) + light[base + j * lw + i1, c] * u) * (1 - v)
                    e += (light[base + j1 * lw + i, c] * (1 - u) + light[base + j1 * lw + i1, c] * u) * v
                    value = colour[c] * colour[c] * (e * max(0.0, 1 - glow) + glow)
                    value *= 1.3 * (1 + value / 9) / (1 + value)  # a soft shoulder, as film has
                    image[top + y, left + x, c] = np.uint8(min(255.0, 255.0 * np.sqrt(value) + 0.5))


class _Rays:
    """Embree, with rays given and hits returned as plain arrays."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        self.scene = rtcore_scene.EmbreeScene()
        self.mesh = TriangleMesh(self.scene, vertices.astype(np.float32), faces.astype(np.int32))

    def blocked(self, origin: np.ndarray, target: np.ndarray) -> np.ndarray:
        """(N,) bool: something stands between origin and target."""
        ray = target - origin
        distance = np.linalg.norm(ray, axis=1)
        direction = ray / np.maximum(distance, 1e-9)[:, None]
        far = (distance - 0.02).astype(np.float32)
        hit = self.scene.run(origin.astype(np.float32), direction.astype(np.float32), dists=far, query="OCCLUDED")
        return hit != -1

    def hit(self, origin: np.ndarray, direction: np.ndarray) -> dict:
        return self.scene.run(origin.astype(np.float32), direction.astype(np.float32), output=True)


def bake(spec: dict, patches: Patches) -> np.ndarray:
    """The atlas of a specification: (rows, columns, 3) uint8."""
    numbers, codes = material_table(spec)
    size = np.clip(np.ceil(patches.length / LUMEL), 1, 400).astype(np.int64)
    count = size.prod(axis=1)
    first = np.concatenate([[0], np.cumsum(count)[:-1]])
    place, normal = np.empty((int(count.sum()), 3)), np.empty((int(count.sum()), 3))
    _lumels(patches.points, patches.start, patches.cells, size, first, place, normal)
    light = _light(spec, patches, numbers, size, first, count, place, normal)
    tall = patches.rect[:, 3] + 2 * MARGIN
    row_patch = np.repeat(np.arange(len(tall)), tall)
    row_number = np.arange(len(row_patch)) - np.repeat(np.concatenate([[0], np.cumsum(tall)[:-1]]), tall)
    image = np.zeros((*patches.atlas, 3), dtype=np.uint8)
    _paint(
        patches.points, patches.start, patches.cells, patches.length, patches.shift, patches.material, patches.rect,
        _spans(patches), numbers, codes, size, first, light, row_patch, row_number, MARGIN, image,
    )  # fmt: skip
    return image


def _spans(patches: Patches) -> np.ndarray:
    """(P, 2): extent of each patch along world x and y."""
    low = np.minimum.reduceat(patches.points[:, :2], patches.start)
    return np.maximum.reduceat(patches.points[:, :2], patches.start) - low


def _light(
    spec: dict, patches: Patches, numbers: np.ndarray, size: np.ndarray, first: np.ndarray, count: np.ndarray,
    place: np.ndarray, normal: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Irradiance of every lumel, scaled so that the median shows as a well lit wall. (L, 3)."""
    vertices, faces, uv, face_patch = triangulate(patches)
    rays = _Rays(vertices, faces)
    rng = np.random.default_rng(0)
    patch_of = np.repeat(np.arange(len(count)), count)
    direct = np.zeros_like(place)
    for lamp in spec["lights"]:
        direct += _direct(lamp, place, normal, rays, rng)
    direct = _smooth(direct, size, first)
    mean = direct.mean(axis=0)
    tone = ((numbers[:, 0:3] + numbers[:, 3:6]) / 2) ** 2
    glow = numbers[:, 7]
    sent = tone[patches.material[patch_of]] * (direct + AMBIENT * mean)
    sent += (glow[patches.material[patch_of]] * 2.0 * mean.mean())[:, None] * tone[patches.material[patch_of]]
    bounced = _gather(sent, patches, size, first, face_patch, uv, place, normal, rays, rng)
    light = direct + _smooth(_smooth(bounced, size, first), size, first) + 0.5 * AMBIENT * mean
    level = np.median(light.mean(axis=1))
    return light * (EXPOSURE / max(float(level), 1e-9))


def _direct(lamp: dict, place: np.ndarray, normal: np.ndarray, rays: _Rays, rng: np.random.Generator) -> np.ndarray:
    total = np.zeros_like(place)
    centre = np.asarray(lamp["at"], dtype=np.float64)
    away = centre - place
    near = (away**2).sum(axis=1)
    chosen = np.flatnonzero((near < 9.0**2) & ((away * normal).sum(axis=1) > -0.9))
    is_window = lamp["kind"] == "window"
    if is_window:
        along = np.array([*lamp["along"], 0.0])
        inward = np.array([-along[1], along[0], 0.0])
        chosen = chosen[(away[chosen] @ inward) < -0.02]
    samples = WINDOW_SAMPLES if is_window else LAMP_SAMPLES
    power = lamp["power"] * np.asarray(lamp["color"], dtype=np.float64)
    for _ in range(samples):
        if is_window:
            jitter = rng.random((len(chosen), 2)) - 0.5
            target = centre + jitter[:, :1] * lamp["size"][0] * along
            target = target + jitter[:, 1:] * lamp["size"][1] * np.array([0, 0, 1.0])
        else:
            spread = rng.normal(size=(len(chosen), 3)) * lamp.get("radius", 0.1) * 0.6
            spread[:, 2] *= 0.1
            target = centre + spread
        ray = target - place[chosen]
        d2 = (ray**2).sum(axis=1)
        d = np.sqrt(d2)
        cosine = (ray * normal[chosen]).sum(axis=1) / d
        if is_window:
            weight = cosine * np.clip(-(ray @ inward) / d, 0, 1) * lamp["size"][0] * lamp["size"][1] / (d2 + 0.05) * 1.5
        else:
            weight = cosine / (d2 + 0.25) * 0.5
        useful = weight > 2e-3
        index = chosen[useful]
        if len(index) == 0:
            continue
        open_ray = ~rays.blocked(place[index], target[useful])
        total[index[open_ray]] += weight[useful][open_ray, None] * power / samples
    return total


def _gather(
    sent: np.ndarray, patches: Patches, size: np.ndarray, first: np.ndarray, face_patch: np.ndarray, uv: np.ndarray,
    place: np.ndarray, normal: np.ndarray, rays: _Rays, rng: np.random.Generator,
) -> np.ndarray:  # fmt: skip
    """Light sent by what each lumel sees: cosine-weighted rays, read from the lumel they hit."""
    total = np.zeros_like(place)
    helper = np.where(np.abs(normal[:, 2:]) > 0.9, [[1.0, 0, 0]], [[0, 0, 1.0]])
    tangent = np.cross(helper, normal)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1), 1e-9)[:, None]
    other = np.cross(normal, tangent)
    corner = uv * np.array([patches.atlas[1], patches.atlas[0]], dtype=np.float32)
    origin = place.astype(np.float32)
    turn = rng.random(len(place))
    for k in range(BOUNCE_RAYS):
        radius = np.sqrt((k + 0.5) / BOUNCE_RAYS)
        angle = 2 * np.pi * (turn + k * 0.6180339887)
        x, y, z = radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - radius**2)
        direction = x[:, None] * tangent + y[:, None] * other + z * normal
        hit = rays.hit(origin, direction)
        face = hit["primID"]
        found = face >= 0
        face = face[found]
        u, v = hit["u"][found, None], hit["v"][found, None]
        texel = corner[face, 0] * (1 - u - v) + corner[face, 1] * u + corner[face, 2] * v
        patch = face_patch[face]
        left, top, w, h = patches.rect[patch].T
        lw, lh = size[patch].T
        i = np.clip((texel[:, 0] - left) / w * lw, 0, lw - 1).astype(np.int64)
        j = np.clip((1 - (texel[:, 1] - top) / h) * lh, 0, lh - 1).astype(np.int64)
        total[found] += sent[first[patch] + j * lw + i]
    return total / BOUNCE_RAYS
