"""Kernels of range images: planes around pixels, overlap, and the registration of pairs by normal equations.

A pair is registered by its point-to-plane distances and brightness differences.

Both kinds of residual change with a point p of one frame as g . dp, where g is the normal of the other frame's surface,
or the gradient of its brightness, in the world frame. A small motion of the first camera, a translation v and a
rotation omega about its centre t, moves the point by v + omega x (p - t), so that the Jacobian is (g, (p - t) x g). The
opposite motion of the second camera has the same effect, with its own centre. So one 6x6 matrix for each pair holds the
normal equations of both cameras; :class:`~.adjustment.Equations` distributes it.
"""

import numpy as np
from numba import njit, prange

_RADIUS = 2  # pixels; half of the window to which a plane is fitted
_ENOUGH = 12  # pixels of a window with a depth
ROW = 27  # 21 entries of the upper triangle of a 6x6 matrix, 6 of a vector


@njit(fastmath=True, error_model="numpy", inline="always")
def _add(row, g0, g1, g2, x, y, z, residual, weight):
    """Add one residual with direction g at the offset (x, y, z) from the first camera to the normal equations."""
    jacobian = (g0, g1, g2, y * g2 - z * g1, z * g0 - x * g2, x * g1 - y * g0)
    k = 0
    for a in range(6):
        scaled = weight * jacobian[a]
        for b in range(a, 6):
            row[k] += scaled * jacobian[b]
            k += 1
        row[21 + a] += scaled * residual


