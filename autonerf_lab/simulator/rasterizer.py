"""Rasterisation and shading of a triangle mesh for a pinhole camera, with homogeneous coordinates.

All rays of a camera have the same origin. The ray with direction d (scaled to depth 1) meets the plane of a triangle
(v0, v1, v2), in camera coordinates, at the barycentric weights ``b = M^-1 d, M = [v0 v1 v2]``. It hits the triangle if
no weight is negative, at the inverse depth ``b0 + b1 + b2`` (Olano and Greer 1997). Weights and inverse depth are
linear in the pixel position, so each pixel of a row costs an addition and a comparison, and no clipping is needed. On
one core this is several times faster than casting the same rays through a bounding-volume hierarchy, with the same
result (tested in ``tests/simulator``).
"""

import numpy as np
from numba import njit

from autonerf_lab.simulator.specular import highlight

CHUNK = 32  # faces per frustum test
_SLACK = 1e-3  # pixels
_NEAR = 1e-4  # metres; only limits the screen rectangle of triangles that extend behind the camera


def chunk_bounds(triangles: np.ndarray) -> np.ndarray:
    """Return the bounding spheres of chunks of :data:`CHUNK` consecutive faces.

    Args:
        triangles: (F, 3, 3) corners, world frame, metres.

    Returns:
        (ceil(F / CHUNK), 4) float64: centre and radius, metres.

    Example:
        >>> chunk_bounds(np.array([[[0, 0, 0], [2, 0, 0], [0, 0, 0]]], np.float32))
        array([[1., 0., 0., 1.]])
    """
    bounds = np.empty((-(-len(triangles) // CHUNK), 4))
    for i in range(len(bounds)):
        corners = triangles[i * CHUNK : (i + 1) * CHUNK].reshape(-1, 3).astype(np.float64)
        bounds[i, :3] = (corners.min(axis=0) + corners.max(axis=0)) / 2
        bounds[i, 3] = np.sqrt(((corners - bounds[i, :3]) ** 2).sum(axis=1).max())
    return bounds


@njit(cache=True, nogil=True)
def _edges(v: np.ndarray, fl_x: float, fl_y: float, cx: float, cy: float, out: np.ndarray) -> float:
    """Write weight i times det to row i of ``out``: slopes per column and row, value at pixel [0, 0]. Return det."""
    det = 0.0
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        nx = v[j, 1] * v[k, 2] - v[j, 2] * v[k, 1]
        ny = v[j, 2] * v[k, 0] - v[j, 0] * v[k, 2]
        nz = v[j, 0] * v[k, 1] - v[j, 1] * v[k, 0]
        out[i, 0] = nx / fl_x
        out[i, 1] = -ny / fl_y
        out[i, 2] = nx * ((0.5 - cx) / fl_x) - ny * ((0.5 - cy) / fl_y) - nz
        if i == 0:
            det = v[0, 0] * nx + v[0, 1] * ny + v[0, 2] * nz
    return det


@njit(cache=True, nogil=True)
def _to_camera(triangles: np.ndarray, f: int, w2c: np.ndarray, out: np.ndarray) -> None:
    """Write the corners of face ``f`` in camera coordinates to ``out`` (3, 3)."""
    for i in range(3):
        for r in range(3):
            out[i, r] = (
                w2c[r, 0] * triangles[f, i, 0]
                + w2c[r, 1] * triangles[f, i, 1]
                + w2c[r, 2] * triangles[f, i, 2]
                + w2c[r, 3]
            )


@njit(cache=True, nogil=True)
def _corners(points: np.ndarray, faces: np.ndarray, f: int, out: np.ndarray) -> None:
    """Write the corners of face ``f`` to ``out`` (3, 3)."""
    for i in range(3):
        for r in range(3):
            out[i, r] = points[r, faces[f, i]]


@njit(cache=True, nogil=True)
def _project(vertices: np.ndarray, w2c: np.ndarray, camera: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the vertices in camera coordinates, (3, V), and their pixel positions, (2, V), if they are in front."""
    points = np.empty(vertices.shape)
    pixels = np.empty((2, vertices.shape[1]))
    for i in range(vertices.shape[1]):
        x, y, z = vertices[0, i], vertices[1, i], vertices[2, i]
        for r in range(3):
            points[r, i] = w2c[r, 0] * x + w2c[r, 1] * y + w2c[r, 2] * z + w2c[r, 3]
    for i in range(vertices.shape[1]):
        z = min(points[2, i], -_NEAR)
        pixels[0, i] = camera[2] - camera[0] * points[0, i] / z
        pixels[1, i] = camera[3] + camera[1] * points[1, i] / z
    return points, pixels


@njit(cache=True, nogil=True)
def _clipped_rectangle(
    points: np.ndarray, pixels: np.ndarray, corners: np.ndarray, camera: np.ndarray
) -> tuple[float, float, float, float]:
    """Return the screen rectangle of a triangle that extends behind the camera: left, right, top, bottom, pixels."""
    left, right, top, bottom = np.inf, -np.inf, np.inf, -np.inf
    for n in range(3):
        i, j = corners[n], corners[(n + 1) % 3]
        z, following = points[2, i], points[2, j]
        if z < -_NEAR:
            px, py = pixels[0, i], pixels[1, i]
            left, right, top, bottom = min(left, px), max(right, px), min(top, py), max(bottom, py)
        if (z < -_NEAR) != (following < -_NEAR):
            a = (-_NEAR - z) / (following - z)
            px = camera[2] + camera[0] * (points[0, i] + a * (points[0, j] - points[0, i])) / _NEAR
            py = camera[3] - camera[1] * (points[1, i] + a * (points[1, j] - points[1, i])) / _NEAR
            left, right, top, bottom = min(left, px), max(right, px), min(top, py), max(bottom, py)
    return left, right, top, bottom


@njit(cache=True, nogil=True)
def rasterize(
    vertices: np.ndarray,
    faces: np.ndarray,
    bounds: np.ndarray,
    w2c: np.ndarray,
    camera: np.ndarray,
    inverse_depth: np.ndarray,
    face: np.ndarray,
) -> None:
    """Find the nearest surface at each pixel centre.

    Args:
        vertices: (3, V) float32, world frame, metres.
        faces: (F, 3) int, indices of vertices.
        bounds: Result of :func:`chunk_bounds`.
        w2c: (4, 4) float64 world-to-camera, OpenGL axes.
        camera: (4,) float64: fl_x, fl_y, cx, cy in pixels.
        inverse_depth: (H, W) float32, written: 1 / depth along the optical axis, 1/m, 0 = no surface.
        face: (H, W) int32, written: index of the face, -1 = no surface.
    """
    height, width = face.shape
    fl_x, fl_y, cx, cy = camera[0], camera[1], camera[2], camera[3]
    inverse_depth[:] = 0.0
    face[:] = -1
    # Inward normals of the four sides of the view frustum, in the camera frame.
    sides = np.array([[fl_x, 0.0, -cx], [-fl_x, 0.0, -(width - cx)], [0.0, fl_y, -(height - cy)], [0.0, -fl_y, -cy]])
    for s in range(4):
        sides[s] /= np.sqrt((sides[s] ** 2).sum())
    points, pixels = _project(vertices, w2c, camera)
    v = np.empty((3, 3))
    e = np.empty((4, 3))
    for c in range(len(bounds)):
        x = w2c[0, 0] * bounds[c, 0] + w2c[0, 1] * bounds[c, 1] + w2c[0, 2] * bounds[c, 2] + w2c[0, 3]
        y = w2c[1, 0] * bounds[c, 0] + w2c[1, 1] * bounds[c, 1] + w2c[1, 2] * bounds[c, 2] + w2c[1, 3]
        z = w2c[2, 0] * bounds[c, 0] + w2c[2, 1] * bounds[c, 1] + w2c[2, 2] * bounds[c, 2] + w2c[2, 3]
        visible = z < bounds[c, 3]
        for s in range(4):
            visible = visible and sides[s, 0] * x + sides[s, 1] * y + sides[s, 2] * z > -bounds[c, 3]
        if not visible:
            continue
        for f in range(c * CHUNK, min((c + 1) * CHUNK, len(faces))):
            i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
            z0, z1, z2 = points[2, i], points[2, j], points[2, k]
            if min(z0, z1, z2) >= -_NEAR:
                continue
            if max(z0, z1, z2) < -_NEAR:
                x0, x1, x2 = pixels[0, i], pixels[0, j], pixels[0, k]
                y0, y1, y2 = pixels[1, i], pixels[1, j], pixels[1, k]
                left, right, top, bottom = min(x0, x1, x2), max(x0, x1, x2), min(y0, y1, y2), max(y0, y1, y2)
            else:
                left, right, top, bottom = _clipped_rectangle(points, pixels, faces[f], camera)
            if right < 0 or left > width or bottom < 0 or top > height:
                continue
            # Pixel centres in the screen rectangle, with slack: it only limits the work, the edges decide. Most
            # triangles of a scan contain no pixel centre and are skipped here.
            row0 = int(np.ceil(max(0.0, top - 0.5 - _SLACK)))
            row1 = int(np.floor(min(height - 1.0, bottom - 0.5 + _SLACK)))
            col0 = int(np.ceil(max(0.0, left - 0.5 - _SLACK)))
            col1 = int(np.floor(min(width - 1.0, right - 0.5 + _SLACK)))
            if row0 > row1 or col0 > col1:
                continue
            _corners(points, faces, f, v)
            det = _edges(v, fl_x, fl_y, cx, cy, e)
            if det == 0.0:
                continue
            sign = 1.0 if det > 0 else -1.0
            scale = 1.0 / abs(det)
            for i in range(3):
                e[3, i] = (e[0, i] + e[1, i] + e[2, i]) * sign * scale
            for row in range(row0, row1 + 1):
                lo, hi = float(col0), float(col1)
                for i in range(3):
                    slope = sign * e[i, 0]
                    value = sign * (e[i, 1] * row + e[i, 2])
                    if slope > 0:
                        lo = max(lo, np.ceil(-value / slope))
                    elif slope < 0:
                        hi = min(hi, np.floor(-value / slope))
                    elif value < 0:
                        hi = -1.0
                if hi < lo:
                    continue
                base = e[3, 1] * row + e[3, 2]
                step = e[3, 0]
                for col in range(int(lo), int(hi) + 1):
                    w = np.float32(base + step * col)
                    if w > inverse_depth[row, col]:
                        inverse_depth[row, col] = w
                        face[row, col] = f


@njit(cache=True, nogil=True)
def _normal(triangles: np.ndarray, f: int, out: np.ndarray) -> None:
    """Write the unit normal of face ``f`` to ``out`` (3,)."""
    a, b = triangles[f, 1] - triangles[f, 0], triangles[f, 2] - triangles[f, 0]
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]
    size = np.sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2])
    for j in range(3):
        out[j] /= max(size, 1e-12)


@njit(cache=True, nogil=True)
def shade(
    face: np.ndarray,
    triangles: np.ndarray,
    uv: np.ndarray,
    texture: np.ndarray,
    w2c: np.ndarray,
    camera: np.ndarray,
    gloss: np.ndarray,
    room: np.ndarray,
    first: np.ndarray,
    lamps: np.ndarray,
    rgb: np.ndarray,
) -> None:
    """Write the colour of each pixel: the mean of its k x k samples, each a bilinear texture look-up.

    The mean is over displayed (sRGB) values, not linear light, because a radiance field trained on such images averages
    the same values along its rays.

    Args:
        face: (k H, k W) int32, result of :func:`rasterize` at k times the resolution.
        triangles: (F, 3, 3) float32, world frame, metres.
        uv: (F, 3, 2) float32 in [0, 1], v down.
        texture: (Ht, Wt, 3) uint8 sRGB.
        w2c: (4, 4) float64 world-to-camera, OpenGL axes.
        camera: (4,) float64 fl_x, fl_y, cx, cy in pixels of the k times finer image.
        gloss: (F,) float32, see :class:`~autonerf_lab.simulator.specular.Gloss`; (0,) disables highlights.
        room: (F,) int32, see ``Gloss``.
        first: (R + 1,) int32, see ``Gloss``.
        lamps: (L, 7) float32, see ``Gloss``.
        rgb: (H, W, 3) uint8, written; black where there is no surface.
    """
    height, width = rgb.shape[0], rgb.shape[1]
    k = face.shape[0] // height
    rows, cols = texture.shape[0], texture.shape[1]
    v = np.empty((3, 3))
    e = np.empty((4, 3))
    plane = np.empty((3, 3))  # inverse depth, u and v over depth: each linear in the sample
    last = -1
    shiny, det = False, 0.0
    point, normal, glow = np.empty(3), np.empty(3), np.zeros(3)
    eye = np.empty(3)  # -R^T t
    for j in range(3):
        eye[j] = -(w2c[0, j] * w2c[0, 3] + w2c[1, j] * w2c[1, 3] + w2c[2, j] * w2c[2, 3])
    for row in range(height):
        for col in range(width):
            red = green = blue = 0.0
            for s in range(k * k):
                y, x = row * k + s // k, col * k + s % k
                f = face[y, x]
                if f < 0:
                    continue
                if f != last:
                    last = f
                    _to_camera(triangles, f, w2c, v)
                    det = _edges(v, camera[0], camera[1], camera[2], camera[3], e)
                    for j in range(3):
                        plane[0, j] = e[0, j] + e[1, j] + e[2, j]
                        plane[1, j] = (e[0, j] * uv[f, 0, 0] + e[1, j] * uv[f, 1, 0] + e[2, j] * uv[f, 2, 0]) * cols
                        plane[2, j] = (e[0, j] * uv[f, 0, 1] + e[1, j] * uv[f, 1, 1] + e[2, j] * uv[f, 2, 1]) * rows
                    shiny = gloss.shape[0] > 0 and gloss[f] > 0 and room[f] >= 0
                    if shiny:
                        _normal(triangles, f, normal)
                depth = 1.0 / (plane[0, 0] * x + plane[0, 1] * y + plane[0, 2])
                tx = (plane[1, 0] * x + plane[1, 1] * y + plane[1, 2]) * depth - 0.5
                ty = (plane[2, 0] * x + plane[2, 1] * y + plane[2, 2]) * depth - 0.5
                tx, ty = min(max(tx, 0.0), cols - 1.0), min(max(ty, 0.0), rows - 1.0)
                x0, y0 = int(tx), int(ty)
                x1, y1 = min(x0 + 1, cols - 1), min(y0 + 1, rows - 1)
                fx, fy = tx - x0, ty - y0
                w00, w01, w10, w11 = (1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy
                red += w00 * texture[y0, x0, 0] + w01 * texture[y0, x1, 0] + w10 * texture[y1, x0, 0]
                red += w11 * texture[y1, x1, 0]
                green += w00 * texture[y0, x0, 1] + w01 * texture[y0, x1, 1] + w10 * texture[y1, x0, 1]
                green += w11 * texture[y1, x1, 1]
                blue += w00 * texture[y0, x0, 2] + w01 * texture[y0, x1, 2] + w10 * texture[y1, x0, 2]
                blue += w11 * texture[y1, x1, 2]
                if shiny:
                    across, up = (x + 0.5 - camera[2]) / camera[0], -(y + 0.5 - camera[3]) / camera[1]
                    far = depth * det  # depth in metres: the planes are scaled by the determinant
                    for j in range(3):
                        point[j] = eye[j] + far * (w2c[0, j] * across + w2c[1, j] * up - w2c[2, j])
                    glow[:] = 0.0
                    highlight(point, normal, eye, gloss[f], lamps[first[room[f]] : first[room[f] + 1]], glow)
                    red, green, blue = red + glow[0], green + glow[1], blue + glow[2]
            if gloss.shape[0] > 0:
                limit = 255.0 * k * k
                red, green, blue = min(red, limit), min(green, limit), min(blue, limit)
            rgb[row, col, 0] = int(red / (k * k) + 0.5)
            rgb[row, col, 1] = int(green / (k * k) + 0.5)
            rgb[row, col, 2] = int(blue / (k * k) + 0.5)
