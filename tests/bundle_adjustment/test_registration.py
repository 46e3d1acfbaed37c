"""Range images and the normal equations of their pairs: analytic planes, and derivatives by finite differences."""

from itertools import product

import numpy as np
import pytest
from numpy.testing import assert_allclose

from autonerf_lab.bundle_adjustment.adjustment import SPATIAL, moved
from autonerf_lab.bundle_adjustment.kernels import ROW, overlap, register
from autonerf_lab.bundle_adjustment.range_images import RangeImages, range_images
from autonerf_lab.data.dataset import Dataset
from autonerf_lab.geometry import Intrinsics, camera_rays

NOISE = np.array([0.005, 0.001])
GATE, BRIGHTNESS_NOISE = 0.3, 0.02
CAMERA = Intrinsics.from_fov(64, 48)  # range images of 32x24 pixels
# A corner of three planes n . x = d; and a slanted one.
PLANES = (((1.0, 0.0, 0.0), 2.0), ((0.0, 1.0, 0.0), 1.5), ((0.0, 0.0, 1.0), -0.9), ((0.6, 0.0, 0.8), 1.9))


def looking(x, y, z, yaw, pitch):
    """Return a camera that looks along +x, turned by yaw (left) and pitch (up), radians."""
    pose = np.array([[0, 0, -1, x], [-1, 0, 0, y], [0, 1, 0, z], [0, 0, 0, 1.0]])
    return moved(pose[None], np.array([[0, 0, 0, 0, -pitch, yaw]]), SPATIAL)[0]


def view(pose, camera=CAMERA, planes=PLANES):
    """Return colours and depth of the nearest planes, and the normals of these, towards the camera."""
    rays_o, rays_d = camera_rays(camera, pose)
    depths = []
    for normal, distance in planes:
        along = rays_d @ normal
        depth = np.where(np.abs(along) > 1e-6, (distance - rays_o @ normal) / np.where(along == 0, 1, along), np.inf)
        depths.append(np.where(depth > 0.05, depth, np.inf))
    nearest = np.argmin(depths, axis=0)
    depth = np.min(depths, axis=0)
    points = rays_o + depth[..., None] * rays_d
    color = 127 + 90 * np.sin(points @ np.array([[2.0, 1.0, 0.5], [1.0, 2.0, 1.0], [1.5, -1.0, 2.0]]))
    normals = np.array([n for n, _ in planes])[nearest]
    return color.round().astype(np.uint8), depth.astype(np.float32), normals, points


POSES = np.stack([looking(0, 0, 0, 0, 0), looking(0.2, -0.1, 0.1, 0.25, 0.1), looking(-0.2, 0.3, 0, -0.2, -0.05)])


def dataset(poses=POSES, camera=CAMERA, depths=None):
    views = [view(pose, camera) for pose in poses]
    names = [f"view {t}" for t in range(len(poses))]
    depths = depths or [found[1] for found in views]
    return Dataset(poses, [found[0] for found in views], [camera] * len(poses), None, depths, names, {}, True)


@pytest.fixture(scope="module")
def images() -> RangeImages:
    return range_images(dataset())


def test_planes_are_fitted_exactly_and_edges_are_left_out(images: RangeImages) -> None:
    for t, pose in enumerate(POSES):
        depth, normals = (layer[::2, ::2] for layer in view(pose)[1:3])
        flat = images.surface[t] > 0
        assert 0.4 < flat.mean() < 1
        inner = np.zeros_like(flat)  # the whole window lies on one plane
        for r, c in product(range(2, 22), range(2, 30)):
            inner[r, c] = np.ptp(normals[r - 2 : r + 3, c - 2 : c + 3].reshape(25, 3), axis=0).max() == 0
        assert (flat & inner).mean() > 0.3
        assert_allclose(images.surface[t][flat & inner], depth[flat & inner], rtol=1e-4)
        facing = images.normals[t][flat & inner] @ pose[:3, :3].T
        assert_allclose(np.abs((facing * normals[flat & inner]).sum(axis=1)), 1, atol=1e-4)
        towards = (images.normals[t] * CAMERA.directions()[::2, ::2]).sum(axis=-1)
        assert (towards[flat] < 0).all()


