"""Texture baking: direct light with soft shadows and one bounce, multiplied by the albedo.

Irradiance is computed on a coarse grid of lumels (light samples) on every patch and interpolated; the albedo is
evaluated at every texel. All light is diffuse, so the texture does not depend on the view.
"""

import numpy as np
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh
from numba import njit, prange

from autonerf_lab.scenes.procedural_textures import albedo, material_table
from autonerf_lab.scenes.tessellation import MARGIN, SurfaceTessellation, triangulate

LUMEL = 0.12  # metres, largest side of a lumel
LIFT = 0.012  # metres between a surface and the origin of its rays
BOUNCE_RAYS = 20
LAMP_SAMPLES, WINDOW_SAMPLES = 2, 3
AMBIENT = 0.22  # share of the mean light added for further bounces
EXPOSURE = 0.74  # irradiance to which the median is scaled
TEXEL_TASKS = 64  # tasks of the parallel loop over the rows of the atlas


@njit(cache=True)
def _same(points: np.ndarray, i: int, j: int) -> bool:
    """Return True if two points are equal; without arrays, which numba would allocate for every texel."""
    return points[i, 0] == points[j, 0] and points[i, 1] == points[j, 1] and points[i, 2] == points[j, 2]


@njit(cache=True)
def _surface(
    points: np.ndarray, start: int, n: int, m: int, a: float, b: float, p: np.ndarray, normal: np.ndarray
) -> None:
    """Write the point and the unnormalised normal of a patch at (a, b)."""
    x, y = min(max(a, 0.0), 1.0) * n, min(max(b, 0.0), 1.0) * m
    i, j = min(int(x), n - 1), min(int(y), m - 1)
    u, v = x - i, y - j
    k00 = start + i * (m + 1) + j
    k01, k10 = k00 + 1, k00 + m + 1
    k11 = k10 + 1
    # linear on each of the two triangles, as in the mesh, so that texture coordinates agree
    a0, a1, b0, b1 = (k00, k10, k10, k11) if u >= v else (k01, k11, k00, k01)
    for c in range(3):
        p[c] = points[k00, c] + u * (points[a1, c] - points[a0, c]) + v * (points[b1, c] - points[b0, c])
    if _same(points, a0, a1) or _same(points, b0, b1):  # degenerate triangle at a pole: use the other one
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
    position: np.ndarray,
    normal: np.ndarray,
) -> None:
    """Write the ray origin and the unit normal of every lumel."""
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
                    position[k, c] = p[c] + normal[k, c] * LIFT