@njit(parallel=True, fastmath=True, cache=True, error_model="numpy")
def register(
    pairs, poses, cameras, surface, normals, brightness, stride, gate, noise, brightness_noise, out
):  # fmt: skip
    """Write the normal equations of pairs of range images.

    Args:
        pairs: (P, 2) int64, frames i and j: points of i on surfaces of j.
        poses: (T, 4, 4) float64 camera-to-world.
        cameras, surface, normals, brightness: see :class:`~.range_images.RangeImages`.
        stride: every so many pixels of i are used, in both directions.
        gate: largest distance along the optical axis between a point and the surface it is compared with, metres.
        noise: (2,) standard deviation of a distance: metres, and metres per squared metre of depth.
        brightness_noise: standard deviation of a brightness difference; 0: brightness is not compared.
        out: (P, ROW) float64, written: J^T W J, upper triangle row by row, and J^T W r.
    """
    height, width = surface.shape[1], surface.shape[2]
    scale = 0.5 * gate
    for n in prange(pairs.shape[0]):
        i, j = pairs[n, 0], pairs[n, 1]
        row = np.zeros(ROW)
        a, b = poses[i], poses[j]
        for r in range((i + j) % stride, height, stride):
            for c in range((i + 2 * j) % stride, width, stride):
                d = surface[i, r, c]
                if d <= 0:
                    continue
                px, py = d * (c + 0.5 - cameras[i, 2]) / cameras[i, 0], -d * (r + 0.5 - cameras[i, 3]) / cameras[i, 1]
                # Offset from camera i, world point relative to camera j, and the same in the frame of camera j.
                x = a[0, 0] * px + a[0, 1] * py - a[0, 2] * d
                y = a[1, 0] * px + a[1, 1] * py - a[1, 2] * d
                z = a[2, 0] * px + a[2, 1] * py - a[2, 2] * d
                wx, wy, wz = x + a[0, 3] - b[0, 3], y + a[1, 3] - b[1, 3], z + a[2, 3] - b[2, 3]
                qx = b[0, 0] * wx + b[1, 0] * wy + b[2, 0] * wz
                qy = b[0, 1] * wx + b[1, 1] * wy + b[2, 1] * wz
                qz = -(b[0, 2] * wx + b[1, 2] * wy + b[2, 2] * wz)  # depth
                if qz < 0.1:
                    continue
                u = cameras[j, 0] * qx / qz + cameras[j, 2] - 0.5
                v = -cameras[j, 1] * qy / qz + cameras[j, 3] - 0.5
                if u < 0 or v < 0 or u > width - 1.001 or v > height - 1.001:
                    continue
                cc, rr = int(u + 0.5), int(v + 0.5)
                s = surface[j, rr, cc]
                if s <= 0:
                    continue
                n0, n1, n2 = normals[j, rr, cc, 0], normals[j, rr, cc, 1], normals[j, rr, cc, 2]
                sx, sy = s * (cc + 0.5 - cameras[j, 2]) / cameras[j, 0], -s * (rr + 0.5 - cameras[j, 3]) / cameras[j, 1]
                residual = n0 * (qx - sx) + n1 * (qy - sy) + n2 * (s - qz)
                if abs(residual) > gate:
                    continue
                m0, m1, m2 = normals[i, r, c, 0], normals[i, r, c, 1], normals[i, r, c, 2]
                g0 = b[0, 0] * n0 + b[0, 1] * n1 + b[0, 2] * n2
                g1 = b[1, 0] * n0 + b[1, 1] * n1 + b[1, 2] * n2
                g2 = b[2, 0] * n0 + b[2, 1] * n1 + b[2, 2] * n2
                agree = g0 * (a[0, 0] * m0 + a[0, 1] * m1 + a[0, 2] * m2)
                agree += g1 * (a[1, 0] * m0 + a[1, 1] * m1 + a[1, 2] * m2)
                agree += g2 * (a[2, 0] * m0 + a[2, 1] * m1 + a[2, 2] * m2)
                if agree < 0.8:
                    continue
                variance = noise[0] ** 2 + noise[1] ** 2 * (d**4 + s**4)
                robust = 1 / (1 + (residual / scale) ** 2)
                weight = robust * robust / variance
                _add(row, g0, g1, g2, x, y, z, residual, weight)
                if brightness_noise <= 0:
                    continue
                c0, r0 = int(u), int(v)
                fu, fv = u - c0, v - r0
                b00, b01 = brightness[j, r0, c0], brightness[j, r0, c0 + 1]
                b10, b11 = brightness[j, r0 + 1, c0], brightness[j, r0 + 1, c0 + 1]
                value = (1 - fv) * ((1 - fu) * b00 + fu * b01) + fv * ((1 - fu) * b10 + fu * b11)
                du = cameras[j, 0] / qz * ((1 - fv) * (b01 - b00) + fv * (b11 - b10))
                dv = -cameras[j, 1] / qz * ((1 - fu) * (b10 - b00) + fu * (b11 - b01))
                along = (du * qx + dv * qy) / qz  # the gradient with respect to the camera's z, which is minus depth
                difference = value - brightness[i, r, c]
                h0 = b[0, 0] * du + b[0, 1] * dv + b[0, 2] * along
                h1 = b[1, 0] * du + b[1, 1] * dv + b[1, 2] * along
                h2 = b[2, 0] * du + b[2, 1] * dv + b[2, 2] * along
                robust = 1 / (1 + (difference / (3 * brightness_noise)) ** 2)
                weight = robust * robust / brightness_noise**2
                _add(row, h0, h1, h2, x, y, z, difference, weight)
        out[n] = row