def test_pixels_of_a_large_image_with_a_lens_lie_where_they_say() -> None:
    """Every fourth pixel of an image of 160x120 with distortion, half a pixel of which would be 9 mm at 2 m."""
    camera = Intrinsics(160, 120, 110.0, 112.0, 81.0, 59.0, k1=-0.1, p1=0.002)
    found = range_images(dataset(POSES[:1], camera))
    fx, fy, cx, cy = found.camera[0]
    assert found.surface.shape == (1, 60, 80) and (fx, cx) == (55.0, 40.75)
    rows, columns = np.nonzero(found.surface[0])
    depth = found.surface[0][rows, columns]
    local = np.stack([depth * (columns + 0.5 - cx) / fx, -depth * (rows + 0.5 - cy) / fy, -depth], axis=1)
    world = local @ POSES[0, :3, :3].T + POSES[0, :3, 3]
    distances = np.min([np.abs(world @ np.array(n) - d) for n, d in PLANES], axis=0)
    assert np.median(distances) < 2e-3 and np.percentile(distances, 95) < 0.02


def test_pixels_without_depth_or_masked_are_left_out() -> None:
    data = dataset(POSES[:1])
    assert data.depths is not None
    depth = data.depths[0].copy()
    depth[:24], depth[24:, :32] = 0, np.nan
    mask = np.ones_like(depth, bool)
    mask[:, 48:] = False
    found = range_images(Dataset(*(*list(vars(data).values())[:4], [depth], data.names, {}, True, [mask])))
    assert set(np.unique(np.nonzero(found.surface[0])[0])) <= set(range(12, 24))
    assert set(np.unique(np.nonzero(found.surface[0])[1])) <= set(range(16, 24))


def residuals(images, poses, i, j, matched):
    """Distances and brightness differences of the matched pixels (r, c, rr, cc) of a pair, point by point."""
    a, b = poses[i], poses[j]
    found = []
    for r, c, rr, cc in matched:
        fx, fy, cx, cy = images.camera[i]
        d = images.surface[i, r, c]
        local = np.array([d * (c + 0.5 - cx) / fx, -d * (r + 0.5 - cy) / fy, -d])
        x, y, z = b[:3, :3].T @ (a[:3, :3] @ local + a[:3, 3] - b[:3, 3])
        s = images.surface[j, rr, cc]
        surface = np.array([s * (cc + 0.5 - cx) / fx, -s * (rr + 0.5 - cy) / fy, -s])
        distance = images.normals[j, rr, cc] @ (np.array([x, y, z]) - surface)
        u, v = fx * x / -z + cx - 0.5, -fy * y / -z + cy - 0.5
        c0, r0 = int(u), int(v)
        four = images.brightness[j, r0 : r0 + 2, c0 : c0 + 2].astype(np.float64)
        value = np.array([1 - (v - r0), v - r0]) @ four @ np.array([1 - (u - c0), u - c0])
        found.append((distance, value - images.brightness[i, r, c], d, s, u, v))
    return np.array(found)


def match(images, poses, i, j):
    """Pixels of i and the pixels of j on which they fall, as the kernel selects them with a stride of 1."""
    every = [(r, c) for r, c in product(range(24), range(32)) if images.surface[i, r, c] > 0]
    matched = []
    for r, c in every:
        u, v = residuals(images, poses, i, j, [(r, c, 0, 0)])[0, 4:] if in_view(images, poses, i, j, r, c) else (-1, -1)
        if u < 0:
            continue
        rr, cc = int(v + 0.5), int(u + 0.5)
        if images.surface[j, rr, cc] <= 0:
            continue
        distance = residuals(images, poses, i, j, [(r, c, rr, cc)])[0, 0]
        turned = poses[i, :3, :3] @ images.normals[i, r, c], poses[j, :3, :3] @ images.normals[j, rr, cc]
        if abs(distance) <= GATE and turned[0] @ turned[1] >= 0.8:
            matched.append((r, c, rr, cc))
    return matched


def in_view(images, poses, i, j, r, c):
    fx, fy, cx, cy = images.camera[i]
    d = images.surface[i, r, c]
    local = np.array([d * (c + 0.5 - cx) / fx, -d * (r + 0.5 - cy) / fy, -d])
    x, y, z = poses[j, :3, :3].T @ (poses[i, :3, :3] @ local + poses[i, :3, 3] - poses[j, :3, 3])
    u, v = fx * x / -z + cx - 0.5, -fy * y / -z + cy - 0.5
    return -z >= 0.1 and 0 <= u <= 30.999 and 0 <= v <= 22.999