@njit(cache=True)
def _smooth(values: np.ndarray, size: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Filter the lumels of every patch with a 3 x 3 tent to reduce sampling noise."""
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
    material: np.ndarray, rect: np.ndarray, span: np.ndarray, parameters: np.ndarray, codes: np.ndarray,
    size: np.ndarray, first: np.ndarray, light: np.ndarray, row_patch: np.ndarray, row_in_patch: np.ndarray,
    margin: int, image: np.ndarray,
) -> None:  # fmt: skip
    """Write albedo times interpolated light to every texel of the atlas."""
    rows = len(row_patch)
    for task in prange(TEXEL_TASKS):
        p, d, color = np.empty(3), np.empty(3), np.empty(3)
        for index in range(task, rows, TEXEL_TASKS):
            k = row_patch[index]
            left, top, w, h = rect[k]
            y = row_in_patch[index] - margin
            b = min(max(1 - (y + 0.5) / h, 0.0), 1.0)
            mat = material[k]
            glow = parameters[mat, 7]
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
                    # horizontal end of a surface of revolution: pattern in world x, y instead of polar coordinates
                    s, t, ls, lt = p[0], p[1], span[k, 0], span[k, 1]
                albedo(
                    codes[mat, 0], parameters[mat, 0:3], parameters[mat, 3:6], parameters[mat, 6], codes[mat, 1],
                    parameters[mat, 8], s, t, a, b, ls, lt, p, color,
                )  # fmt: skip
                lx, ly = min(max(a * lw - 0.5, 0.0), lw - 1.0), min(max(b * lh - 0.5, 0.0), lh - 1.0)
                i, j = int(lx), int(ly)
                i1, j1 = min(i + 1, lw - 1), min(j + 1, lh - 1)
                u, v = lx - i, ly - j
                base = first[k]
                for c in range(3):
                    e = (light[base + j * lw + i, c] * (1 - u) + light[base + j * lw + i1, c] * u) * (1 - v)
                    e += (light[base + j1 * lw + i, c] * (1 - u) + light[base + j1 * lw + i1, c] * u) * v
                    value = color[c] * color[c] * (e * max(0.0, 1 - glow) + glow)
                    value *= 1.3 * (1 + value / 9) / (1 + value)  # tone mapping with a soft shoulder
                    image[top + y, left + x, c] = np.uint8(min(255.0, 255.0 * np.sqrt(value) + 0.5))


class _Rays:
    """Embree scene that takes rays and returns hits as plain arrays."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        self.scene = rtcore_scene.EmbreeScene()
        self.mesh = TriangleMesh(self.scene, vertices.astype(np.float32), faces.astype(np.int32))

    def blocked(self, origin: np.ndarray, target: np.ndarray) -> np.ndarray:
        """Return (N,) bool: True if a surface lies between origin and target."""
        ray = target - origin
        distance = np.linalg.norm(ray, axis=1)
        direction = ray / np.maximum(distance, 1e-9)[:, None]
        far = (distance - 0.02).astype(np.float32)
        hit = self.scene.run(origin.astype(np.float32), direction.astype(np.float32), dists=far, query="OCCLUDED")
        return hit != -1

    def hit(self, origin: np.ndarray, direction: np.ndarray) -> dict:
        """Return the first hits: ``primID`` (-1: none) and barycentric ``u``, ``v``."""
        return self.scene.run(origin.astype(np.float32), direction.astype(np.float32), output=True)


def bake(spec: dict, surface: SurfaceTessellation) -> np.ndarray:
    """Bake the texture atlas of a tessellated specification, (rows, columns, 3) uint8 sRGB."""
    parameters, codes = material_table(spec)
    size = np.clip(np.ceil(surface.length / LUMEL), 1, 400).astype(np.int64)
    count = size.prod(axis=1)
    first = np.concatenate([[0], np.cumsum(count)[:-1]])
    position, normal = np.empty((int(count.sum()), 3)), np.empty((int(count.sum()), 3))
    _lumels(surface.points, surface.start, surface.cells, size, first, position, normal)
    light = _light(spec, surface, parameters, size, first, count, position, normal)
    tall = surface.rect[:, 3] + 2 * MARGIN
    row_patch = np.repeat(np.arange(len(tall)), tall)
    row_in_patch = np.arange(len(row_patch)) - np.repeat(np.concatenate([[0], np.cumsum(tall)[:-1]]), tall)
    image = np.zeros((*surface.atlas, 3), dtype=np.uint8)
    _paint(
        surface.points, surface.start, surface.cells, surface.length, surface.shift, surface.material, surface.rect,
        _spans(surface), parameters, codes, size, first, light, row_patch, row_in_patch, MARGIN, image,
    )  # fmt: skip
    return image


def _spans(surface: SurfaceTessellation) -> np.ndarray:
    """Return the extent of each patch along world x and y, (P, 2) metres."""
    low = np.minimum.reduceat(surface.points[:, :2], surface.start)
    return np.maximum.reduceat(surface.points[:, :2], surface.start) - low


def _light(
    spec: dict, surface: SurfaceTessellation, parameters: np.ndarray, size: np.ndarray, first: np.ndarray,
    count: np.ndarray, position: np.ndarray, normal: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Return the irradiance of every lumel, (L, 3), scaled to a fixed median exposure."""
    vertices, faces, uv, face_patch = triangulate(surface)
    rays = _Rays(vertices, faces)
    rng = np.random.default_rng(0)
    patch_of = np.repeat(np.arange(len(count)), count)
    direct = np.zeros_like(position)
    for lamp in spec["lights"]:
        direct += _direct(lamp, position, normal, rays, rng)
    direct = _smooth(direct, size, first)
    mean = direct.mean(axis=0)
    tone = ((parameters[:, 0:3] + parameters[:, 3:6]) / 2) ** 2
    glow = parameters[:, 7]
    sent = tone[surface.material[patch_of]] * (direct + AMBIENT * mean)
    sent += (glow[surface.material[patch_of]] * 2.0 * mean.mean())[:, None] * tone[surface.material[patch_of]]
    bounced = _gather(sent, surface, size, first, face_patch, uv, position, normal, rays, rng)
    light = direct + _smooth(_smooth(bounced, size, first), size, first) + 0.5 * AMBIENT * mean
    level = np.median(light.mean(axis=1))
    return light * (EXPOSURE / max(float(level), 1e-9))


def _direct(lamp: dict, position: np.ndarray, normal: np.ndarray, rays: _Rays, rng: np.random.Generator) -> np.ndarray:
    """Return the direct irradiance from one lamp or window at every lumel, (L, 3)."""
    total = np.zeros_like(position)
    centre = np.asarray(lamp["at"], dtype=np.float64)
    away = centre - position
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
        ray = target - position[chosen]
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
        open_ray = ~rays.blocked(position[index], target[useful])
        total[index[open_ray]] += weight[useful][open_ray, None] * power / samples
    return total


def _gather(
    sent: np.ndarray, surface: SurfaceTessellation, size: np.ndarray, first: np.ndarray, face_patch: np.ndarray,
    uv: np.ndarray, position: np.ndarray, normal: np.ndarray, rays: _Rays, rng: np.random.Generator,
) -> np.ndarray:  # fmt: skip
    """Return the indirect irradiance of every lumel, (L, 3), from cosine-weighted rays to other lumels."""
    total = np.zeros_like(position)
    helper = np.where(np.abs(normal[:, 2:]) > 0.9, [[1.0, 0, 0]], [[0, 0, 1.0]])
    tangent = np.cross(helper, normal)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1), 1e-9)[:, None]
    other = np.cross(normal, tangent)
    corner = uv * np.array([surface.atlas[1], surface.atlas[0]], dtype=np.float32)
    origin = position.astype(np.float32)
    phase = rng.random(len(position))
    for k in range(BOUNCE_RAYS):
        radius = np.sqrt((k + 0.5) / BOUNCE_RAYS)
        angle = 2 * np.pi * (phase + k * 0.6180339887)
        x, y, z = radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - radius**2)
        direction = x[:, None] * tangent + y[:, None] * other + z * normal
        hit = rays.hit(origin, direction)
        face = hit["primID"]
        found = face >= 0
        face = face[found]
        u, v = hit["u"][found, None], hit["v"][found, None]
        texel = corner[face, 0] * (1 - u - v) + corner[face, 1] * u + corner[face, 2] * v
        patch = face_patch[face]
        left, top, w, h = surface.rect[patch].T
        lw, lh = size[patch].T
        i = np.clip((texel[:, 0] - left) / w * lw, 0, lw - 1).astype(np.int64)
        j = np.clip((1 - (texel[:, 1] - top) / h) * lh, 0, lh - 1).astype(np.int64)
        total[found] += sent[first[patch] + j * lw + i]
    return total / BOUNCE_RAYS