@njit(parallel=True, fastmath=True, cache=True, error_model="numpy")
def overlap(poses, cameras, surface, normals, points, tolerance, shared):
    """Count the sampled points of each frame that lie on surfaces of each other frame.

    Args:
        poses, cameras, surface, normals: as in :func:`register`.
        points: (K, 2) int64, rows and columns of the sampled pixels.
        tolerance: largest difference of depth, metres.
        shared: (T, T) int16, written: row i counts the points of frame i.
    """
    frames, height, width = surface.shape
    for i in prange(frames):
        a = poses[i]
        world = np.empty((len(points), 6))
        count = 0
        for k in range(len(points)):
            r, c = points[k, 0], points[k, 1]
            d = surface[i, r, c]
            if d > 0:
                px, py = d * (c + 0.5 - cameras[i, 2]) / cameras[i, 0], -d * (r + 0.5 - cameras[i, 3]) / cameras[i, 1]
                for axis in range(3):
                    world[count, axis] = a[axis, 0] * px + a[axis, 1] * py - a[axis, 2] * d + a[axis, 3]
                    world[count, 3 + axis] = (
                        a[axis, 0] * normals[i, r, c, 0]
                        + a[axis, 1] * normals[i, r, c, 1]
                        + a[axis, 2] * normals[i, r, c, 2]
                    )
                count += 1
        for j in range(frames):
            b, found = poses[j], 0
            for k in range(count):
                wx, wy, wz = world[k, 0] - b[0, 3], world[k, 1] - b[1, 3], world[k, 2] - b[2, 3]
                qz = -(b[0, 2] * wx + b[1, 2] * wy + b[2, 2] * wz)
                if qz < 0.1:
                    continue
                u = cameras[j, 0] * (b[0, 0] * wx + b[1, 0] * wy + b[2, 0] * wz) / qz + cameras[j, 2]
                v = -cameras[j, 1] * (b[0, 1] * wx + b[1, 1] * wy + b[2, 1] * wz) / qz + cameras[j, 3]
                if u < 0 or v < 0 or u >= width or v >= height:
                    continue
                s = surface[j, int(v), int(u)]
                if s > 0 and abs(s - qz) < tolerance:
                    agree = 0.0
                    for axis in range(3):
                        n = normals[j, int(v), int(u)]
                        agree += world[k, 3 + axis] * (b[axis, 0] * n[0] + b[axis, 1] * n[1] + b[axis, 2] * n[2])
                    if agree > 0.8:
                        found += 1
            shared[i, j] = found


@njit(parallel=True, fastmath=True, cache=True, error_model="numpy")
def fit_planes(depth, cameras, surface, normals):
    """Fit a plane around every pixel; see :class:`RangeImages` for the arguments, the last two are written."""
    frames, height, width = depth.shape
    for t in prange(frames):
        fx, fy = cameras[t, 0], cameras[t, 1]
        for r in range(height):
            for c in range(width):
                if depth[t, r, c] <= 0:
                    continue
                # Moments of the window: the origin is the pixel itself, x to the right, y up.
                n, sx, sy, sxx, sxy, syy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
                sw, swx, swy, sww = 0.0, 0.0, 0.0, 0.0
                for i in range(max(r - _RADIUS, 0), min(r + _RADIUS + 1, height)):
                    for j in range(max(c - _RADIUS, 0), min(c + _RADIUS + 1, width)):
                        if depth[t, i, j] > 0:
                            x, y, w = (j - c) / fx, (r - i) / fy, 1.0 / depth[t, i, j]
                            n, sx, sy, sxx, sxy, syy = n + 1, sx + x, sy + y, sxx + x * x, sxy + x * y, syy + y * y
                            sw, swx, swy, sww = sw + w, swx + w * x, swy + w * y, sww + w * w
                if n < _ENOUGH:
                    continue
                mx, my, mw = sx / n, sy / n, sw / n
                xx, xy, yy = sxx / n - mx * mx, sxy / n - mx * my, syy / n - my * my
                wx, wy, ww = swx / n - mw * mx, swy / n - mw * my, sww / n - mw * mw
                determinant = xx * yy - xy * xy
                if determinant < 1e-3 * xx * yy:
                    continue
                b, g = (wx * yy - wy * xy) / determinant, (wy * xx - wx * xy) / determinant
                a = mw - b * mx - g * my
                limit = 0.003 + 0.01 * mw
                if a <= 0 or ww - b * wx - g * wy > limit * limit:
                    continue
                # a + b x + g y = 1 / depth around the pixel: the plane (b, g, -(a at the image centre)) . P = 1.
                u, v = (c + 0.5 - cameras[t, 2]) / fx, (cameras[t, 3] - r - 0.5) / fy
                z = a - b * u - g * v
                size = np.sqrt(b * b + g * g + z * z)
                surface[t, r, c] = 1.0 / a
                normals[t, r, c, 0], normals[t, r, c, 1], normals[t, r, c, 2] = -b / size, -g / size, z / size