def test_normal_equations_equal_those_of_finite_differences(images: RangeImages) -> None:
    rough = moved(POSES, np.random.default_rng(0).normal(0, 0.01, (3, 6)), SPATIAL)
    i, j = 0, 1
    out = np.empty((1, ROW))
    arrays = images.camera, images.surface, images.normals, images.brightness
    register(np.array([[i, j]]), rough, *arrays, 1, GATE, NOISE, BRIGHTNESS_NOISE, out)
    matched = match(images, rough, i, j)
    assert len(matched) > 150
    now = residuals(images, rough, i, j, matched)
    variance = NOISE[0] ** 2 + NOISE[1] ** 2 * (now[:, 2] ** 4 + now[:, 3] ** 4)
    weights = np.stack(
        [
            (1 + (now[:, 0] / (GATE / 2)) ** 2) ** -2.0 / variance,
            (1 + (now[:, 1] / (3 * BRIGHTNESS_NOISE)) ** 2) ** -2.0 / BRIGHTNESS_NOISE**2,
        ]
    )
    jacobian, small = np.empty((2, len(matched), 6)), 1e-7
    for axis in range(6):
        sides = []
        for sign in (-1, 1):
            step = np.zeros((3, 6))
            step[i, axis] = sign * small
            sides.append(residuals(images, moved(rough, step, SPATIAL), i, j, matched)[:, :2].T)
        jacobian[:, :, axis] = (sides[1] - sides[0]) / (2 * small)
    matrix = np.einsum("kna,kn,knb->ab", jacobian, weights, jacobian)
    vector = np.einsum("kna,kn,kn->a", jacobian, weights, now[:, :2].T)
    assert_allclose(out[0, :21], matrix[np.triu_indices(6)], rtol=2e-3, atol=2e-4 * matrix.max())
    assert_allclose(out[0, 21:], vector, rtol=2e-3, atol=2e-4 * np.abs(vector).max())


def test_overlap_counts_the_points_on_surfaces_of_the_other_frame(images: RangeImages) -> None:
    points = np.array([(r, c) for r in range(2, 24, 4) for c in range(2, 32, 4)])
    away = POSES.copy()
    away[2] = looking(0, 0, 0, np.pi, 0)
    shared = np.zeros((3, 3), np.int16)
    overlap(away, images.camera, images.surface, images.normals, points, 0.05, shared)
    flat = (images.surface[0][points[:, 0], points[:, 1]] > 0).sum()
    assert shared[0, 0] == flat and 0.4 * flat < shared[0, 1] < flat and shared[0, 2] == shared[2, 0] == 0


@pytest.mark.parametrize("seed", range(6))
def test_any_depth_and_pose_gives_finite_planes_and_equations(seed: int) -> None:
    """Depth without a limit, on surfaces and in single pixels; cameras that nearly coincide or lie anywhere."""
    rng = np.random.default_rng(seed)
    extreme = np.float32([0, -1, 1e-45, 1e-38, 1e-20, 1e-3, 65.5, 1e10, 1e20, 1e38, np.inf, -np.inf, np.nan])
    depths = [view(pose)[1] * rng.choice(np.float32([1, 1, 1e-30, 1e-3, 1e10, 1e36])) for pose in POSES]
    for depth in depths:
        wrong = rng.random(depth.shape) < rng.choice([0.0, 0.02, 0.5])
        depth[wrong] = rng.choice(extreme, wrong.sum())
    found = range_images(dataset(depths=depths))
    assert np.isfinite(found.surface).all() and np.isfinite(found.normals).all() and (found.surface >= 0).all()
    poses = POSES.copy()
    poses[:, :3, 3] *= rng.choice([0, 1e-30, 1, 1e9])
    pairs, rows = np.array([(i, j) for i in range(3) for j in range(3) if i != j]), np.empty((6, ROW))
    for gate in (1e-12, 0.4, 1e30):
        arrays = found.camera, found.surface, found.normals, found.brightness
        register(pairs, poses, *arrays, 1, gate, NOISE, BRIGHTNESS_NOISE, rows)
        assert np.isfinite(rows).all(), gate
    shared = np.zeros((3, 3), np.int16)
    grid = np.array([(r, c) for r in range(2, 24, 4) for c in range(2, 32, 4)])
    overlap(poses, found.camera, found.surface, found.normals, grid, 1e-12, shared)
    assert shared.min() >= 0 and shared.max() <= len(grid)
